"""What joins the two submaps in the scene: keypoints, lines, and what is pointed at."""

from typing import Any

import numpy as np

from app.viewer.draw.associations import inlier_color, keypoint_dots, match_lines
from app.viewer.draw.colors import INLIER, OUTLIER, faint
from app.viewer.draw.nodes import LinePoints, LinesNode, SubmapNode
from app.viewer.draw.placement import Extent, Placement
from app.viewer.draw.readout import other_place, read, reading_of
from app.viewer.host import Host
from app.viewer.pair.ground import Ground
from app.viewer.pair.marks import Marks
from app.viewer.state import ViewState
from gpgrad_core.pipeline import PairResult
from gpgrad_core.types import GradientMap

INLIER_WIDTH, OUTLIER_WIDTH = 1.2, 1.0
"""Of lines [pixels]."""


class AssociationNodes:
    """Nodes of the associations between two submaps."""

    def __init__(self, host: Host, root: str, nodes: tuple[SubmapNode, SubmapNode]) -> None:
        """Prepare the nodes; nothing is shown.

        Args:
            host: Whose scene they join.
            root: Name of the node above them.
            nodes: Of (query, database), which carry the keypoints.
        """
        self._nodes = nodes
        self._outlier_lines = LinesNode(host, f"{root}/matches/outliers", OUTLIER, OUTLIER_WIDTH)
        self._inlier_lines = LinesNode(host, f"{root}/matches/inliers", INLIER, INLIER_WIDTH)
        self._marks = Marks(host, root)

    def hide(self) -> None:
        """Hide all of them."""
        for node in self._nodes:
            node.keypoints.hide()
        self._inlier_lines.hide()
        self._outlier_lines.hide()
        self._marks.hide()

    def show_keypoints(self, ground: Ground, result: PairResult) -> None:
        """Mark the keypoints that the swipe leaves to be seen."""
        size = _mark_size(ground.state)
        for index, node in enumerate(self._nodes):
            if not ground.state.options.keypoints:
                node.keypoints.hide()
                continue
            of_query, placement = index == 0, ground.placements[index]

            def make(of_query: bool = of_query, index: int = index) -> tuple[Any, Any, float]:
                dots = keypoint_dots(result, of_query=of_query, lift=size / 2)
                kept = ground.sees(index, dots.points)
                return dots.points[kept], dots.colors[kept], size

            node.keypoints.show(
                (
                    result.query_features if of_query else result.database_features,
                    result.query_map if of_query else result.database_map,
                    result.matches,
                    result.registration,
                    result.closure.accepted,
                    size,
                    None if ground.swipe_at is None else (ground.swipe_at, placement),
                ),
                make,
            )

    def show_lines(
        self, state: ViewState, result: PairResult, at_query: Placement, at_database: Placement
    ) -> None:
        """Join the associated keypoints of submaps that stand at these placements."""
        options, lift = state.options, _mark_size(state) / 2
        pointed = 1 <= state.match <= len(result.matches)
        for segments, inliers, wanted, color, thickness in (
            (self._inlier_lines, True, options.inlier_lines, inlier_color(result), INLIER_WIDTH),
            (self._outlier_lines, False, options.outlier_lines, OUTLIER, OUTLIER_WIDTH),
        ):
            # Beside one that is pointed at, all others step back.
            segments.restyle(faint(color) if pointed else color, thickness / (2 if pointed else 1))
            if not wanted:
                segments.hide()
                continue

            def lines(inliers: bool = inliers) -> LinePoints:
                return match_lines(
                    result,
                    at_query,
                    at_database,
                    inliers=inliers,
                    lift=lift,
                    everything=options.all_lines,
                )

            segments.show(
                (
                    result.matches,
                    result.registration,
                    result.query_map,
                    result.database_map,
                    at_query,
                    at_database,
                    lift,
                    options.all_lines,
                ),
                lines,
            )

    def show_alone(self, state: ViewState, gradient_map: GradientMap, placement: Placement) -> None:
        """Show what is left without a pair: the place that is pointed at."""
        self.hide()
        reading = reading_of(state, (gradient_map, gradient_map))
        self._marks.show_reading(reading, placement, _mark_size(state))

    def show_marks(
        self, state: ViewState, result: PairResult, at_query: Placement, at_database: Placement
    ) -> None:
        """Show the association and the place that are pointed at."""
        size = _mark_size(state)
        self._marks.show_match(result, state.match, at_query, at_database, size)
        reading = reading_of(state, (result.query_map, result.database_map))
        of_query = state.probe is not None and state.probe.role == "query"
        self._marks.show_reading(reading, at_query if of_query else at_database, size)
        motion, other = result.registration.T_database_query, None
        # Registered, the same place of the other submap is the same place of the scene.
        if reading is not None and motion is not None and state.options.layout != "registered":
            x, y = other_place(motion, reading.x, reading.y, of_query=of_query)
            read_map = result.database_map if of_query else result.query_map
            other = read(read_map, x, y, state.params.features.max_std_ratio)
        self._marks.show_other(other, at_database if of_query else at_query, size)


def _mark_size(state: ViewState) -> float:
    """Give the size of a keypoint's mark [m]: small beside the submap, but seen."""
    return float(np.clip(0.006 * Extent.of(state.database).size[:2].max(), 0.02, 5.0))
