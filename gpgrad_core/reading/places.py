"""Places on a planet: which numbers can be a latitude, a longitude and a height."""

HIGHEST = 100_000.0
"""Largest height above or depth below the ellipsoid that counts as one [m]."""


def is_place(latitude: float, longitude: float, height: float) -> bool:
    """Tell whether three numbers can be latitude, longitude [degrees] and height [m]."""
    return abs(latitude) <= 90.0 and abs(longitude) <= 360.0 and abs(height) <= HIGHEST
