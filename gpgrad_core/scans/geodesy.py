"""Latitude, longitude and height on the Earth -> metres east, north and up of an origin.

The ellipsoid is WGS 84 (NIMA TR8350.2: a = 6378137 m, 1/f = 298.257223563). A position becomes
geocentric by the closed form of that report, and the difference to the origin is turned into the
origin's horizon. So heights above the ellipsoid stay heights within millimetres near the origin,
and distances are not scaled, as they would be in a map projection.
"""

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array

SEMI_MAJOR, FLATTENING = 6_378_137.0, 1.0 / 298.257223563


def east_north_up(places: Float[Array, "n 3"], origin: Float[Array, "3"]) -> Float[Array, "n 3"]:
    """Give positions relative to an origin, in its horizon.

    Args:
        places: Latitude [degrees], longitude [degrees] and height above the ellipsoid [m] (n, 3).
        origin: The same of the origin (3,).

    Returns:
        Metres east, north and up (n, 3).
    """
    latitude, longitude = np.radians(origin[:2])
    s, c = np.sin(latitude), np.cos(latitude)
    t, d = np.sin(longitude), np.cos(longitude)
    turn = np.array([[-t, d, 0.0], [-s * d, -s * t, c], [c * d, c * t, s]])
    return (_geocentric(places) - _geocentric(origin[None])) @ turn.T


def _geocentric(places: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    latitude, longitude = np.radians(places[:, 0]), np.radians(places[:, 1])
    height = places[:, 2]
    squared = FLATTENING * (2.0 - FLATTENING)
    across = SEMI_MAJOR / np.sqrt(1.0 - squared * np.sin(latitude) ** 2)
    level = (across + height) * np.cos(latitude)
    up = (across * (1.0 - squared) + height) * np.sin(latitude)
    return np.column_stack([level * np.cos(longitude), level * np.sin(longitude), up])
