"""What a picture of the pair shows, as data: surfaces, placements, colours, what a click meets."""

from dataclasses import dataclass, replace
from functools import cached_property
from math import atan, degrees, hypot

import numpy as np
from jaxtyping import Bool, Float

from app.viewer.scene.associations import (
    KINDS,
    inlier_color,
    keypoint_dots,
    mark_of,
    match_lines,
    on_surface,
    outline,
    shown_kinds,
)
from app.viewer.scene.colors import DATABASE, OUTLIER, QUERY, Rgb
from app.viewer.scene.layers import (
    Cells,
    Paint,
    Scale,
    Surfels,
    make_surfels,
    stride_for,
)
from app.viewer.scene.placement import (
    Box,
    Placement,
    level_of,
    place,
    z_offset_of,
)
from app.viewer.scene.probing import Hit, Ray, Reading, first_hit, read_both
from app.viewer.scene.raster import Cloud, Drawing, Strokes
from app.viewer.session.layers import COMPARED, OWN_LEVEL, HeightFrame
from app.viewer.session.state import (
    ROLES,
    Layout,
    Probe,
    Role,
    ViewState,
    as_drawn,
)
from app.viewer.widgets.legend import histogram_svg, summary
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.detection.verdict import difference_in_words
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from gpgrad_core.types import MAX_STD_RATIO, GradientMap, Registration

MAX_SURFELS = 200_000
"""Of one surface; a finer map is drawn at every second cell, or third, …"""
INLIER_WIDTH, OUTLIER_WIDTH, OUTLINE_WIDTH = 1.2, 1.0, 1.6
"""Of lines [pixels]."""
BEYOND = 2.0
"""Standard deviations that are expected of a height difference; beyond, the maps differ."""


@dataclass(frozen=True, eq=False)
class Picture:
    """The surfaces of (query, database) in the scene; of one submap alone, its map twice."""

    state: ViewState  # the requested one, with what its layout implies
    result: PairResult | None  # None in a preview and without a pair
    registration: Registration | None  # in a preview the last one; None if there is none
    paint: Paint
    placements: tuple[Placement, Placement]
    levels: tuple[HeightFrame, HeightFrame]  # the frame of each map's values
    num_surfels: int = 0  # cells that are drawn
    num_points: int = 0  # points of the clouds that are drawn

    @property
    def maps(self) -> tuple[GradientMap, GradientMap]:
        return self.paint.maps[0], self.paint.maps[-1]

    @property
    def boxes(self) -> tuple[Box, Box]:
        return boxes_of(self.state)

    @property
    def motion(self) -> SE2 | None:
        """``T_database_query``; None if there is none."""
        return None if self.registration is None else self.registration.T_database_query

    @property
    def is_registered(self) -> bool:
        """Whether the query is drawn on the database."""
        return self.motion is not None and self.state.options.layout == "registered"

    @property
    def is_tinted(self) -> bool:
        """Whether the query's colours are blue and the database's orange.

        On top of each other they would look the same; where both are compared the colours show how.
        """
        options = self.state.options
        laid_together = self.state.is_pair and options.layout == "registered"
        return laid_together and options.layer not in COMPARED

    @cached_property
    def scale(self) -> Scale | None:
        """What the colours of both maps mean; None while no surface is shown."""
        if not self.state.options.surfaces:
            return None
        scale = self.paint.scale
        return replace(scale, tints=(QUERY, DATABASE)) if self.is_tinted else scale

    @property
    def ratio(self) -> float:
        return self.paint.max_std_ratio

    @property
    def corners(self) -> Float[NDArray[np.float64], "k 3"]:
        """Corners of both outlines in the scene [m]."""
        return corners_of(tuple(zip(self.boxes, self.placements, strict=True)))

    @property
    def mark_size(self) -> float:
        """The size of a keypoint's mark [m]: small beside the submap, but visible."""
        return float(np.clip(0.006 * self.boxes[1].size[:2].max(), 0.02, 5.0))

    def without_lines(self) -> "Picture":
        """The same without lines, where others are drawn."""
        options = replace(self.state.options, inlier_lines=False, outlier_lines=False)
        return replace(self, state=replace(self.state, options=options))

    @cached_property
    def swipe_at(self) -> float | None:
        """Where the swipe stands along the scene's x [m]; None while there is none."""
        options = self.state.options
        if not self.is_registered or options.compare != "swipe":
            return None
        low, high = self.corners[:, 0].min(), self.corners[:, 0].max()
        return float(low + options.swipe * (high - low))

    @property
    def swipe_way(self) -> Float[NDArray[np.float64], "k 3"]:
        """Places in the scene [m] over which the near edge of the swipe moves, evenly spaced."""
        if self.swipe_at is None:
            return np.zeros((0, 3))
        low, high = self.corners.min(axis=0), self.corners.max(axis=0)
        x, rest = np.linspace(low[0], high[0], 11), np.ones(11)
        return np.column_stack([x, low[1] * rest, (low[2] + high[2]) / 2 * rest])

    @property
    def roles(self) -> tuple[Role, ...]:
        """Whose submap is visible at all; blinking shows both in turn."""
        compare = self.state.options.compare
        if self.is_registered and compare in ROLES:
            return (compare,)
        return ROLES if self.state.is_pair else ROLES[:1]

    def seen(self, index: int) -> Cells | None:
        """The cells of the query (0) or the database (1) that the swipe shows; None for all."""
        if self.swipe_at is None:
            return None
        grid, placement = self.maps[index].grid, self.placements[index]
        c, s = np.cos(placement.yaw), np.sin(placement.yaw)
        right = (c * grid.x)[None, :] - (s * grid.y)[:, None] + placement.x > self.swipe_at
        return right if index else ~right

    def sees(self, index: int, points: Float[Array, "n 3"]) -> Bool[NDArray[np.bool_], "n"]:
        """Which points of a submap's frame the swipe shows."""
        if self.swipe_at is None:
            return np.ones(len(points), dtype=bool)
        right = self.placements[index].apply(points)[:, 0] > self.swipe_at
        return right if index else ~right

    def pick(self, ray: Ray) -> Probe | None:
        """Find the place that a line of sight meets first; None if it meets nothing drawn."""
        hits: list[tuple[Hit, Role]] = []
        for role in self.roles:
            index = ROLES.index(role)
            gradient_map = self.maps[index]
            drawn = np.isfinite(gradient_map.elevation)
            if self.state.options.untrusted == "hidden":
                drawn &= gradient_map.trusted(self.ratio)
            seen = self.seen(index)
            if seen is not None:
                drawn &= seen
            hit = first_hit(ray, gradient_map, self.placements[index], drawn)
            if hit is not None:
                hits.append((hit, role))
        if not hits:
            return None
        hit, role = min(hits, key=lambda met: met[0].distance)
        return Probe(role, hit.x, hit.y)

    def readings(self, probe: Probe | None) -> tuple[Reading | None, Reading | None]:
        """Read a place in (query, database), see `read_both`."""
        return read_both(self.maps, probe, self.motion, self.ratio)

    def spots(self, probe: Probe) -> tuple[Float[NDArray[np.float64], "3"], ...]:
        """Position of a place in the scene [m], and of the same place of the other submap.

        Either is left out where its map has no ground.
        """
        masked_too = self.state.options.untrusted != "hidden"
        both = [
            placement.apply(np.array([[reading.x, reading.y, reading.elevation]]))[0]
            if reading is not None and (reading.trusted or masked_too)
            else None
            for reading, placement in zip(self.readings(probe), self.placements, strict=True)
        ]
        here = ROLES.index(probe.role)
        return tuple(spot for spot in (both[here], both[1 - here]) if spot is not None)

    def keypoint_spots(
        self, index: int, positions: Float[Array, "k 2"]
    ) -> Float[NDArray[np.float64], "k 3"]:
        """The positions of keypoints of the query (0) or the database (1) in the scene [m].

        Those that are not visible are NaN.
        """
        points = on_surface(self.maps[index], positions)
        spots = self.placements[index].apply(points)
        if ROLES[index] not in self.roles:
            spots[:] = np.nan
        spots[~self.sees(index, points)] = np.nan
        return spots

    @property
    def note(self) -> str:
        """What was done to the query to show it in the database's frame, and who has which hue."""
        level, notes = self.levels[0], list[str]()
        if level != OWN_LEVEL:
            tilt = f", tilted {degrees(atan(hypot(*level.tilt))):.1f}°" if any(level.tilt) else ""
            notes.append(
                f"frame of the database: query turned {degrees(level.yaw):+z.0f}°, "
                f"raised {level.height:+z.2f} m{tilt}"
            )
        if self.is_tinted:
            notes.append("blue query, orange database")
        if self.state.options.exaggeration != 1.0:
            notes.append(f"heights drawn {self.state.options.exaggeration:g} times")
        return " · ".join(notes)


def compose(
    state: ViewState,
    maps: tuple[GradientMap, ...],
    registration: Registration | None,
    memo: Memo,
    *,
    result: PairResult | None = None,
    before: Paint | None = None,
    tall: bool = False,
    ends: tuple[float, float] | None = None,
) -> Picture:
    """Place and colour the maps of (query, database), or of the one submap, as a state asks.

    What is painted as ``before`` has the same paint; see `place` for ``tall``. Unless the state
    locks it, the range of the colours has the ``ends``, or else those that suit the values.
    """
    state = replace(state, options=as_drawn(state.options))
    options, ratio = state.options, state.params.features.max_std_ratio
    motion = None if registration is None else registration.T_database_query
    compared = motion if options.layer in COMPARED else None
    dz, level = 0.0, OWN_LEVEL
    if registration is not None and (options.layout == "registered" or compared is not None):
        dz = z_offset_of(registration, (maps[0], maps[-1]), ratio)
    if motion is not None and options.layout == "registered":
        level = HeightFrame(dz, yaw=motion.yaw)
    elif registration is not None and not options.raw_frames:
        # Not by what the slider of the mask leaves: each of its steps would level anew.
        level = memo(level_of, maps[0], maps[-1], registration, MAX_STD_RATIO)
    # A hair must not paint all the ground anew.
    levels = (level.rounded, OWN_LEVEL)[: len(maps)]
    lift = 0.0 if compared is None else dz
    beyond = BEYOND if options.beyond_noise and options.layer == "difference" else 0.0
    ends = options.ends or ends
    paint = Paint(
        maps, options.layer, ratio, options.color_map, levels, compared, lift, ends, beyond
    )
    placements = place_pair(state, options.layout, motion, level, tall=tall)
    paint = before if before is not None and before == paint else paint
    return Picture(state, result, registration, paint, placements, (level, OWN_LEVEL))


def surfels_of(picture: Picture, index: int) -> Surfels:
    """Make the squares of the query's (0) or the database's (1) surface."""
    options, paint = picture.state.options, picture.paint
    return make_surfels(
        paint,
        index,
        untrusted=options.untrusted,
        hillshaded=options.hillshade,
        hue=(QUERY, DATABASE)[index] if picture.is_tinted else None,
        stride=stride_for(paint.maps[index].grid.num_cells, MAX_SURFELS),
        seen=picture.seen(index),
        centre=(picture.state.query, picture.state.database)[index].centre,
        exaggeration=options.exaggeration,
        picked=options.picked_values,
    )


class PairDrawing:
    """What a picture shows, drawn without a page: where the submaps stand, or anywhere else."""

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
        options, lift, result = self.picture.state.options, self.picture.mark_size / 2, self._result
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
            dots = keypoint_dots(self._result, index, lift=self.picture.mark_size / 2, shown=kinds)
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


def place_pair(
    state: ViewState, layout: Layout, motion: SE2 | None, level: HeightFrame, *, tall: bool
) -> tuple[Placement, Placement]:
    """Place (query, database) in the scene; one submap alone stands in its middle."""
    if not state.is_pair:
        layout, motion, level = "registered", SE2(), HeightFrame()
    elif layout != "registered" and state.options.raw_frames:
        motion = None
    query, database = boxes_of(state)
    x, y, _ = query.center[:, None]
    (dz,) = level.height_at(x, y).tolist()
    times = state.options.exaggeration
    return place(
        query, database, layout, motion, dz, tilt=level.tilt, tall=tall, exaggeration=times
    )


def corners_of(placed: tuple[tuple[Box, Placement], ...]) -> Float[NDArray[np.float64], "k 3"]:
    """The corners of the outlines of boxes in the scene [m]."""
    return np.concatenate([placement.apply(box.corners) for box, placement in placed])


def boxes_of(state: ViewState) -> tuple[Box, Box]:
    """Measure the boxes of both submaps, each in its own frame."""
    return Box.of(state.query), Box.of(state.database)


def comparison_in_words(picture: Picture) -> str:
    """How two maps compare, in a few words; empty if they are not compared, or share no cell.

    The heights' agreement reads as on the card, if it is there.
    """
    paint, registration = picture.paint, picture.registration
    common = paint.fields[-1][np.isfinite(paint.fields[-1])]
    if registration is None or paint.motion is None or not len(common):
        return ""
    if paint.layer == "agreement":
        return f"; blue agrees: {np.mean(common > 0):.0%} of the common ground"
    if registration.agreement is None:
        return f"; root mean square {np.sqrt(np.mean(common**2)):.3f} m"
    return f"; {difference_in_words(registration.agreement)} once levelled"


def draw_histogram(picture: Picture, scale: Scale) -> tuple[str, str]:
    """Draw a picture to stand on the colour bar, and write a line about it.

    The mask's threshold stands in it where the layer has one.
    """
    counted, thresholds = picture.paint.counted, _thresholds(picture.paint)
    note = summary(counted) + comparison_in_words(picture)
    if thresholds:
        values = " and ".join(f"{value:.3g}" for value, _ in thresholds)
        note += f"; dashed: the mask's threshold, {values} {scale.unit}"
    return histogram_svg(counted, scale, thresholds, picture.state.options.picked_values), note


def _thresholds(paint: Paint) -> tuple[tuple[float, Rgb | None], ...]:
    """The values of the layer at which the mask stands, and for which submap."""
    ratio = paint.max_std_ratio
    if paint.layer == "mask":
        return ((ratio, None),)
    if paint.layer != "std":
        return ()
    values = [ratio * gradient_map.signal_std for gradient_map in paint.maps]
    if min(values) == max(values):
        return ((values[0], None),)
    return ((values[0], QUERY), (values[1], DATABASE))
