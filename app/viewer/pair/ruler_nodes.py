"""The ruler in the scene: its line on the ground of both submaps, and its ends."""

import numpy as np
from jaxtyping import Float

from app.viewer.draw.associations import on_surface
from app.viewer.draw.colors import PROBE
from app.viewer.draw.nodes import LinesNode
from app.viewer.draw.ruler import Heights, Ruler
from app.viewer.host import Host
from app.viewer.pair.ground import Ground
from gpgrad_core.arrays import NDArray

LIFT = 0.4
"""Height of the line over the ground [cells]: above squares that are drawn flat."""


class RulerNodes:
    """A line on either submap, hidden where it saw no ground."""

    def __init__(self, host: Host, root: str) -> None:
        """Prepare the nodes under a root node; nothing is shown."""
        self._lines = tuple(
            LinesNode(host, f"{root}/ruler/{role}", PROBE, thickness=4.0)
            for role in ("query", "database")
        )
        self._label = host.scene.add_label(
            f"{root}/ruler/label", "", anchor="bottom-center", visible=False
        )

    def show(self, ruler: Ruler | None, ground: Ground) -> None:
        """Show a line where the submaps stand; None shows none."""
        self._label.visible = False
        for index, line in enumerate(self._lines):
            heights = None if ruler is None else (ruler.query, ruler.database)[index]
            if ruler is None or heights is None or not heights.is_known:
                line.hide()
                continue
            points = _on_ground(heights, ground, index)
            pieces = np.stack([points[:-1], points[1:]], axis=1)
            pieces = pieces[np.isfinite(pieces).all(axis=(1, 2))].astype(np.float32)
            line.show((ruler, ground.placements[index], ground.maps[index]), lambda p=pieces: p)
            known = points[np.isfinite(points).all(axis=1)]
            x, y, z = (float(value) for value in known[len(known) // 2])
            self._label.text = f"{ruler.length:.2f} m"
            self._label.position = (x, y, z)
            self._label.visible = True


def _on_ground(heights: Heights, ground: Ground, index: int) -> Float[NDArray[np.float64], "n 3"]:
    """Give the places of a line in the scene [m]; NaN where no ground is known."""
    gradient_map = ground.maps[index]
    points = on_surface(gradient_map, heights.xy, LIFT * gradient_map.grid.resolution)
    points[~np.isfinite(heights.elevation)] = np.nan
    return ground.placements[index].apply(points)
