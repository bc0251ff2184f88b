"""Cost against points and against area, on logarithmic axes."""

from collections.abc import Callable
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tests.long.benchmarks.peers.adapters import DENSE, OURS, PEERS
from tests.long.benchmarks.peers.cases import Case
from tests.long.benchmarks.peers.measure import Run

COLOURS = ("#d55e00", "#000000", "#0072b2", "#56b4e9", "#009e73", "#8fd19e", "#cc79a7", "#e8b4d0")
"""Told apart by colour-blind eyes too (Okabe and Ito), two shades for two forms of one peer."""
MORE_COLOURS = ("#7f7f7f", "#b8860b")


def draw(points: list[Run], area: list[Run], machine: str, caps: str, path: Path) -> None:
    """Draw both curves of each method, up to where it went over a cap.

    Args:
        points: Runs with growing numbers of points.
        area: Runs with growing areas.
        machine: On which they ran, for the note below.
        caps: What one solution was allowed, for the same.
        path: Of the PNG.
    """
    figure = Figure(figsize=(11, 5.4), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _draw_curves(left, points, lambda case: case.num_points)
    left.set(xlabel="points, on 10 m x 10 m at 0.03 m/pixel", ylabel="seconds for one map")
    _draw_curves(right, area, lambda case: case.side**2)
    right.set(xlabel="area [m²], 50 points/m² at 0.1 m/pixel")
    curves = {
        name: handle
        for axes in (left, right)
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    shown = [name for name in PEERS if name in curves]
    figure.legend(
        [curves[name] for name in shown],
        [name.replace(", ", ",\n", 1) for name in shown],
        loc="outside right upper",
        frameon=False,
        fontsize=8,
    )
    note = f"A cross ends a curve whose next size went over {caps}, or failed. {machine}"
    figure.supxlabel(note, fontsize=8, color="0.3")
    figure.savefig(path, dpi=130)


def _draw_curves(axes: Axes, runs: list[Run], size: Callable[[Case], float]) -> None:
    colours = dict(zip(PEERS, COLOURS + MORE_COLOURS, strict=True))
    for method in PEERS:
        own = [run for run in runs if run.method == method]
        done = [run for run in own if run.cost is not None]
        if not done:
            continue
        x = [size(run.case) for run in done]
        y = [run.cost.seconds for run in done if run.cost is not None]
        width = 2.8 if method == OURS else 1.6 if method == DENSE else 1.2
        axes.plot(x, y, "o-", ms=3.5, lw=width, color=colours[method], label=method)
        if len(done) < len(own):
            axes.plot(x[-1], y[-1], "x", ms=9, mew=1.8, color=colours[method])
    axes.set(xscale="log", yscale="log")
    axes.grid(visible=True, which="major", color="0.9")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
