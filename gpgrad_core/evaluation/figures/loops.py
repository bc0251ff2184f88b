"""The traverse from above, with a method's loop closures."""

from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gpgrad_core.evaluation.figures.style import FALSE, MISSED, new_figure, verdicts
from gpgrad_core.evaluation.judge import Evaluation, MethodVerdict

PATH, STOP = "#BBBBBB", "#444444"


def draw_loops(evaluation: Evaluation, method: MethodVerdict) -> Figure:
    """Draw the true positions of the submaps, and a line for every pair accepted or missed."""
    pairs, rule, labels = evaluation.pairs, evaluation.rules[0], evaluation.labels[0]
    figure = new_figure(
        9.0,
        9.0,
        f"{evaluation.dataset}, {method.name}: loop closures on the true traverse\n"
        f"true: {rule.name}"
        + (f"; neighbours |i - j| <= {rule.neighbours} left out" if rule.neighbours else ""),
    )
    panel = figure.subplots()
    x, y = pairs.world_xy.T
    panel.plot(x, y, "-", color=PATH, linewidth=1.0, zorder=1)
    panel.plot(x, y, "o", color=STOP, markersize=4, zorder=3)
    for k, name in enumerate(pairs.ids):
        panel.annotate(name, (x[k], y[k]), (4, 4), textcoords="offset points", fontsize=7)
    handles = [Line2D([], [], color=PATH, marker="o", markerfacecolor=STOP, markersize=4)]
    names = ["submaps in their order"]
    for label, chosen, colour in verdicts(method, labels):
        dashes = ":" if colour == MISSED else "-"
        width = 3.0 if colour == FALSE else 1.4
        ends = zip(pairs.query[chosen], pairs.database[chosen], strict=True)
        lines = [pairs.world_xy[[query, database]] for query, database in ends]
        panel.add_collection(
            LineCollection(lines, colors=colour, linestyles=dashes, linewidths=width, zorder=2)
        )
        handles.append(Line2D([], [], color=colour, linestyle=dashes, linewidth=width))
        names.append(f"{label}: {len(lines)}")
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_xlabel("x in the world [m]")
    panel.set_ylabel("y in the world [m]")
    panel.grid(alpha=0.3)
    figure.legend(handles, names, loc="outside lower center", ncols=3, frameon=False)
    return figure
