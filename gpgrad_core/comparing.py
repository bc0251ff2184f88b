"""Compares the pairs of a dataset of any size, on this machine or a cluster, into a file."""

import math
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeAlias, TypedDict

from typing_extensions import Unpack

from gpgrad_core.detection import (
    Pairs,
    PipelineParams,
    check_affordable,
    describe_choice,
    is_resolved,
    resolve_parameters,
    store_for_run,
    with_store,
)
from gpgrad_core.detection.shortlist import Candidates, num_candidates
from gpgrad_core.io.folder import MOST_LOADED, Outline, open_dataset
from gpgrad_core.io.records.closures import ClosureWriter, count_images, report_closures
from gpgrad_core.mapping.fitting import representative
from gpgrad_core.methods import Method
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import Cluster, connected, workers
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import num_workers
from gpgrad_core.types import Dataset, ImageVerdict, LoopClosure

MANY_CLOUDS = 300
"""From this number of clouds on, reading them takes far longer than processes take to start."""
Stage: TypeAlias = Callable[[str], AbstractContextManager[Progress]]
"""Begins a stage of the work, load, fit or pairs, and gives its progress hook."""


class Hooks(TypedDict, total=False):
    """What is told on the way."""

    stage: Stage
    on_note: Callable[[str], None]
    on_fit: Callable[[str], None]
    on_closure: Callable[[LoopClosure], None]


@dataclass(frozen=True, eq=False)
class Compared:
    """What came of the pairs."""

    dataset: Dataset  # without its points
    accepted: tuple[LoopClosure, ...]
    num_pairs: int  # that were compared
    num_pairs_skipped: int
    images: str  # what camera images say, counted in words; empty if they were not asked
    seconds: Mapping[str, float]  # of each stage


def compare_dataset(
    outline: Outline,
    requested: PipelineParams,
    out: Path,
    *,
    method: Method,
    candidates: Candidates,
    pair: tuple[str, str] | None = None,
    store: Store | None = None,
    scheduler: str | None = None,
    **hooks: Unpack[Hooks],
) -> Compared:
    """Compare the pairs of a dataset, or one, and write ``closures.json`` as they are compared.

    What is automatic is fitted to the whole dataset, so that a single pair gets the same verdict.
    Without a scheduler's address the work is done on this machine.
    """
    stage = hooks.get("stage", lambda _: nullcontext(silent))
    on_note = hooks.get("on_note", lambda _: None)
    on_fit = hooks.get("on_fit", lambda _: None)
    on_closure = hooks.get("on_closure", lambda _: None)
    num_clouds = len(outline.clouds)
    num_pairs = sum(num_candidates(candidates, k) for k in range(2 if pair else num_clouds))
    check = partial(check_affordable, params=requested) if method.fitted else None
    is_here = scheduler is None
    comparing = workers(num_workers(), num_pairs) if is_here else connected(scheduler)
    many = num_clouds >= MANY_CLOUDS
    with store_for_run(store, num_clouds) as room, comparing as executor:
        shared_store, held = _shared_store(room, executor, outline)
        reading = workers(num_workers(), num_clouds) if many else nullcontext()
        with stage("load") as progress, reading as readers:
            dataset, sources = open_dataset(
                outline, progress, check=check, most_bytes=held, executor=readers
            )
        for note in dataset.notes:
            on_note(note)
        if method.fitted and not is_resolved(requested) and sources:
            some = [sources[k].load() for k in representative(len(sources))]
            with stage("fit") as progress:
                fitted = resolve_parameters(some, requested, Memo(store=store), progress)
            on_fit(f"{dataset.name}: {describe_choice(requested, fitted)}")
            requested = fitted
        params = method.ready(requested)
        if pair is not None:  # the database comes first: the later submap is the query
            by_id = {source.id: source for source in sources}
            submaps = tuple(dataset.submap(name) for name in reversed(pair))
            dataset = replace(dataset, submaps=submaps)
            sources = tuple(by_id[submap.id] for submap in submaps)
        accepted, verdicts = list[LoopClosure](), list[ImageVerdict]()
        with ClosureWriter(out) as writer:

            def take(closure: LoopClosure) -> None:
                writer.add(closure)
                on_closure(closure)
                if closure.accepted:
                    accepted.append(closure)
                if closure.images is not None:
                    verdicts.append(closure.images)

            detector = with_store(method.detector(params, Memo(store=shared_store)), shared_store)
            pairs = Pairs(dataset.submaps, params, detector, candidates=candidates)
            with stage("pairs") as progress:
                pairs.compare(None, executor, progress, sources=sources, on_verdict=take)
            skipped, result = math.comb(len(sources), 2) - len(pairs), pairs.result()
            report = report_closures(dataset, result, params, method=method.name, sources=sources)
            writer.write(replace(report, num_pairs_skipped=skipped))
    images, seconds = count_images(verdicts), report.seconds
    return Compared(dataset, tuple(accepted), writer.num_pairs, skipped, images, seconds)


def _shared_store(
    store: Store | None, executor: Executor, outline: Outline
) -> tuple[Store | None, int]:
    """The store that the workers share, and how many bytes of points stay in this process."""
    if not isinstance(executor, Cluster):
        return store, MOST_LOADED
    if store is not None:
        with suppress(OSError):  # then nobody sees it
            store.folder.mkdir(parents=True, exist_ok=True)
        if executor.sees(store.folder) and executor.sees(outline.clouds[0]):
            return store, 0
    return None, sys.maxsize
