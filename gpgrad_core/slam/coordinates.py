"""Where a drive starts on an elevation model, and where a map lies in a coordinate system."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
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
from gpgrad_core.io.records.georeferenced import check_libraries, write_geojson, write_kml
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam.anchoring import AnchorModel, AnchorParams
from gpgrad_core.slam.errors import positions

MOST_STD = 10_000.0
"""Of an elevation model's heights [m]."""
FAR = 100_000.0
"""A model whose corner is so far from the origin of its coordinates [m] gets one of its own."""
LEAST_SPREAD = 1.0
"""Root mean square distance from the middle [m] from which positions tell a direction."""


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
    """Place the map in the model's coordinates, if an option asks for coordinates."""
    if crs is None and origin is None:
        return None
    check_libraries()
    system = anchor.elevations.system or crs
    if system is None:
        raise InputError(f"{path}: names no coordinate system; name it: --crs EPSG:32633")
    georeference = grid_georeference(system, anchor.origin)
    if crs is not None and grid_georeference(crs, anchor.origin).name != georeference.name:
        raise InputError(
            f"{path}: is in {georeference.name}, not in {crs}; leave --crs out, or "
            f"project the model: gdalwarp -t_srs {crs} …"
        )
    return georeference


@dataclass(frozen=True, eq=False)
class MapCoordinates:
    """Where the world of a map lies in a coordinate system."""

    georeference: Georeference  # places the frame in which x points east and y north
    T_local_world: Pose  # brings the map's world into that frame
    by_truth: bool  # whether the true positions say so; else the world is taken for that frame
    by_anchor: bool = False  # whether the world is that frame, because an elevation model says so

    def __str__(self) -> str:
        """The map's coordinates and what places it, in words."""
        by = "the true positions" if self.by_truth else "odometry's frame, x east and y north"
        if self.by_anchor:
            by = "the elevation model"
        longitude, latitude, height = self.georeference.origin
        return (
            f"in {self.georeference.name}, origin {latitude:.7f}, {longitude:.7f}, {height:.2f} m, "
            f"placed by {by}"
        )

    def apply(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Easting, northing and height [m] of points of the world (n, 3) [m]."""
        return self.georeference.apply(self.T_local_world.apply(points))

    def geographic(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Longitude, latitude [degrees] and height [m] of points of the world (n, 3) [m]."""
        return self.georeference.geographic(self.T_local_world.apply(points))


def find_coordinates(
    poses: Mapping[str, Pose], true: Mapping[str, Pose], georeference: Georeference
) -> MapCoordinates:
    """Find a map's coordinates by true positions of its submaps, or else as odometry began."""
    names = [name for name in true if name in poses]
    if len(names) < 2:
        return MapCoordinates(georeference, Pose.from_planar(SE2()), by_truth=False)
    motion = level_motion(positions(names, poses), positions(names, true))
    return MapCoordinates(georeference, motion, by_truth=True)


def level_motion(places: Float[Array, "n 3"], target: Float[Array, "n 3"]) -> Pose:
    """Find ``T_target_places``, about the vertical, that fits positions [m] best."""
    middle, aim = places.mean(axis=0), target.mean(axis=0)
    x, y, _ = (places - middle).T
    along, across, _ = (target - aim).T
    spread = float(np.sqrt(np.mean(x * x + y * y)))
    yaw = float(np.arctan2(x @ across - y @ along, x @ along + y @ across))
    turn = SE2(0.0, 0.0, yaw if spread > LEAST_SPREAD else 0.0)
    offset = aim[:2] - turn.apply(middle[None, :2])[0]
    motion = SE2(float(offset[0]), float(offset[1]), turn.yaw)
    return Pose.from_planar(motion, float(aim[2] - middle[2]))


def write_track(
    directory: Path | str,
    tracks: Mapping[str, Sequence[str]],
    poses: Mapping[str, Pose],
    coordinates: MapCoordinates,
) -> None:
    """Write a corrected track as ``poses.geojson`` and ``poses.kml``."""
    places = coordinates.geographic(positions(poses, poses))
    by_id = dict(zip(poses, places, strict=True))
    write_geojson(Path(directory, "poses.geojson"), tracks, by_id)
    write_kml(Path(directory, "poses.kml"), tracks, by_id)
