"""Run methods on a dataset, one after the other, each from nothing."""

from collections.abc import Sequence
from concurrent.futures import Executor

from gpgrad_core.memo import Memo
from gpgrad_core.methods import Method
from gpgrad_core.outputs import ClosureReport, report_closures
from gpgrad_core.pipeline import PipelineParams, detect_loop_closures
from gpgrad_core.progress import Progress, part, silent
from gpgrad_core.types import Dataset


def run_methods(
    dataset: Dataset,
    methods: Sequence[Method],
    params: PipelineParams | None = None,
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> dict[str, ClosureReport]:
    """Detect the loop closures of a dataset with each of several methods.

    No method finds anything done by one before it: their times can be compared.

    Args:
        dataset: What to search.
        methods: What to search with.
        params: What they adapt to their needs.
        executor: Threads or processes to share the work out to.
        progress: Called from this thread; may raise Cancelled.

    Returns:
        What each found, by its name, as its ``closures.json`` would tell it.
    """
    params = params or PipelineParams()
    reports: dict[str, ClosureReport] = {}
    for k, method in enumerate(methods):
        adapted = method.adapt(params)
        result = detect_loop_closures(
            dataset,
            adapted,
            detector=method.detector(adapted, Memo()),
            executor=executor,
            progress=part(progress, k / len(methods), (k + 1) / len(methods)),
        )
        reports[method.name] = report_closures(dataset, result, adapted, method=method.name)
    return reports
