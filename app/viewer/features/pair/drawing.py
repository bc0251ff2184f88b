"""A picture of the pair, drawn without a page."""

from functools import cached_property

import numpy as np

from app.viewer.features.pair.nodes import INLIER_WIDTH, OUTLIER_WIDTH, mark_size
from app.viewer.features.pair.picture import Picture, surfels_of
from app.viewer.scene.associations import (
    KINDS,
    inlier_color,
    keypoint_dots,
    mark_of,
    match_lines,
    outline,
    shown_kinds,
)
from app.viewer.scene.colors import DATABASE, OUTLIER, QUERY
from app.viewer.scene.layers import Surfels
from app.viewer.scene.placement import Placement
from app.viewer.scene.raster import Cloud, Drawing, Strokes
from app.viewer.session.state import ROLES
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PairResult

OUTLINE_WIDTH = 1.6
"""Of lines [pixels]."""


class PairDrawing:
    """What a picture shows, where the submaps stand or anywhere else."""

    def __init__(self, picture: Picture, result: PairResult) -> None:
        self.picture, self._result = picture, result

    @cached_property
    def surfels(self) -> tuple[Surfels, ...]:
        return tuple(surfels_of(self.picture, index) for index in range(2))

    def at(
        self,
        placements: tuple[Placement, Placement] | None = None,
        colors: tuple[NDArray[np.uint8], ...] | None = None,
    ) -> Drawing:
        """Draw it with the submaps at other places, or in other colours."""
        picture, state = self.picture, self.picture.state
        placed = placements or picture.placements
        clouds, under = list[Cloud](), list[Strokes]()
        for index, submap in enumerate(state.pair):
            if ROLES[index] not in picture.roles:
                continue
            if state.options.frames:
                corners = placed[index].apply(picture.boxes[index].corners)
                under.append(Strokes(outline(corners), (QUERY, DATABASE)[index], OUTLINE_WIDTH))
            if state.options.surfaces:
                surfels = self.surfels[index]
                level = 1.0, 1.0, 1.0 / state.options.exaggeration  # places exaggerate themselves
                points = placed[index].apply(surfels.positions * level + submap.centre)
                own = surfels.colors if colors is None else colors[index]
                clouds.append(Cloud(points, own, surfels.size))
            if state.options.clouds:
                color = np.full(submap.points.shape, (QUERY, DATABASE)[index], np.uint8)
                points = placed[index].apply(submap.points)
                clouds.append(Cloud(points, color, state.options.point_size))
        return Drawing(tuple(under), tuple(clouds), (*self._lines(placed), *self._marks(placed)))

    def _lines(self, placed: tuple[Placement, Placement]) -> list[Strokes]:
        options, lift, result = self.picture.state.options, self._size / 2, self._result
        return [
            Strokes(match_lines(result, placed, inliers, lift, options.all_lines), color, width)
            for wanted, inliers, color, width in (
                (options.outlier_lines, False, OUTLIER, OUTLIER_WIDTH),
                (options.inlier_lines, True, inlier_color(result), INLIER_WIDTH),
            )
            if wanted
        ]

    def _marks(self, placed: tuple[Placement, Placement]) -> list[Strokes]:
        marks = list[Strokes]()
        kinds = shown_kinds(self.picture.state.options)
        for index in range(2):
            dots = keypoint_dots(self._result, index, lift=self._size / 2, shown=kinds)
            if ROLES[index] not in self.picture.roles:
                continue
            points = placed[index].apply(dots.points)
            seen = self.picture.sees(index, dots.points)
            for number, kind in enumerate(KINDS):
                own = points[(dots.kinds == number) & seen]
                mark, ends = mark_of(kind, inlier_color(self._result)), np.stack([own, own], axis=1)
                marks.append(Strokes(ends, mark.rim, mark.rim_width))
                marks.append(Strokes(ends, mark.core, mark.core_width))
        return marks

    @property
    def _size(self) -> float:
        return mark_size(self.picture)
