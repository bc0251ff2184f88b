"""Both maps as the scene draws them: their colours, the cells that are seen, what a click meets."""

from dataclasses import dataclass, replace
from functools import cached_property
from math import atan, degrees, hypot

import numpy as np
from jaxtyping import Bool, Float

from app.viewer.scene.associations import on_surface
from app.viewer.scene.colors import DATABASE, QUERY, Rgb
from app.viewer.scene.layers import (
    OWN_LEVEL,
    Cells,
    Relief,
    Scale,
    Values,
    compare,
    compared_cells,
    layer_values,
    relief_of,
    shared_scale,
)
from app.viewer.scene.placement import HeightFrame, Placement
from app.viewer.scene.probing import Hit, Ray, first_hit, read
from app.viewer.session.state import COMPARED, ColorMap, Layer, Probe, Role, ViewState
from app.viewer.widgets.legend import Histogram, count_values, histogram_svg, summary
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection.verdict import difference_in_words
from gpgrad_core.types import MAX_STD_RATIO, Agreement, GradientMap, Registration

ROLES: tuple[Role, Role] = ("query", "database")


@dataclass(frozen=True, eq=False)
class MapComparison:
    """Both maps against each other.

    Attributes:
        layer: What is compared.
        fields: Values at the cells of the query and of the database.
        agreement: How well the heights agree, as the card has it; None if that was not found.
    """

    layer: Layer
    fields: tuple[Values, Values]
    agreement: Agreement | None

    @property
    def in_words(self) -> str:
        """The whole in a few words; empty if no cell is common."""
        common = self.fields[1][np.isfinite(self.fields[1])]
        if not len(common):
            return ""
        if self.layer == "agreement":
            return f"; blue agrees: {np.mean(common > 0):.0%} of the common ground"
        if self.agreement is None:
            return f"; root mean square {np.sqrt(np.mean(common**2)):.3f} m"
        return f"; {difference_in_words(self.agreement)} once levelled"


def compare_maps(
    layer: Layer,
    query_map: GradientMap,
    database_map: GradientMap,
    registration: Registration,
    z_offset: float,
    max_std_ratio: float,
) -> MapComparison | None:
    """Compare two registered maps in a layer of `state.COMPARED`; None if there is no motion.

    The offset is added to the query's heights [m].
    """
    motion = registration.T_database_query
    if motion is None:
        return None
    maps = query_map, database_map
    fields = compare(layer, maps, motion, z_offset, max_std_ratio)
    return MapComparison(layer, fields, registration.agreement)


@dataclass(frozen=True)
class Appearance:
    """What is shown of both maps, whatever the variance mask leaves of it.

    Attributes:
        maps: Of query and database.
        layer: What the colours show.
        levels: The frames in which values are told; a hair must not paint all the ground anew.
        comparison: What colours the maps in a layer that compares them; None if there is no motion.
    """

    maps: tuple[GradientMap, GradientMap]
    layer: Layer
    levels: tuple[HeightFrame, HeightFrame]
    comparison: MapComparison | None

    @cached_property
    def fields(self) -> tuple[Float[NDArray[np.floating], "_rows _columns"], ...]:
        """What the layer shows of both maps."""
        if self.comparison is not None:
            return self.comparison.fields
        return tuple(
            layer_values(gradient_map, self.layer, level)
            for gradient_map, level in zip(self.maps, self.levels, strict=True)
        )

    @cached_property
    def relief(self) -> Relief:
        """How both maps are lit."""
        return relief_of(self.maps, self.levels, MAX_STD_RATIO)


@dataclass(frozen=True)
class Paint:
    """What colours both maps, and lights them.

    A picture that differs in nothing that stands here is painted alike, so it can have the same.

    Attributes:
        shown: What is shown.
        color_map: As it is asked for.
        max_std_ratio: The variance mask.
    """

    shown: Appearance
    color_map: ColorMap
    max_std_ratio: float

    @cached_property
    def scale(self) -> Scale:
        """What the colours of both maps mean."""
        shown, mask = self.shown, self.max_std_ratio
        return shared_scale(
            shown.maps, shown.layer, self.color_map, mask, shown.levels, shown.fields
        )


@dataclass(frozen=True, eq=False)
class Ground:
    """The maps of (query, database) in the scene; of one submap alone, its map twice.

    Attributes:
        state: What is asked for.
        paint: The maps, and how they are painted.
        placements: Where each stands.
        levels: The frame in which each map's values are told.
        swipe_at: Where the swipe stands along the scene's x [m]; None while there is none.
    """

    state: ViewState
    paint: Paint
    placements: tuple[Placement, Placement]
    levels: tuple[HeightFrame, HeightFrame]
    swipe_at: float | None

    @property
    def maps(self) -> tuple[GradientMap, GradientMap]:
        """The maps that are drawn."""
        return self.paint.shown.maps

    @cached_property
    def scale(self) -> Scale:
        """What the colours of both maps mean."""
        scale = self.paint.scale
        return replace(scale, tints=(QUERY, DATABASE)) if self.is_tinted else scale

    @property
    def is_tinted(self) -> bool:
        """Whether the query's colours are blue and the database's orange.

        Laid onto each other they would look the same; where both are compared the colours say how.
        """
        options = self.state.options
        laid_together = self.state.is_pair and options.layout == "registered"
        return laid_together and options.layer not in COMPARED

    @property
    def ratio(self) -> float:
        """The variance mask."""
        return self.state.params.features.max_std_ratio

    def seen(self, index: int) -> Cells | None:
        """Say which cells of the query (0) or the database (1) the swipe leaves; None for all."""
        if self.swipe_at is None:
            return None
        return compared_cells(
            self.maps[index].grid, self.placements[index], ROLES[index], self.swipe_at
        )

    def sees(self, index: int, points: Float[Array, "n 3"]) -> Bool[NDArray[np.bool_], "n"]:
        """Say which points of a submap's frame the swipe leaves to be seen."""
        if self.swipe_at is None:
            return np.ones(len(points), dtype=bool)
        placed = self.placements[index].apply(points)
        right = placed[:, 0] > self.swipe_at
        return right if ROLES[index] == "database" else ~right

    def pick(self, ray: Ray) -> Probe | None:
        """Find the place that a line of sight meets first; None if it meets nothing drawn."""
        options = self.state.options
        hits: list[tuple[Hit, Role]] = []
        for index, role in enumerate(ROLES):
            if role not in shown_roles(self.state):
                continue
            gradient_map = self.maps[index]
            drawn = np.isfinite(gradient_map.elevation)
            if options.untrusted == "hidden":
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

    def spot(self, probe: Probe) -> Float[NDArray[np.float64], "3"] | None:
        """Give where a place is in the scene [m]; None where no ground is known."""
        index = ROLES.index(probe.role)
        reading = read(self.maps[index], probe.x, probe.y, self.ratio)
        if reading is None or not (reading.trusted or self.state.options.untrusted != "hidden"):
            return None
        return self.placements[index].apply(np.array([[probe.x, probe.y, reading.elevation]]))[0]

    def keypoint_spots(
        self, index: int, positions: Float[Array, "k 2"]
    ) -> Float[NDArray[np.float64], "k 3"]:
        """Give where keypoints of the query (0) or the database (1) are in the scene [m].

        Those that are not seen are NaN.
        """
        points = on_surface(self.maps[index], positions)
        spots = self.placements[index].apply(points)
        if ROLES[index] not in shown_roles(self.state):
            spots[:] = np.nan
        spots[~self.sees(index, points)] = np.nan
        return spots

    @property
    def note(self) -> str:
        """What was done to the query to show it in the database's frame, and who has which hue."""
        level, said = self.levels[0], list[str]()
        if level != OWN_LEVEL:
            tilt = f", tilted {degrees(atan(hypot(*level.tilt))):.1f}°" if any(level.tilt) else ""
            said.append(
                f"frame of the database: query turned {degrees(level.yaw):+z.0f}°, "
                f"raised {level.height:+z.2f} m{tilt}"
            )
        if self.is_tinted:
            said.append("blue query, orange database")
        return " · ".join(said)

    def count(self) -> Histogram:
        """Count the values that the layer shows."""
        maps = self.maps if self.state.is_pair else self.maps[:1]
        fields = self.paint.shown.fields[: len(maps)]
        trusted = tuple(gradient_map.trusted(self.ratio) for gradient_map in maps)
        return count_values(fields, trusted, self.scale)


class HistogramPainter:
    """Draws the histogram of the ground, unless the last one was of the same."""

    def __init__(self) -> None:
        """Begin without one."""
        self._made_from: tuple[object, ...] = ()
        self._last = "", ""

    def draw(self, ground: Ground) -> tuple[str, str]:
        """Give a picture to stand on the colour bar, and a line about it.

        The mask's threshold stands in it where the layer has one.
        """
        layer, ratio = ground.state.options.layer, ground.ratio
        made_from = ground.paint, ground.scale
        if made_from != self._made_from:
            counted = ground.count()
            thresholds = _thresholds(ground.maps, layer, ratio)
            note = summary(counted)
            if ground.paint.shown.comparison is not None:
                note += ground.paint.shown.comparison.in_words
            if thresholds:
                values = " and ".join(f"{value:.3g}" for value, _ in thresholds)
                note += f"; dashed: the mask's threshold, {values} {ground.scale.unit}"
            self._made_from = made_from
            self._last = histogram_svg(counted, ground.scale, thresholds), note
        return self._last


def _thresholds(
    maps: tuple[GradientMap, GradientMap], layer: Layer, ratio: float
) -> tuple[tuple[float, Rgb | None], ...]:
    """Say at which values of the layer the mask stands, and for which submap."""
    if layer == "mask":
        return ((ratio, None),)
    if layer != "std":
        return ()
    query, database = (ratio * gradient_map.signal_std for gradient_map in maps)
    return ((query, None),) if query == database else ((query, QUERY), (database, DATABASE))


def shown_roles(state: ViewState) -> tuple[Role, ...]:
    """Say whose submap is seen at all; blinking shows both in turn."""
    if not state.is_pair:
        return ROLES[:1]
    compare = state.options.compare
    if state.options.layout == "registered" and compare in ROLES:
        return (compare,)
    return ROLES
