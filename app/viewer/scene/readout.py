"""The values of the maps at one place."""

from dataclasses import dataclass
from math import atan, atan2, degrees, hypot

import numpy as np

from app.viewer.scene.picking import sample
from app.viewer.session.state import ViewState
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap

LEVEL = 1e-6
"""Ground less steep than this faces nowhere [m/m]."""


@dataclass(frozen=True)
class Reading:
    """The terrain at one place of a submap.

    Attributes:
        x: In the submap's frame [m].
        y: In the submap's frame [m].
        elevation: Posterior mean [m].
        std: Posterior standard deviation of it [m].
        trusted: Whether the variance mask lets the cell pass.
        slope: Steepness [degrees].
        aspect: Where the ground falls to, clockwise from +y, as maps have it from north
            [degrees]; None where it is level.
    """

    x: float
    y: float
    elevation: float
    std: float
    trusted: bool
    slope: float
    aspect: float | None


def read(gradient_map: GradientMap, x: float, y: float, max_std_ratio: float) -> Reading | None:
    """Read a map between its cells.

    Args:
        gradient_map: The map.
        x: In the submap's frame [m].
        y: In the submap's frame [m].
        max_std_ratio: The variance mask.

    Returns:
        None beyond the map's rim.
    """
    grid = gradient_map.grid
    pixel = grid.to_pixel(np.array([[x, y]]))
    rows, columns = grid.shape
    column, row = (int(place) for place in np.rint(pixel[0]))
    if not (0 <= row < rows and 0 <= column < columns):
        return None
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
        bool(gradient_map.trusted(max_std_ratio)[row, column]),
        degrees(atan(steepness)),
        degrees(atan2(-slope_x, -slope_y)) % 360.0 if steepness > LEVEL else None,
    )


def reading_of(state: ViewState, maps: tuple[GradientMap, GradientMap]) -> Reading | None:
    """Read the place that the state points at, if it does and the map reaches there.

    Args:
        state: What points, and the variance mask.
        maps: Of query and database.
    """
    probe = state.probe
    if probe is None:
        return None
    read_map = maps[0 if probe.role == "query" else 1]
    return read(read_map, probe.x, probe.y, state.params.features.max_std_ratio)


def other_place(
    T_database_query: SE2, x: float, y: float, *, of_query: bool
) -> tuple[float, float]:
    """Give the same place in the other submap's frame [m], under the motion found."""
    motion = T_database_query if of_query else T_database_query.inverse()
    there = motion.apply(np.array([[x, y]]))[0]
    return float(there[0]), float(there[1])


def label_text(reading: Reading) -> str:
    """Write a reading as a short label for the point itself."""
    digits = significant_digits(reading.std)
    return (
        f"{reading.elevation:z.{digits}f} ± {reading.std:.{digits}f} m · slope {reading.slope:.1f}°"
    )


def significant_digits(std: float) -> int:
    """Give the number of decimals of a height: two digits of its deviation, 2 to 5 in all.

    >>> significant_digits(0.0123), significant_digits(0.5)
    (3, 2)
    """
    if not np.isfinite(std) or std <= 0:
        return 3
    return int(np.clip(1 - np.floor(np.log10(std)), 2, 5))
