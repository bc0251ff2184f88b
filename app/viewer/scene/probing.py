"""Places on the ground: where a click meets it, what the maps say there, and along a line."""

from dataclasses import dataclass
from math import atan, atan2, degrees, hypot
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from app.viewer.scene.placement import Placement
from app.viewer.session.state import ROLES, Probe, Role
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap

Drawn: TypeAlias = Bool[NDArray[np.bool_], "rows columns"]

STEPS_PER_CELL = 2.0
"""Samples of the line of sight: a ridge narrower than half a cell is not in the map either."""
MAX_STEPS = 40_000
NEAR_RIM = 0.8
"""How far beyond the centres of the outermost cells their squares still reach [cells]."""
LEVEL = 1e-6
"""Ground less steep than this faces nowhere [m/m]."""
SAMPLES = 200
"""Places along a line at which both maps are read."""


@dataclass(frozen=True, eq=False)
class Ray:
    """A line of sight in the scene, z up."""

    origin: Float[Array, "3"]  # [m]
    direction: Float[Array, "3"]  # of any length but zero

    def into(self, placement: Placement) -> "Ray":
        back, flat = placement.pose.inverse(), (1.0, 1.0, 1.0 / placement.exaggeration)
        direction = self.direction @ placement.pose.rotation
        return Ray(back.apply(self.origin[None])[0] * flat, direction * flat)


@dataclass(frozen=True)
class Hit:
    """Where a line of sight first meets a surface."""

    distance: float  # from the eye, in lengths of the ray's direction
    x: float  # [m], submap frame
    y: float


def first_hit(
    ray: Ray, gradient_map: GradientMap, placement: Placement, drawn: Drawn
) -> Hit | None:
    """Find where a line of sight first meets drawn cells of a map; it passes through others."""
    if not drawn.any():
        return None
    local = ray.into(placement)
    span = _within(local, _box(gradient_map, drawn))
    if span is None:
        return None
    length = float(np.linalg.norm(local.direction)) * (span[1] - span[0])
    count = int(np.ceil(STEPS_PER_CELL * length / gradient_map.grid.resolution)) + 2
    distances = np.linspace(*span, min(count, MAX_STEPS))
    points = local.origin + distances[:, None] * local.direction
    pixels = gradient_map.grid.to_pixel(points[:, :2])
    above = points[:, 2] - sample(gradient_map.elevation, pixels)
    row, column, _ = gradient_map.grid.nearest_cells(points[:, :2])
    crossed = (above[:-1] > 0) != (above[1:] > 0)
    met = np.flatnonzero(crossed & drawn[row, column][1:])
    if len(met) == 0:
        return None
    k = int(met[0])
    share = above[k] / (above[k] - above[k + 1])
    distance = float(distances[k] + share * (distances[k + 1] - distances[k]))
    x, y, _ = local.origin + distance * local.direction
    return Hit(distance, float(x), float(y))


def sample(values: Float[Array, "rows columns"], pixels: Float[Array, "n 2"]) -> Float[Array, "n"]:
    """Read a field between cells, at fractional (column, row); beyond its rim, as at the rim."""
    return ndimage.map_coordinates(values, pixels.T[::-1], order=1, mode="nearest")


def _box(gradient_map: GradientMap, drawn: Drawn) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    heights = gradient_map.elevation[drawn]
    rim = NEAR_RIM * gradient_map.grid.resolution
    low_x, low_y = gradient_map.grid.x[0] - rim, gradient_map.grid.y[0] - rim
    high_x, high_y = gradient_map.grid.x[-1] + rim, gradient_map.grid.y[-1] + rim
    margin = max(1e-6, rim)  # level ground is a box, too
    return (
        np.array([low_x, low_y, heights.min() - margin]),
        np.array([high_x, high_y, heights.max() + margin]),
    )


def _within(
    ray: Ray, box: tuple[Float[Array, "3"], Float[Array, "3"]]
) -> tuple[float, float] | None:
    """The stretch of a line, from its eye on, that lies in a box: the slab method."""
    with np.errstate(divide="ignore", invalid="ignore"):
        to_low, to_high = ((corner - ray.origin) / ray.direction for corner in box)
    # A line along a slab's face gives 0/0: it is inside that slab.
    near = np.fmin(to_low, to_high)
    far = np.fmax(to_low, to_high)
    enters, leaves = float(np.nanmax(near, initial=0.0)), float(np.nanmin(far, initial=np.inf))
    return (enters, leaves) if enters < leaves and np.isfinite(leaves) else None


@dataclass(frozen=True)
class Reading:
    """The terrain at one place of a submap."""

    x: float  # [m], in the submap's frame
    y: float
    elevation: float  # posterior mean [m]
    std: float  # posterior standard deviation of it [m]
    trusted: bool  # whether the variance mask lets the cell pass
    slope: float  # steepness [degrees]
    # where the ground falls to, clockwise from +y, as maps have it from north [degrees]; None
    # where it is level
    aspect: float | None


def read(gradient_map: GradientMap, x: float, y: float, max_std_ratio: float) -> Reading | None:
    """Read a map between its cells, at a place of the submap's frame [m]; None beyond its rim."""
    place = np.array([[x, y]])
    row, column, inside = gradient_map.grid.nearest_cells(place)
    if not inside[0]:
        return None
    pixel = gradient_map.grid.to_pixel(place)
    elevation, variance, slope_x, slope_y = (
        float(sample(field, pixel)[0])
        for field in (
            gradient_map.elevation,
            gradient_map.variance,
            gradient_map.slope[..., 0],
            gradient_map.slope[..., 1],
        )
    )
    steepness = hypot(slope_x, slope_y)
    return Reading(
        x,
        y,
        elevation,
        float(np.sqrt(max(variance, 0.0))),
        bool(gradient_map.trusted(max_std_ratio)[row, column][0]),
        degrees(atan(steepness)),
        degrees(atan2(-slope_x, -slope_y)) % 360.0 if steepness > LEVEL else None,
    )


def places_of(probe: Probe, T_database_query: SE2 | None) -> dict[Role, NDArray[np.float64]]:
    """A place in the frame of each submap [m]; without a motion, in its own only."""
    here = np.array([probe.x, probe.y])
    places: dict[Role, NDArray[np.float64]] = {probe.role: here}
    if T_database_query is not None and probe.role == "query":
        places["database"] = T_database_query.apply(here[None])[0]
    elif T_database_query is not None:
        places["query"] = T_database_query.inverse().apply(here[None])[0]
    return places


def read_both(
    maps: tuple[GradientMap, GradientMap],
    probe: Probe | None,
    T_database_query: SE2 | None,
    max_std_ratio: float,
) -> tuple[Reading | None, Reading | None]:
    """Read a place in (query, database) under the motion; None where it cannot be read."""
    places = {} if probe is None else places_of(probe, T_database_query)
    query, database = (
        read(a_map, float(places[role][0]), float(places[role][1]), max_std_ratio)
        if role in places
        else None
        for role, a_map in zip(ROLES, maps, strict=True)
    )
    return query, database


def label_text(reading: Reading) -> str:
    """Write a reading as a short label for the point itself."""
    digits = significant_digits(reading.std)
    return (
        f"{reading.elevation:z.{digits}f} ± {reading.std:.{digits}f} m · slope {reading.slope:.1f}°"
    )


def significant_digits(std: float) -> int:
    """The number of decimals of a height: two digits of its deviation, 2 to 5 in all.

    >>> significant_digits(0.0123), significant_digits(0.5)
    (3, 2)
    """
    if not np.isfinite(std) or std <= 0:
        return 3
    return int(np.clip(1 - np.floor(np.log10(std)), 2, 5))


@dataclass(frozen=True, eq=False)
class Profile:
    """What one map says along the line; NaN where it saw no ground."""

    xy: Float[Array, "n 2"]  # in the map's own frame [m]
    elevation: Float[Array, "n"]  # [m]
    std: Float[Array, "n"]  # [m]

    @property
    def is_known(self) -> bool:
        return bool(np.isfinite(self.elevation).any())


@dataclass(frozen=True, eq=False)
class Ruler:
    """A measured line."""

    along: Float[Array, "n"]  # distance of each place from the first end, in the plane [m]
    # heights of the query, lifted to those of the database, and of the database; without a motion
    # there is only that on which the line lies
    query: Profile | None
    database: Profile | None
    rise: float  # how much higher the second end lies [m]; NaN if either is unknown
    rise_std: float  # its deviation, as if the errors of both ends were independent [m]

    @property
    def length(self) -> float:
        return float(self.along[-1])

    @property
    def slope(self) -> float:
        """From the first end to the second [degrees]; positive upwards, NaN if unknown."""
        return degrees(atan2(self.rise, self.length)) if self.length > 0 else np.nan


def measure(
    maps: tuple[GradientMap, GradientMap],
    ends: tuple[Probe, Probe],
    T_database_query: SE2 | None,
    z_offset: float,
    max_std_ratio: float,
) -> Ruler | None:
    """Measure the line between two places, of which either may lie on either submap.

    The offset is the height of the query's zero in the database's frame [m]; 0 without a motion.
    None if the ends lie on different submaps and no motion joins these.
    """
    motion = T_database_query
    if motion is None and ends[0].role != ends[1].role:
        return None
    starts, stops = (places_of(end, motion) for end in ends)
    along = np.linspace(0.0, hypot(*(stops[ends[0].role] - starts[ends[0].role])), SAMPLES)
    heights = {
        role: _read_along(
            maps[ROLES.index(role)],
            np.stack([starts[role], stops[role]]),
            z_offset if role == "query" else 0.0,
            max_std_ratio,
        )
        for role in starts
    }
    first, last = heights[ends[0].role], heights[ends[1].role]
    rise = float(last.elevation[-1] - first.elevation[0])
    rise_std = float(np.hypot(first.std[0], last.std[-1]))
    return Ruler(along, heights.get("query"), heights.get("database"), rise, rise_std)


def _read_along(
    gradient_map: GradientMap, ends: Float[Array, "2 2"], lift: float, max_std_ratio: float
) -> Profile:
    share = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    xy = (1.0 - share) * ends[0] + share * ends[1]
    row, column, inside = gradient_map.grid.nearest_cells(xy)
    seen = inside & gradient_map.trusted(max_std_ratio)[row, column]
    pixels = gradient_map.grid.to_pixel(xy)
    elevation = sample(gradient_map.elevation, pixels) + lift
    std = np.sqrt(np.maximum(sample(gradient_map.variance, pixels), 0.0))
    return Profile(xy, np.where(seen, elevation, np.nan), np.where(seen, std, np.nan))
