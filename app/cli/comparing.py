"""Compares the pairs of a dataset of any size, on this machine or on a cluster."""

import math
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, TypeAlias

import tyro
from typing_extensions import Doc

from app.cli.terminal import progress_bar
from gpgrad_core.datasets import Outline
from gpgrad_core.datasets.folder import MOST_LOADED
from gpgrad_core.methods import Method
from gpgrad_core.outputs import ClosureWriter, count_images, report_closures
from gpgrad_core.pipeline import PipelineParams, detect_loop_closures, with_store
from gpgrad_core.run.cluster import Cluster, connected
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import num_workers
from gpgrad_core.shortlist import Candidates
from gpgrad_core.types import Dataset, ImageVerdict, LoopClosure, SubmapSource

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
        accepted: The loop closures.
        num_pairs: Number of pairs that were compared.
        num_pairs_skipped: Number of those that were not.
        images: What camera images say, counted in words; empty if they were not asked.
        seconds: Time of each stage [s].
    """

    accepted: tuple[LoopClosure, ...]
    num_pairs: int
    num_pairs_skipped: int
    images: str
    seconds: Mapping[str, float]


def compare(
    dataset: Dataset,
    sources: Sequence[SubmapSource],
    params: PipelineParams,
    out: Path,
    *,
    method: Method,
    store: Store | None,
    candidates: Candidates,
    executor: Executor,
) -> Compared:
    """Compare pairs, and write ``closures.json`` as they are compared.

    Args:
        dataset: The dataset.
        sources: Where its submaps are loaded from.
        params: Parameters of all stages, without automatic ones.
        out: The file to write.
        method: The method of detection.
        store: Keeps results; None keeps them in memory.
        candidates: With how many earlier submaps a submap is compared.
        executor: Does the work.
    """
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
                detector=with_store(method.detector(params, Memo(store=store)), store),
                candidates=candidates,
                executor=executor,
                progress=progress,
                sources=sources,
                take=take,
            )
        skipped = math.comb(len(sources), 2) - writer.num_pairs
        report = report_closures(dataset, result, params, method=method.name, sources=sources)
        writer.write(replace(report, num_pairs_skipped=skipped))
    said = count_images(verdicts)
    return Compared(tuple(accepted), writer.num_pairs, skipped, said, report.seconds)


def workers_for(scheduler: str | None, num_pairs: int) -> AbstractContextManager[Executor]:
    """Give the workers of a cluster, or this machine's.

    Args:
        scheduler: Address of the cluster; None takes this machine.
        num_pairs: Number of pairs to compare.
    """
    return workers(num_workers(), num_pairs) if scheduler is None else connected(scheduler)


def shared(store: Store | None, executor: Executor, outline: Outline) -> Store | None:
    """Give the store if the workers can use it and read the clouds; None if not.

    Without it, everything is sent to them and back, and must fit into memory here.
    """
    if not isinstance(executor, Cluster) or store is None:
        return store
    store.folder.mkdir(parents=True, exist_ok=True)
    sees = executor.sees(store.folder) and executor.sees(outline.clouds[0])
    return store if sees else None


def kept_in_memory(store: Store | None, executor: Executor) -> int:
    """Give the bytes of points to keep here: all to be sent to a cluster, or none if it sees them.

    Args:
        store: The store that the workers share, if they do.
        executor: The workers.
    """
    if not isinstance(executor, Cluster):
        return MOST_LOADED
    return sys.maxsize if store is None else 0
