"""A straight line over the ground: how long and how steep it is, and the heights along it."""

from dataclasses import dataclass
from math import atan2, degrees, hypot

import numpy as np
from jaxtyping import Float

from app.viewer.scene.picking import sample
from app.viewer.session.state import Probe, Role
from gpgrad_core.arrays import Array
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap

SAMPLES = 200
"""Places along the line at which both maps are read."""


@dataclass(frozen=True, eq=False)
class Heights:
    """What one map says along the line; NaN where it saw no ground."""

    xy: Float[Array, "n 2"]  # in the map's own frame [m]
    elevation: Float[Array, "n"]  # [m]
    std: Float[Array, "n"]  # [m]

    @property
    def is_known(self) -> bool:
        """Whether any of it is known."""
        return bool(np.isfinite(self.elevation).any())


@dataclass(frozen=True, eq=False)
class Ruler:
    """A measured line.

    Attributes:
        along: Distance of each place from the first end, in the plane [m].
        query: Heights of the query, lifted to those of the database; None if no motion is known
            and the line lies on the database.
        database: Heights of the database; None in the other case.
        rise: How much higher the second end lies than the first [m]; NaN if either is unknown.
        rise_std: Standard deviation of that, as if the errors of both ends were independent [m].
    """

    along: Float[Array, "n"]
    query: Heights | None
    database: Heights | None
    rise: float
    rise_std: float

    @property
    def length(self) -> float:
        """Of the line in the plane [m]."""
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
    """Measure the line between two places.

    Args:
        maps: Of query and database.
        ends: Either may lie on either submap.
        T_database_query: The motion found, if any.
        z_offset: Height of the query's zero in the database's frame [m].
        max_std_ratio: The variance mask.

    Returns:
        None if the ends lie on different submaps and no motion joins these.
    """
    motion = T_database_query
    if motion is None and ends[0].role != ends[1].role:
        return None
    places: dict[Role, Float[Array, "2 2"]] = {}
    if motion is None:
        places[ends[0].role] = np.array([(end.x, end.y) for end in ends])
    else:
        points = [np.array([[end.x, end.y]]) for end in ends]
        in_database = np.concatenate(
            [
                motion.apply(point) if end.role == "query" else point
                for end, point in zip(ends, points, strict=True)
            ]
        )
        places["query"] = motion.inverse().apply(in_database)
        places["database"] = in_database
    start, end = next(iter(places.values()))
    along = np.linspace(0.0, hypot(*(end - start)), SAMPLES)
    heights: dict[Role, Heights] = {
        role: _read_along(
            maps[0 if role == "query" else 1],
            between,
            z_offset if role == "query" and motion is not None else 0.0,
            max_std_ratio,
        )
        for role, between in places.items()
    }
    first, last = heights[ends[0].role], heights[ends[1].role]
    rise = float(last.elevation[-1] - first.elevation[0])
    rise_std = float(np.hypot(first.std[0], last.std[-1]))
    return Ruler(along, heights.get("query"), heights.get("database"), rise, rise_std)


def _read_along(
    gradient_map: GradientMap, ends: Float[Array, "2 2"], lift: float, max_std_ratio: float
) -> Heights:
    """Read a map at even steps between two places of its frame."""
    share = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    xy = (1.0 - share) * ends[0] + share * ends[1]
    pixels = gradient_map.grid.to_pixel(xy)
    column, row = np.rint(pixels).astype(np.intp).T
    rows, columns = gradient_map.grid.shape
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    trusted = gradient_map.trusted(max_std_ratio)
    seen = inside & trusted[row.clip(0, rows - 1), column.clip(0, columns - 1)]
    elevation = sample(gradient_map.elevation, pixels) + lift
    std = np.sqrt(np.maximum(sample(gradient_map.variance, pixels), 0.0))
    return Heights(xy, np.where(seen, elevation, np.nan), np.where(seen, std, np.nan))
