"""Reports of loop closures by value, because arrays have no single truth value."""

from gpgrad_core.io.records.closures import ClosureReport, row_of


def content_of(report: ClosureReport) -> dict[str, object]:
    """Everything that a report holds, its pairs as the rows of a file."""
    rows = [row_of(closure, report.decisions.get(closure.pair)) for closure in report.pairs]
    return {**vars(report), "pairs": rows}
