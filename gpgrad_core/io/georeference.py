"""Where a local frame lies on the Earth, Mars or the Moon, and the units of coordinate systems.

The guide has the equations (coordinates.md); pyproj's PROJ computes all but `east_north_up`.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.libraries import load_library

EXTRA = "gpgrad[geo]"
Transformer: TypeAlias = Any
CoordinateSystem: TypeAlias = Any
"""Of pyproj, which may not be installed."""
HIGHEST = 100_000.0
"""Largest height above or depth below an ellipsoid that counts as one [m]."""
SEMI_MAJOR, FLATTENING = 6_378_137.0, 1.0 / 298.257223563
BEYOND = 3.0
"""So far outside of its area a system is still used [degrees]."""
FARTHEST = 1e8
"""Largest easting or northing of a map [m]; no map of a planet that people walk on is larger."""
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
EARTH_CENTRED = "is in geocentric coordinates, whose z is not up; project it to metres first"
DEPTHS = "has depths, which count downwards; change their sign, and name a system of heights"
STRETCHED = "is in Mercator, whose metres are not those of the ground; project it to UTM first"
MERCATOR = re.compile('METHOD\\["Popular Visualisation Pseudo Mercator"|World Mercator"')
HEIGHT = re.compile(r',(?:up|down),(?:ORDER\[\d+\],)?LENGTHUNIT\["[^"]*",([^,\]]+)')
"""An axis of heights in well-known text of 2019."""
DOWNWARDS = re.compile(r'AXIS\["[^"]*",down\b')
GEOGRAPHIC, GEOCENTRIC = 2, 3
CODES, OWN_UNIT = range(1, 32767), 32767
OLD_DATUMS = range(5001, 5200)
"""What the first GeoTIFF took for codes of vertical systems; they say nothing of units."""


@dataclass(frozen=True, eq=False)
class Georeference:
    """The place of a local frame in a coordinate system."""

    name: str  # of the system, such as ``EPSG:32633``
    wkt: str  # the system in well-known text
    # longitude, latitude [degrees] and height [m] of the frame's origin
    origin: tuple[float, float, float]
    _to_degrees: Transformer
    _to_system: Transformer

    def geographic(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Longitude (to the east), latitude [degrees] and height [m] of points (n, 3) [m]."""
        return np.column_stack(self._to_degrees.transform(*points.T))

    def apply(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Easting, northing and height [m] of points of the local frame (n, 3) [m]."""
        longitude, latitude, height = self.geographic(points).T
        x, y = self._to_system.transform(longitude, latitude)
        return np.column_stack([x, y, height])


def check_place(place: Sequence[float], where: str) -> None:
    """Raise InputError unless latitude, longitude [degrees], height [m] are possible."""
    latitude, longitude, height = place
    if abs(latitude) > 90.0 or abs(longitude) > 360.0 or abs(height) > HIGHEST:
        numbers = " ".join(f"{number:.10g}" for number in place)
        raise InputError(f"{where}: {numbers} are no latitude, longitude, height")


def east_north_up(places: Float[Array, "n 3"], origin: Float[Array, "3"]) -> Float[Array, "n 3"]:
    """Metres east, north and up of places (latitude, longitude [degrees], height [m])."""
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


def read_origin(text: str) -> tuple[float, float, float]:
    """Read three numbers that are separated by commas.

    >>> read_origin("37.75,14.99,2900")
    (37.75, 14.99, 2900.0)
    """
    words = text.split(",")
    try:
        numbers = tuple(float(word) for word in words)
    except ValueError:
        numbers = ()
    if len(numbers) != 3 or not all(np.isfinite(numbers)):
        raise InputError(
            f"an origin is LAT,LON,HEIGHT in degrees and metres, or E,N,HEIGHT in metres, got "
            f"{text[:60]!r}"
        )
    return numbers[0], numbers[1], numbers[2]


def is_geographic(origin: tuple[float, float, float]) -> bool:
    """Whether an origin is a latitude and a longitude, not an easting and a northing."""
    return abs(origin[0]) <= 90.0 and abs(origin[1]) <= 360.0


def make_georeference(origin: tuple[float, float, float], crs: str | None = None) -> Georeference:
    """Place a local frame; InputError if there is no such place or system, or pyproj is missing.

    The origin is latitude and longitude [degrees] on the system's own ellipsoid, or easting and
    northing [m] in the system; and height above the ellipsoid [m]. The system is a projection in
    metres, as PROJ names it; None takes the zone of UTM, on the Earth.
    """
    first, second, height = origin
    if abs(height) > HIGHEST:
        raise InputError(f"an origin's height lies within {HIGHEST:,.0f} m, got {height:g}")
    if not is_geographic(origin) and max(abs(first), abs(second)) > FARTHEST:
        raise InputError(f"an origin's E and N lie within {FARTHEST:g} m, got {first:g},{second:g}")
    if crs is None:
        if not is_geographic(origin):
            raise InputError("an origin in E,N,HEIGHT needs the system that these belong to: --crs")
        crs = _zone(first, (second + 180.0) % 360.0 - 180.0)
    pyproj, system, to_system = _system(crs)
    if is_geographic(origin):
        latitude, longitude = first, second
    else:
        longitude, latitude = to_system.transform(first, second, direction="INVERSE")
    _check_inside(system, longitude, latitude, f"the origin {first:g},{second:g}")
    ellipsoid = system.ellipsoid
    size = f"+a={ellipsoid.semi_major_metre!r} +b={ellipsoid.semi_minor_metre!r}"
    to_degrees = pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=topocentric {size} +lon_0={longitude!r} "
        f"+lat_0={latitude!r} +h_0={height!r} +step +inv +proj=cart {size} "
        "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    place = (float(longitude), float(latitude), float(height))
    georeference = Georeference(system.to_string(), system.to_wkt(), place, to_degrees, to_system)
    if not np.isfinite(georeference.apply(np.zeros((1, 3)))).all():
        raise InputError(f"PROJ cannot compute {crs} near {latitude:g},{longitude:g}; name another")
    return georeference


def grid_georeference(crs: str, origin: tuple[float, float]) -> Georeference:
    """Place a flat frame with the axes and heights of a map, at its easting and northing [m]."""
    _, system, to_system = _system(crs)
    longitude, latitude = to_system.transform(*origin, direction="INVERSE")
    _check_inside(system, longitude, latitude, f"the origin {origin[0]:.10g},{origin[1]:.10g}")
    place = (float(longitude), float(latitude), 0.0)
    shifted = _ShiftedMap(to_system, *origin)
    return Georeference(system.to_string(), system.to_wkt(), place, shifted, to_system)


@dataclass(frozen=True, eq=False)
class _ShiftedMap:
    """From metres east and north of an origin of a map to longitude and latitude."""

    to_system: Transformer
    east: float
    north: float

    def transform(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        longitude, latitude = self.to_system.transform(
            x + self.east, y + self.north, direction="INVERSE"
        )
        return longitude, latitude, z


def _check_inside(system: CoordinateSystem, longitude: float, latitude: float, what: str) -> None:
    """Refuse an origin far outside of the area that a system is made for."""
    area = system.area_of_use
    inside = bool(np.isfinite(longitude) and np.isfinite(latitude))
    if inside and area is not None:
        half = 0.5 * ((area.east - area.west) % 360.0 or 360.0)
        beside = abs((longitude - area.west - half + 180.0) % 360.0 - 180.0)
        inside = beside <= half + BEYOND and (
            area.south - BEYOND <= latitude <= area.north + BEYOND
        )
    if not inside:
        where = "" if area is None else f" ({area.name})"
        raise InputError(f"{what} lies outside of {system.to_string()}{where}")


def _zone(latitude: float, longitude: float) -> str:
    """Name the zone of UTM, or at the poles the stereographic map, by EPSG's codes."""
    if latitude > 84.0 or latitude < -80.0:
        return f"EPSG:{5041 if latitude > 0 else 5042}"
    number = int((longitude + 180.0) // 6.0) % 60 + 1
    return f"EPSG:{(32600 if latitude >= 0 else 32700) + number}"


def _system(crs: str) -> tuple[ModuleType, CoordinateSystem, Transformer]:
    """Pyproj, the named system, and the transformer into it from longitude and latitude."""
    pyproj = load_library("pyproj", EXTRA)
    try:
        system = pyproj.CRS.from_user_input(crs)
    except pyproj.exceptions.CRSError as error:
        raise InputError(
            f"{crs[:60]!r} is no coordinate system that PROJ knows; name one such as EPSG:32633 or "
            "IAU_2015:49910"
        ) from error
    units = {axis.unit_name for axis in system.axis_info[:2]}
    if not system.is_projected or not units <= {"metre", "meter"}:
        raise InputError(
            f"{crs[:60]}: is {system.type_name} in {' and '.join(sorted(units)) or 'no unit'}; a "
            "map needs a projection in metres, such as a zone of UTM"
        )
    if any(axis.direction not in ("east", "north", "south") for axis in system.axis_info[:2]):
        raise InputError(
            f"{crs[:60]}: counts to the west; name the system of the same body that counts to the "
            "east"
        )
    to_system = pyproj.Transformer.from_crs(system.geodetic_crs, system, always_xy=True)
    return pyproj, system, to_system


def unit_length(unit: str) -> float:
    """The length of a unit [m] by its name or EPSG's code.

    >>> unit_length("US_survey_feet"), unit_length("Meters"), unit_length("9002")
    (0.3048006096012192, 1.0, 0.3048)
    """
    plain = re.sub(r"[\s_-]+", " ", unit).strip().lower()
    for length, names in UNITS.items():
        if plain in names or plain.removesuffix("s") in names:
            return length
    raise InputError(f"is in {unit!r:.40}, which is no known unit of length; save it in metres")


def units_of_system(
    system: str | int, otherwise: float | None = None
) -> tuple[float | None, float | None]:
    """The units [m] of a system (text or EPSG code): of its map, and heights if it has any.

    If PROJ does not know it, they are `otherwise`; without that it is refused.
    """
    rasterio, crs = load_library("rasterio"), load_library("rasterio.crs").CRS
    with rasterio.Env():  # which keeps PROJ from printing
        try:
            resolved = crs.from_epsg(system) if isinstance(system, int) else crs.from_wkt(system)
            return units_of_crs(resolved)
        except rasterio.errors.CRSError:
            if otherwise is not None:
                return otherwise, otherwise
            raise InputError(
                f"PROJ does not know its coordinate system {system!r:.60}, so its unit is not "
                "known; save it with one in metres"
            ) from None


def units_of_crs(crs: CoordinateSystem) -> tuple[float, float | None]:
    """The units [m] of rasterio's CRS; InputError if its axes are not of the ground."""
    axes = crs.to_wkt(version="WKT2_2019")
    if crs.is_geographic:
        raise InputError(DEGREES)
    if "geocentricX" in axes:
        raise InputError(EARTH_CENTRED)
    if DOWNWARDS.search(axes):
        raise InputError(DEPTHS)
    if MERCATOR.search(axes):
        raise InputError(STRETCHED)
    height = HEIGHT.search(axes)
    return float(crs.units_factor[1]), None if height is None else float(height[1])


def units_of_keys(directory: bytes) -> tuple[float | None, float | None]:
    """The units [m] of the map and of heights that GeoTIFF's directory of keys names.

    The keys are those of the OGC's GeoTIFF standard 1.1 (OGC 19-008r4): ProjLinearUnitsGeoKey
    (3076) comes before the unit of ProjectedCRSGeoKey (3072), and VerticalUnitsGeoKey (4099) before
    that of VerticalGeoKey (4096). A unit that it does not name is None.
    """
    rows = np.frombuffer(directory[: len(directory) // 8 * 8], "<u2").reshape(-1, 4)[1:]
    # Key, where its value is, count, value; texts and real numbers are elsewhere.
    keys = {int(key): int(value) for key, place, _, value in rows if place == 0}
    unsaid = GEOGRAPHIC if 2048 in keys and 3072 not in keys else 0
    if keys.get(1024, unsaid) == GEOGRAPHIC:
        if keys.get(2048, 0) in CODES:  # its code may be that of a geocentric system
            units_of_system(keys[2048])
        raise InputError(DEGREES)
    if keys.get(1024) == GEOCENTRIC:
        raise InputError(EARTH_CENTRED)
    units: list[float | None] = [None, None]
    for axis, (unit, system) in enumerate(((3076, 3072), (4099, 4096))):
        code, own = keys.get(system, 0), keys.get(unit, 0)
        if own == OWN_UNIT:
            raise InputError("is in a unit of its own, which no code names; save it in metres")
        units[axis] = unit_length(str(own)) if own in CODES else None
        if code in CODES and not (axis == 1 and code in OLD_DATUMS):
            # The system is looked up in any case, because its heights may count downwards.
            named = units_of_system(code, otherwise=units[axis])[axis]
            units[axis] = named if units[axis] is None else units[axis]
    return units[0], units[1]
