"""Compares the pairs of a dataset of any size, on this machine or on a cluster."""

import math
import sys
from collections.abc import Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, TypeAlias

import tyro
from typing_extensions import Doc

from app.cli.inputs import load_sources, settled, tell_damaged
from app.cli.terminal import progress_bar
from gpgrad_core.detection import (
    PipelineParams,
    check_affordable,
    detect_loop_closures,
    is_resolved,
    store_for_run,
    with_store,
)
from gpgrad_core.detection.shortlist import Candidates, num_wanted
from gpgrad_core.io.folder import MOST_LOADED, Outline
from gpgrad_core.io.records.closure_writer import ClosureWriter
from gpgrad_core.io.records.closures import count_images, report_closures
from gpgrad_core.mapping.fitting import representative
from gpgrad_core.methods import Method
from gpgrad_core.run.cluster import Cluster, connected
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import num_workers
from gpgrad_core.types import Dataset, ImageVerdict, LoopClosure

SchedulerFlag: TypeAlias = Annotated[
    str | None,
    Doc(
        "Address of a Dask scheduler, such as tcp://10.0.0.7:8786, to whose workers the work is "
        "given."
    ),
    tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: this machine's cores)"),
]


@dataclass(frozen=True, eq=False)
class Compared:
    """What came of the pairs.

    Attributes:
        dataset: The dataset that was searched, without its points.
        accepted: The loop closures.
        num_pairs: Number of pairs that were compared.
        num_pairs_skipped: Number of those that were not.
        images: What camera images say, counted in words; empty if they were not asked.
        seconds: Time of each stage [s].
    """

    dataset: Dataset
    accepted: tuple[LoopClosure, ...]
    num_pairs: int
    num_pairs_skipped: int
    images: str
    seconds: Mapping[str, float]


def compare(
    outline: Outline,
    asked: PipelineParams,
    out: Path,
    *,
    method: Method,
    store: Store | None,
    candidates: Candidates,
    scheduler: str | None = None,
    pair: tuple[str, str] | None = None,
) -> Compared:
    """Compare the pairs of a dataset, and write ``closures.json`` as they are compared.

    Args:
        outline: The dataset.
        asked: Parameters of all stages; what is automatic is fitted to the whole dataset, so that
            a single pair gets the same verdict.
        out: The file to write.
        method: The method of detection.
        store: Keeps results; None keeps them in memory, or in a folder for now.
        candidates: With how many earlier submaps a submap is compared.
        scheduler: Address of a cluster; None takes this machine.
        pair: Ids of the only two submaps to compare, the query first; None compares all.
    """
    check = partial(check_affordable, params=asked) if method.fitted else None
    num_submaps = len(outline.clouds)
    num_pairs = sum(num_wanted(candidates, k) for k in range(2 if pair else num_submaps))
    with store_for_run(store, num_submaps) as room, _workers(scheduler, num_pairs) as executor:
        kept = _shared(room, executor, outline)
        dataset, sources = load_sources(outline, check, most_bytes=_held_here(kept, executor))
        if method.fitted and not is_resolved(asked):
            some = [sources[k].load() for k in representative(num_submaps)]
            asked = settled(asked, some, dataset.name, Memo(store=store))
        params = method.ready(asked)
        if pair is not None:  # the database comes first: the later submap is the query
            by_id = {source.id: source for source in sources}
            submaps = tuple(dataset.submap(name) for name in reversed(pair))
            dataset = replace(dataset, submaps=submaps)
            sources = tuple(by_id[submap.id] for submap in submaps)
        accepted, verdicts = list[LoopClosure](), list[ImageVerdict]()
        with ClosureWriter(out) as writer:

            def take(closure: LoopClosure) -> None:
                writer.add(closure)
                if closure.accepted:
                    accepted.append(closure)
                if closure.images is not None:
                    verdicts.append(closure.images)

            with progress_bar("pairs") as progress:
                result = detect_loop_closures(
                    dataset,
                    params,
                    detector=with_store(method.detector(params, Memo(store=kept)), kept),
                    candidates=candidates,
                    executor=executor,
                    progress=progress,
                    sources=sources,
                    take=take,
                )
            skipped = math.comb(len(sources), 2) - writer.num_pairs
            report = report_closures(dataset, result, params, method=method.name, sources=sources)
            writer.write(replace(report, num_pairs_skipped=skipped))
    tell_damaged(store)
    said, seconds = count_images(verdicts), report.seconds
    return Compared(dataset, tuple(accepted), writer.num_pairs, skipped, said, seconds)


def _workers(scheduler: str | None, num_pairs: int) -> AbstractContextManager[Executor]:
    return workers(num_workers(), num_pairs) if scheduler is None else connected(scheduler)


def _shared(store: Store | None, executor: Executor, outline: Outline) -> Store | None:
    """Give the store if the workers can use it and read the clouds; None if not.

    Without it, everything is sent to them and back, and must fit into memory here.
    """
    if not isinstance(executor, Cluster) or store is None:
        return store
    store.folder.mkdir(parents=True, exist_ok=True)
    sees = executor.sees(store.folder) and executor.sees(outline.clouds[0])
    return store if sees else None


def _held_here(store: Store | None, executor: Executor) -> int:
    """Give the bytes of points to keep here: all to be sent to a cluster, or none if it sees them.

    Args:
        store: The store that the workers share, if they do.
        executor: The workers.
    """
    if not isinstance(executor, Cluster):
        return MOST_LOADED
    return sys.maxsize if store is None else 0
