"""What is pointed at, in the scene: one association, and the place whose values are read."""

import numpy as np
from jaxtyping import Float, UInt8

from app.viewer.draw.associations import match_arc, residuals
from app.viewer.draw.colors import CHOSEN, PROBE, Rgb
from app.viewer.draw.nodes import LinesNode, PointsNode
from app.viewer.draw.placement import Placement
from app.viewer.draw.readout import Reading, label_text
from app.viewer.host import Host
from gpgrad_core.arrays import NDArray
from gpgrad_core.pipeline import PairResult

END_SIZE, PROBE_SIZE, MATCH_LIFT = 2.2, 1.6, 1.5
"""Of the marks, and how high an association is lifted out of the ground, in keypoints."""


class Marks:
    """Nodes that are moved to whatever is pointed at, and hidden while nothing is."""

    def __init__(self, host: Host, root: str) -> None:
        """Prepare the nodes under a root node; nothing is shown."""
        self._line = LinesNode(host, f"{root}/match/line", CHOSEN, thickness=5.0)
        self._ends = PointsNode(host, f"{root}/match/ends", shape="circle")
        self._match_label = host.scene.add_label(
            f"{root}/match/label", "", anchor="bottom-center", visible=False
        )
        self._point = PointsNode(host, f"{root}/probe/point", shape="diamond")
        self._other = PointsNode(host, f"{root}/probe/other", shape="diamond")
        self._point_label = host.scene.add_label(
            f"{root}/probe/label", "", anchor="bottom-left", visible=False
        )

    def show_match(
        self,
        result: PairResult,
        number: int,
        at_query: Placement,
        at_database: Placement,
        size: float,
    ) -> None:
        """Show one association boldly, or none if there is none of that number.

        Args:
            result: The pair.
            number: From 1.
            at_query: Where the query stands.
            at_database: Where the database stands.
            size: Of a keypoint's mark [m].
        """
        if not 1 <= number <= len(result.matches):
            self.hide_match()
            return
        arc = match_arc(result, at_query, at_database, number - 1, MATCH_LIFT * size)
        place = (result, number, at_query, at_database)
        self._line.show(place, lambda: arc)
        ends = np.stack([arc[0, 0], arc[-1, 1]])
        self._ends.show(place, lambda: (ends, _painted(CHOSEN, 2), END_SIZE * size))
        missed = residuals(result)
        text = f"association {number}"
        if missed is not None:
            kind = "inlier" if result.registration.inliers[number - 1] else "outlier"
            text += f": {kind}, residual {missed[number - 1]:.3f} m"
        self._match_label.text = text
        self._match_label.position = _tuple(arc[len(arc) // 2, 0])
        self._match_label.visible = True

    def hide_match(self) -> None:
        """Point at no association."""
        self._line.hide()
        self._ends.hide()
        self._match_label.visible = False

    def hide(self) -> None:
        """Point at nothing."""
        self.hide_match()
        self._point.hide()
        self._other.hide()
        self._point_label.visible = False

    def show_reading(self, reading: Reading | None, placement: Placement, size: float) -> None:
        """Mark the place that is read, with its values; None marks none.

        Args:
            reading: In a submap's frame.
            placement: Where that submap stands.
            size: Of a keypoint's mark [m].
        """
        if reading is None:
            self._point.hide()
            self._point_label.visible = False
            return
        there = _place_point(self._point, reading, placement, size)
        self._point_label.text = label_text(reading)
        self._point_label.position = _tuple(there[0])
        self._point_label.visible = True

    def show_other(self, reading: Reading | None, placement: Placement, size: float) -> None:
        """Mark the same place of the other submap; None marks none, as where it saw no ground."""
        if reading is None or not reading.trusted:
            self._other.hide()
        else:
            _place_point(self._other, reading, placement, size)


def _place_point(
    point: PointsNode, reading: Reading, placement: Placement, size: float
) -> Float[NDArray[np.float32], "1 3"]:
    spot = np.array([[reading.x, reading.y, reading.elevation + size / 2]])
    there = placement.apply(spot).astype(np.float32)
    point.show((reading, placement, size), lambda: (there, _painted(PROBE, 1), PROBE_SIZE * size))
    return there


def _painted(color: Rgb, count: int) -> UInt8[NDArray[np.uint8], "n 3"]:
    return np.tile(np.array(color, dtype=np.uint8), (count, 1))


def _tuple(point: Float[NDArray[np.floating], "3"]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in point)
    return x, y, z
