"""Where the rover drove: the paper's Fig. 6."""

from collections.abc import Sequence

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gpgrad_core.evaluation.reproduction.curves import new_panels
from gpgrad_core.evaluation.reproduction.style import in_metres
from gpgrad_core.evaluation.reproduction.subject import poses_of
from gpgrad_core.types import Dataset

TIME_COLOURS = "viridis"
ENDS = "#d7191c"


def draw_tracks(datasets: Sequence[Dataset]) -> Figure:
    """Draw the positions of the submaps in their order, a panel for each dataset."""
    figure, panels = new_panels([dataset.name for dataset in datasets], height=2.3)
    shade = ScalarMappable(Normalize(0.0, 1.0), TIME_COLOURS)
    for panel, dataset in zip(panels, datasets, strict=True):
        poses, _ = poses_of(dataset)
        track = np.array([pose.translation[:2] for pose in poses.values()])
        steps = np.stack([track[:-1], track[1:]], axis=1)
        middle = (np.arange(len(steps)) + 0.5) / len(steps)
        panel.add_collection(
            LineCollection(list(steps), colors=shade.to_rgba(middle), linewidths=1.8)
        )
        place = np.linspace(0.0, 1.0, len(track))
        panel.scatter(*track.T, s=5, color=shade.to_rgba(place), zorder=3)
        for (x, y), marker in ((track[0], "o"), (track[-1], "s")):
            panel.plot([x], [y], marker, color=ENDS, fillstyle="none", markersize=7, zorder=4)
        panel.margins(0.1)
        in_metres(panel)
        panel.set_aspect("equal", adjustable="datalim")
        panel.grid(alpha=0.3, linewidth=0.5)
    bar = figure.colorbar(shade, ax=panels, shrink=0.9, pad=0.01, aspect=30)
    bar.set_label("place in the order of submaps")
    bar.set_ticks([0.0, 1.0], labels=["first", "last"])
    figure.legend(
        handles=[
            Line2D([], [], linestyle="", marker=marker, color=ENDS, fillstyle="none", label=label)
            for marker, label in (("o", "start"), ("s", "end"))
        ],
        loc="outside lower center",
        ncols=2,
        frameon=False,
    )
    return figure
