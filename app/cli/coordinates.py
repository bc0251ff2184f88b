"""``--origin`` and ``--crs``: where a local frame lies on the Earth, Mars or the Moon."""

from typing import Annotated, TypeAlias

import tyro
from typing_extensions import Doc

from gpgrad_core.errors import InputError
from gpgrad_core.io.georeference import Georeference, make_georeference, read_origin
from gpgrad_core.io.records.georeferenced import check_libraries

UTM = "UTM"

OriginFlag: TypeAlias = Annotated[
    str | None,
    Doc(
        "Where x = y = z = 0 is, with x to the east and y to the north: latitude, longitude "
        "[degrees] and height above the ellipsoid [m], or easting, northing and height [m]. After "
        "an equals sign it may begin with a minus."
    ),
    tyro.conf.arg(metavar="LAT,LON,HEIGHT", help_behavior_hint="(default: that of dataset.toml)"),
]
CrsFlag: TypeAlias = Annotated[
    str | None,
    Doc(
        "Coordinate system to write in: a projection in metres, such as EPSG:32633 or "
        "IAU_2015:49910. UTM takes the zone of the origin. Needs pip install 'gpgrad[geo]'."
    ),
    tyro.conf.arg(metavar="CODE", help_behavior_hint="(default: UTM if there is an origin)"),
]


def georeference_of(
    origin: str | None, crs: str | None, known: tuple[float, float, float] | None
) -> Georeference | None:
    """Place a local frame as the flags ask; None if they ask for nothing.

    Args:
        origin: What --origin says.
        crs: What --crs says.
        known: Origin that the dataset gives.

    Raises:
        InputError: If the origin is not known, a value cannot be, or a library is missing.
    """
    if origin is None and crs is None:
        return None
    place = known if origin is None else read_origin(origin)
    if place is None:
        raise InputError(
            f"--crs {crs}: the dataset does not say where it lies; give --origin LAT,LON,HEIGHT"
        )
    check_libraries()
    return make_georeference(place, None if crs is None or crs.upper() == UTM else crs)
