"""What was measured, as tables in Markdown."""

from collections.abc import Iterable
from typing import Literal

from tests.long.benchmarks.peers.adapters import DENSE, METHODS, OURS
from tests.long.benchmarks.peers.cases import Case
from tests.long.benchmarks.peers.measure import Run
from tests.long.benchmarks.peers.plan import TARGETS, Target


def markdown(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Lay out a table."""
    head = list(head)
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *map(list, rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def seconds(value: float) -> str:
    """Three digits, as far as they mean anything."""
    return f"{value:.0f} s" if value >= 100 else f"{value:.3g} s"


def percent(value: float | None) -> str:
    """A share; a dash where there is none."""
    if value is None:
        return "-"
    if value < 1e-6:
        return "exact"
    return f"{100 * value:.0f} %" if value >= 1 else f"{100 * value:.2g} %"


def compare(runs: list[Run]) -> str:
    """One row a run: time, memory, errors; with its case, if there are several."""
    several = len({run.case for run in runs}) > 1
    ours = {run.case: run.cost.seconds for run in runs if run.method == OURS and run.cost}
    head = [
        *("method", "gives", "median", "of gpgrad's", "peak memory"),
        *("elevation, of noise", "slopes", "std, trusted", "std, anywhere"),
    ]
    rows = [_cost_and_errors(run, ours.get(run.case)) for run in runs]
    if several:
        head = ["case", *head]
        rows = [[describe(run.case), *row] for run, row in zip(runs, rows, strict=True)]
    return markdown(head, rows)


def _cost_and_errors(run: Run, ours: float | None) -> list[str]:
    if run.cost is None:
        return [run.method, "-", run.failure, *["-"] * 6]
    ratio = "-" if ours is None else f"{run.cost.seconds / ours:.3g} x"
    costs = [seconds(run.cost.seconds), ratio, f"{run.cost.peak_mb:.0f} MB"]
    if run.method == DENSE:
        errors = ["oracle", "-", "-", "-"]
    elif run.errors is None:
        errors = ["-"] * 4
    else:
        errors = [percent(value) for value in vars(run.errors).values()]
    return [run.method, run.fields, *costs, *errors]


def follow_growth(runs: list[Run], by: Literal["points", "area"]) -> str:
    """One row a method, one column a size: seconds, or why there are none."""
    cases = list(dict.fromkeys(run.case for run in runs))
    cases.sort(key=lambda case: (case.side, case.num_points))
    found = {(run.method, run.case): run for run in runs}
    rows: list[list[str]] = []
    for method in dict.fromkeys(run.method for run in runs):
        row = [method]
        for case in cases:
            run = found.get((method, case))
            cost = run.cost if run else None
            row.append(seconds(cost.seconds) if cost else run.failure if run else "")
        rows.append(row)
    sizes = [
        f"{case.num_points:,}" if by == "points" else f"{case.side:g} m x {case.side:g} m"
        for case in cases
    ]
    return markdown(["method", *sizes], rows)


def check_targets(runs: list[Run]) -> tuple[str, bool]:
    """Set what ours reached beside what it is to reach; also whether all of it was."""
    found = {(run.method, run.case): run for run in runs}
    rows: list[list[str]] = []
    all_met = True
    for target in TARGETS:
        ours, dense = found.get((OURS, target.case)), found.get((DENSE, target.case))
        if ours is None:
            continue
        for what, reached, wanted, met in _checks(target, ours, dense):
            rows.append([describe(target.case), what, reached, wanted, "yes" if met else "NO"])
            all_met = all_met and met
    return markdown(["case", "figure", "reached", "target", "met"], rows), all_met


def _checks(target: Target, ours: Run, dense: Run | None) -> Iterable[tuple[str, str, str, bool]]:
    """Name each figure: reached, wanted, whether it is met."""
    cost, errors = ours.cost, ours.errors
    if cost is None:
        yield "run", ours.failure, "an answer", False
        return
    spent = 1e3 * cost.seconds
    limit = target.milliseconds
    yield "time", f"{spent:.0f} ms", f"<= {limit:.0f} ms", spent <= limit
    if target.megabytes is not None:
        held, most = cost.peak_mb, target.megabytes
        yield "peak memory", f"{held:.0f} MB", f"<= {most:.0f} MB", held <= most
    if target.times_dense is not None:
        times = dense.cost.seconds / cost.seconds if dense and dense.cost else 0.0
        least = target.times_dense
        yield "faster than dense", f"{times:.0f} x", f">= {least:.0f} x", times >= least
    for field in ("elevation", "slope", "std_trusted", "std_anywhere"):
        most = getattr(target, field)
        if most is not None:
            off = None if errors is None else getattr(errors, field)
            met = off is not None and off <= most
            yield f"error of {field}", percent(off), f"<= {percent(most)}", met


def check_peers(runs: list[Run]) -> tuple[str, bool]:
    """Say whether ours is a hundred times faster than exact peers, and ahead of SKI in both."""
    found = {run.method: run for run in runs}
    ours = found.get(OURS)
    if ours is None or ours.cost is None or ours.errors is None:
        return "", False
    rows: list[list[str]] = []
    all_met = True
    for run in runs:
        exact, ski = METHODS[run.method].exact, "SKI" in run.method
        if not (exact or ski):
            continue
        if run.cost is None:
            over_time = run.failure.startswith("over") and run.failure.endswith(" s")
            times = float(run.failure.split()[1]) / ours.cost.seconds if over_time else None
        else:
            times = run.cost.seconds / ours.cost.seconds
        # One that was ended early, or could not run at all, shows no more than this.
        met = times is not None and times >= (100 if exact else 1)
        wanted = ">= 100 x" if exact else ">= 1 x, and smaller errors"
        reached = run.failure if times is None else f"{times:.3g} x"
        if run.cost is None and times is not None:
            reached = f"more than {reached}"
        if ski and run.errors is not None:
            met = met and ours.errors.all_below(run.errors)
        rows.append([run.method, reached, wanted, "yes" if met else "NO"])
        all_met = all_met and met
    return markdown(["peer", "time, of gpgrad's", "target", "met"], rows), all_met


def describe(case: Case) -> str:
    """Say what a case is."""
    return (
        f"{case.num_points:,} points, {case.side:g} m x {case.side:g} m, "
        f"{case.resolution:g} m/pixel, length-scale {case.length_scale:g} m"
    )
