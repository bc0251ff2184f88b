"""Collects the detections to judge: runs methods, and reads files of closures."""

from collections.abc import Collection, Sequence
from concurrent.futures import Executor
from itertools import combinations
from pathlib import Path

from gpgrad_core.detection import DetectionResult, PipelineParams, detect_loop_closures
from gpgrad_core.detection.all_pairs import OrderedDetector
from gpgrad_core.detection.shortlist import Candidates
from gpgrad_core.errors import InputError
from gpgrad_core.io.records.closures import ClosureReport, read_closures, report_closures
from gpgrad_core.methods import Method
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, part, silent
from gpgrad_core.run.store import Store, key_of
from gpgrad_core.types import Dataset, LoopClosure, Submap


def run_methods(
    dataset: Dataset,
    methods: Sequence[Method],
    params: PipelineParams | None = None,
    *,
    candidates: Candidates = "automatic",
    executor: Executor | None = None,
    store: Store | None = None,
    progress: Progress = silent,
    only: Collection[tuple[str, str]] | None = None,
) -> dict[str, ClosureReport]:
    """Detect the loop closures of a dataset with each of several methods.

    No method reuses the results of another, so that their times can be compared. Only the fit of
    automatic parameters is shared.

    Args:
        dataset: The dataset to search.
        methods: The methods to run.
        params: Parameters, which each method adapts to its needs.
        candidates: With how many earlier submaps a submap is compared; see
            `detect_loop_closures`.
        executor: Threads or processes that share the work.
        store: Keeps the fit for later runs.
        progress: Called from this thread with the fraction done; may raise Cancelled.
        only: Ids of the pairs to compare; see `detect_loop_closures`.

    Returns:
        The result of each method by its name, with the content of its ``closures.json``.

    Raises:
        InputError: If a method is given twice, if a submap cannot be used by one, or if one has
            no keypoints to choose candidates by.
    """
    params = params or PipelineParams()
    names = [method.name for method in methods]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"method {name!r} is given twice; give it once")
    for method in methods:
        method.check_searchable(candidates)  # before the work of any
    reports: dict[str, ClosureReport] = {}
    fits = Memo(store=store)
    for k, method in enumerate(methods):
        adapted = method.settle(dataset.submaps, params, fits)
        result = detect_loop_closures(
            dataset,
            adapted,
            detector=method.detector(adapted, Memo(store=store)),
            candidates=candidates,
            executor=executor,
            progress=part(progress, k / len(methods), (k + 1) / len(methods)),
            only=only,
        )
        reports[method.name] = report_closures(dataset, result, adapted, method=method.name)
    return reports


def detect_kept(
    dataset: Dataset,
    method: Method,
    params: PipelineParams,
    store: Store | None = None,
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> DetectionResult:
    """Compare all pairs of a dataset with any method, and keep the verdict on each.

    A run that was stopped goes on with the pairs that it had not reached, and a second run compares
    nothing.

    Args:
        dataset: The dataset to search.
        method: The method.
        params: Parameters from the method's ``settle``.
        store: Keeps the verdicts; None keeps nothing. It does not keep those that images have a
            part in, because a submap is known by its points alone.
        executor: Threads or processes that share the work.
        progress: Called from this thread with the fraction done; may raise Cancelled.

    Returns:
        The verdict on every pair. Its seconds are those of the pairs that were not kept.

    Raises:
        InputError: If a submap cannot be used by the method.
    """
    detector = method.detector(params, Memo(store=store))
    if isinstance(detector, OrderedDetector) or params.closure.images != "off":
        store = None

    def key(query: Submap, database: Submap) -> str:
        return key_of("verdict", method.name, query.id, database.id, query, database, params)

    verdicts: dict[tuple[str, str], LoopClosure] = {}
    missing: set[tuple[str, str]] = set()
    for database, query in combinations(dataset.submaps, 2):
        kept = None if store is None else store.get(key(query, database))
        if isinstance(kept, LoopClosure):
            verdicts[query.id, database.id] = kept
        else:
            missing.add((query.id, database.id))

    def take(verdict: LoopClosure) -> None:
        pair = verdict.query_id, verdict.database_id
        verdicts[pair] = verdict
        if store is not None:
            store.put(key(*map(dataset.submap, pair)), verdict)

    seconds: dict[str, float] = {}
    if missing:
        seconds = detect_loop_closures(
            dataset,
            params,
            detector=detector,
            candidates="all",
            executor=executor,
            progress=progress,
            take=take,
            only=missing,
        ).seconds
    progress(1.0)
    order = {submap.id: k for k, submap in enumerate(dataset.submaps)}
    ordered = sorted(verdicts, key=lambda pair: (order[pair[0]], order[pair[1]]))
    return DetectionResult(tuple(verdicts[pair] for pair in ordered), dict(seconds))


def read_rivals(paths: Sequence[Path], taken: Collection[str] = ()) -> dict[str, ClosureReport]:
    """Read files of closures, and give each a name of its own.

    Args:
        paths: Files in the format of ``closures.json``, written by any tool.
        taken: Names that are already in use.

    Returns:
        The contents of the files by the name of their method. If several have the same name, the
        path is added to it.

    Raises:
        InputError: If a file is given twice, or has another format.
        OSError: If a file cannot be read.
    """
    reports = [read_closures(path) for path in paths]
    methods = [*taken, *(report.method for report in reports)]
    rivals: dict[str, ClosureReport] = {}
    for path, report in zip(paths, reports, strict=True):
        alone = methods.count(report.method) == 1
        name = report.method if alone else f"{report.method} ({path})"
        if name in rivals:
            raise InputError(f"{path}: is given twice; give it once")
        rivals[name] = report
    return rivals
