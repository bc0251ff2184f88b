"""Reports of loop closures by value, because arrays have no single truth value."""

from collections.abc import Iterable

from gpgrad_core.io.records.closures import ClosureReport, row_of
from gpgrad_core.types import LoopClosure


def content_of(report: ClosureReport) -> dict[str, object]:
    """Everything that a report holds, its pairs as the rows of a file."""
    rows = [row_of(closure, report.decisions.get(closure.pair)) for closure in report.pairs]
    return {**vars(report), "pairs": rows}


def verdicts_of(closures: Iterable[LoopClosure]) -> list[object]:
    """Everything that verdicts say."""
    return [(row_of(closure), closure.registration.inliers.tolist()) for closure in closures]
