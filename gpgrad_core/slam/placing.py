"""Where a drive starts on an elevation model, and where a map lies in a coordinate system."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import Outline
from gpgrad_core.io.georeference import (
    FARTHEST,
    Georeference,
    grid_georeference,
    make_georeference,
    read_origin,
)
from gpgrad_core.io.rasters import Elevations, read_elevation_model
from gpgrad_core.io.records.georeferenced import check_libraries
from gpgrad_core.se2 import SE2
from gpgrad_core.slam.anchoring import AnchorModel, AnchorParams

MOST_STD = 10_000.0
"""Of an elevation model's heights [m]."""
FAR = 100_000.0
"""A model whose corner is so far from the origin of its coordinates [m] gets one of its own."""


def read_anchor(
    path: Path,
    outline: Outline,
    *,
    std: float | None,
    start: str | None,
    origin: str | None,
    crs: str | None,
    params: AnchorParams,
) -> AnchorModel:
    """Read an elevation model, and find out where the drive starts on it.

    The start is a text of easting, northing [m] and yaw [rad], or follows from the drive's origin.

    Raises:
        InputError: If the model or an option cannot be used.
    """
    if std is not None and not 0 < std <= MOST_STD:
        raise InputError(f"--anchor-std must be above 0 and at most {MOST_STD:g} m, got {std:g}")
    begin = None if start is None else _read_start(start)
    elevations = read_elevation_model(path)
    # Near its corner, because clouds are written with few digits.
    far = max(map(abs, elevations.corner)) >= FAR
    east, north = map(float, np.floor(elevations.corner)) if far else (0.0, 0.0)
    if begin is None:
        begin = _start_by_origin(path, outline, elevations, origin, crs)
    if begin is not None:
        begin = SE2(begin.x - east, begin.y - north, begin.yaw)
    corner = elevations.corner[0] - east, elevations.corner[1] - north
    elevations = replace(elevations, corner=corner)
    return AnchorModel(path.name, elevations, (east, north), std, begin, params)


def _read_start(text: str) -> SE2:
    """Read where the first submap is: easting, northing [m] and yaw [rad]."""
    try:
        x, y, yaw = map(float, text.split(","))
    except ValueError:
        x = y = yaw = np.nan
    if not np.isfinite([x, y, yaw]).all() or max(abs(x), abs(y)) > FARTHEST:
        raise InputError(
            f"--anchor-start {text[:60]}: must be E,N,YAW, an easting and a northing [m] of the "
            "model, and a heading [rad]"
        )
    return SE2(x, y, float(np.arctan2(np.sin(yaw), np.cos(yaw))))


def _start_by_origin(
    path: Path, outline: Outline, elevations: Elevations, origin: str | None, crs: str | None
) -> SE2 | None:
    """Find the first submap on the model by the dataset's origin; None without one."""
    dataset = outline.dataset
    place = dataset.origin if origin is None else read_origin(origin)
    if place is None:
        return None
    system = elevations.system or crs
    if system is None:
        raise InputError(
            f"{path}: names no coordinate system, so the drive's origin does not say "
            "where it is on the model; name the model's: --crs EPSG:32633, or say where the "
            "drive starts: --anchor-start E,N,YAW"
        )
    georeference = make_georeference(place, system)
    first = dataset.submaps[0].pose_odometry
    assert first is not None  # as has been checked
    # By its centre: its frame's origin may lie where the coordinate system does not reach.
    centre = outline.load(0)[0].centre
    here = centre + np.array([np.zeros(3), [100.0, 0.0, 0.0]])
    (x, y, _), (x_ahead, y_ahead, _) = georeference.apply(first.apply(here))
    yaw = float(np.arctan2(y_ahead - y, x_ahead - x))
    return SE2(float(x), float(y), yaw) @ SE2(-float(centre[0]), -float(centre[1]))


def georeference_on(
    anchor: AnchorModel, path: Path | None, origin: str | None, crs: str | None
) -> Georeference | None:
    """Place the map in the model's coordinates, if an option asks for coordinates.

    Raises:
        InputError: If the model is in another system than the option names.
    """
    if crs is None and origin is None:
        return None
    check_libraries()
    system = anchor.elevations.system or crs
    if system is None:
        raise InputError(f"{path}: names no coordinate system; name it: --crs EPSG:32633")
    found = grid_georeference(system, anchor.origin)
    if crs is not None and grid_georeference(crs, anchor.origin).name != found.name:
        raise InputError(
            f"{path}: is in {found.name}, not in {crs}; leave --crs out, or "
            f"project the model: gdalwarp -t_srs {crs} …"
        )
    return found
