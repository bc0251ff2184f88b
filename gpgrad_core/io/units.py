"""Units of length that files are in, and what coordinate systems say of them."""

import re

import numpy as np

from gpgrad_core.errors import InputError
from gpgrad_core.libraries import load_library

UNITS = {
    1.0: ("9001", "m", "metre", "meter"),
    0.3048: ("9002", "ft", "foot", "feet", "international foot", "international feet"),
    1200 / 3937: (
        *("9003", "us survey foot", "us survey feet", "survey foot", "survey feet"),
        *("us foot", "us feet", "us ft", "foot us", "ftus", "usft"),
    ),
    0.01: ("1033", "cm", "centimetre", "centimeter"),
    0.001: ("1025", "mm", "millimetre", "millimeter"),
    1000.0: ("9036", "km", "kilometre", "kilometer"),
}
"""EPSG's codes and the names of lengths [m]."""
DEGREES = "is in degrees; project it to metres first"
HEIGHT = re.compile(r',(?:up|down),(?:ORDER\[\d+\],)?LENGTHUNIT\["[^"]*",([^,\]]+)')
"""An axis of heights in well-known text of 2019."""
GEOGRAPHIC, GEOCENTRIC = 2, 3
CODES, OWN_UNIT = range(1, 32767), 32767
OLD_DATUMS = range(5001, 5200)
"""What the first GeoTIFF took for codes of vertical systems; they say nothing of units."""


def unit_length(unit: str) -> float:
    """Give the length of a unit [m] by its name or EPSG's code.

    >>> unit_length("US_survey_feet"), unit_length("Meters"), unit_length("9002")
    (0.3048006096012192, 1.0, 0.3048)
    """
    plain = re.sub(r"[\s_-]+", " ", unit).strip().lower()
    for length, names in UNITS.items():
        if plain in names or plain.removesuffix("s") in names:
            return length
    raise InputError(f"is in {unit!r:.40}, which is no known unit of length; save it in metres")


def units_of_system(system: str | int) -> tuple[float, float | None]:
    """Give the units [m] of a system (text or EPSG code): of the map, and of heights if it has any."""
    rasterio, crs = load_library("rasterio"), load_library("rasterio.crs").CRS
    with rasterio.Env():  # which keeps PROJ from printing
        try:
            found = crs.from_epsg(system) if isinstance(system, int) else crs.from_wkt(system)
            height = HEIGHT.search(found.to_wkt(version="WKT2_2019"))
        except rasterio.errors.CRSError:
            raise InputError(
                f"PROJ does not know its coordinate system {system!r:.60}, so its unit is not "
                "known; save it with one in metres"
            ) from None
        if found.is_geographic:
            raise InputError(DEGREES)
        return float(found.units_factor[1]), None if height is None else float(height[1])


def units_of_keys(directory: bytes) -> tuple[float | None, float | None]:
    """Give the units [m] of the map and of heights that GeoTIFF's directory of keys names.

    The keys are those of the OGC's GeoTIFF standard 1.1 (OGC 19-008r4): ProjLinearUnitsGeoKey
    (3076) comes before the unit of ProjectedCRSGeoKey (3072), and VerticalUnitsGeoKey (4099) before
    that of VerticalGeoKey (4096). A unit that it does not name is None.
    """
    rows = np.frombuffer(directory[: len(directory) // 8 * 8], "<u2").reshape(-1, 4)[1:]
    # Key, where its value is, count, value; texts and real numbers are elsewhere.
    keys = {int(key): int(value) for key, place, _, value in rows if place == 0}
    unsaid = GEOGRAPHIC if 2048 in keys and 3072 not in keys else 0
    if keys.get(1024, unsaid) == GEOGRAPHIC:
        raise InputError(DEGREES)
    if keys.get(1024) == GEOCENTRIC:
        raise InputError("is in geocentric coordinates, whose z is not up; project it first")
    units: list[float | None] = [None, None]
    for axis, (unit, system) in enumerate(((3076, 3072), (4099, 4096))):
        code = keys.get(system, 0)
        if keys.get(unit) == OWN_UNIT:
            raise InputError("is in a unit of its own, which no code names; save it in metres")
        if keys.get(unit, 0) in CODES:
            units[axis] = unit_length(str(keys[unit]))
        elif code in CODES and not (axis == 1 and code in OLD_DATUMS):
            units[axis] = units_of_system(code)[axis]
    return units[0], units[1]
