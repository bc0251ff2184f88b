"""Both maps as the scene draws them: their colours, the cells that are seen, what a click meets."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from app.viewer.scene.colors import DATABASE, QUERY, Rgb
from app.viewer.scene.comparison import Cells, Values, compare, compared_cells
from app.viewer.scene.histogram import Histogram, count_values, histogram_svg, summary
from app.viewer.scene.layers import Scale, layer_values, shared_scale
from app.viewer.scene.picking import Hit, Ray, first_hit
from app.viewer.scene.placement import Placement
from app.viewer.scene.readout import read
from app.viewer.session.state import Layer, Probe, Role, ViewState
from gpgrad_core.arrays import NDArray
from gpgrad_core.types import GradientMap, Registration

ROLES: tuple[Role, Role] = ("query", "database")


@dataclass(frozen=True, eq=False)
class Comparison:
    """Both maps against each other, at the cells of either.

    Attributes:
        layer: What is compared; one of `state.COMPARED`.
        maps: Of (query, database).
        registration: Under which they are compared.
        z_offset: Added to the query's heights [m].
        max_std_ratio: The variance mask.
        fields: The values at the cells of the query and of the database, in the layer's unit.
    """

    layer: Layer
    maps: tuple[GradientMap, GradientMap]
    registration: Registration
    z_offset: float
    max_std_ratio: float
    fields: tuple[Values, Values]

    @property
    def in_words(self) -> str:
        """The whole in a few words; empty if no cell is common."""
        common = self.fields[1][np.isfinite(self.fields[1])]
        if not len(common):
            return ""
        if self.layer == "agreement":
            return f"; blue agrees: {np.mean(common > 0):.0%} of the common ground"
        return f"; root mean square {np.sqrt(np.mean(common**2)):.3f} m"

    @classmethod
    def between(
        cls,
        layer: Layer,
        maps: tuple[GradientMap, GradientMap],
        registration: Registration,
        z_offset: float,
        max_std_ratio: float,
        last: "Comparison | None" = None,
    ) -> "Comparison | None":
        """Compare two registered maps, unless the last comparison was of the same.

        Returns:
            None if there is no motion to compare them under.
        """
        motion = registration.T_database_query
        if motion is None:
            return None
        made_from = (layer, *maps, registration, z_offset, max_std_ratio)
        if last is not None and made_from == (
            last.layer,
            *last.maps,
            last.registration,
            last.z_offset,
            last.max_std_ratio,
        ):
            return last
        fields = compare(layer, maps, motion, z_offset, max_std_ratio)
        return cls(layer, maps, registration, z_offset, max_std_ratio, fields)


@dataclass(frozen=True, eq=False)
class Ground:
    """The maps of (query, database) in the scene.

    Attributes:
        state: What is asked for.
        maps: The maps; of one submap alone, its map twice, of which the first is seen.
        placements: Where each stands.
        lifts: Added to each map's elevation before it is coloured [m].
        scale: What the colours mean.
        comparison: What colours them in a layer that compares them; None if there is no motion.
        swipe_at: Where the swipe stands along the scene's x [m]; None while there is none.
    """

    state: ViewState
    maps: tuple[GradientMap, GradientMap]
    placements: tuple[Placement, Placement]
    lifts: tuple[float, float]
    scale: Scale
    comparison: Comparison | None
    swipe_at: float | None

    @classmethod
    def of(
        cls,
        state: ViewState,
        maps: tuple[GradientMap, GradientMap],
        placements: tuple[Placement, Placement],
        lifts: tuple[float, float],
        comparison: Comparison | None,
        swipe_at: float | None,
    ) -> "Ground":
        """Choose the scale that both maps are coloured by."""
        options = state.options
        scale = shared_scale(
            maps,
            options.layer,
            options.color_map,
            state.params.features.max_std_ratio,
            lifts,
            None if comparison is None else comparison.fields,
        )
        return cls(state, maps, placements, lifts, scale, comparison, swipe_at)

    def seen(self, index: int) -> Cells | None:
        """Say which cells of the query (0) or the database (1) the swipe leaves; None for all."""
        if self.swipe_at is None:
            return None
        return compared_cells(
            self.maps[index].grid, self.placements[index], ROLES[index], self.swipe_at
        )

    def sees(
        self, index: int, points: Float[NDArray[np.float32], "n 3"]
    ) -> Bool[NDArray[np.bool_], "n"]:
        """Say which points of a submap's frame the swipe leaves to be seen."""
        if self.swipe_at is None:
            return np.ones(len(points), dtype=bool)
        placed = self.placements[index].apply(points.astype(np.float64))
        right = placed[:, 0] > self.swipe_at
        return right if ROLES[index] == "database" else ~right

    def pick(self, ray: Ray) -> Probe | None:
        """Find the place that a line of sight meets first; None if it meets nothing drawn."""
        options, ratio = self.state.options, self.state.params.features.max_std_ratio
        hits: list[tuple[Hit, Role]] = []
        for index, role in enumerate(ROLES):
            if role not in shown_roles(self.state):
                continue
            gradient_map = self.maps[index]
            drawn = np.isfinite(gradient_map.elevation)
            if options.untrusted == "hidden":
                drawn &= gradient_map.trusted(ratio)
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
        ratio = self.state.params.features.max_std_ratio
        reading = read(self.maps[index], probe.x, probe.y, ratio)
        if reading is None or not (reading.trusted or self.state.options.untrusted != "hidden"):
            return None
        return self.placements[index].apply(np.array([[probe.x, probe.y, reading.elevation]]))[0]

    def count(self) -> Histogram:
        """Count the values that the layer shows."""
        layer, ratio = self.state.options.layer, self.state.params.features.max_std_ratio
        maps = self.maps if self.state.is_pair else self.maps[:1]
        fields: tuple[Float[NDArray[np.floating], "_rows _columns"], ...] = (
            self.comparison.fields
            if self.comparison is not None
            else tuple(
                layer_values(gradient_map, layer) + lift
                for gradient_map, lift in zip(maps, self.lifts, strict=False)
            )
        )
        trusted = tuple(gradient_map.trusted(ratio) for gradient_map in maps)
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
        layer, ratio = ground.state.options.layer, ground.state.params.features.max_std_ratio
        made_from = (*ground.maps, layer, ratio, ground.lifts, ground.scale, ground.comparison)
        if made_from != self._made_from:
            counted = ground.count()
            thresholds = _thresholds(ground.maps, layer, ratio)
            note = summary(counted)
            if ground.comparison is not None:
                note += ground.comparison.in_words
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
