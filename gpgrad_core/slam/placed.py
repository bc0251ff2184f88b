"""A map put into a coordinate system, and the files of its track for geographic programs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.georeference import Georeference
from gpgrad_core.outputs.georeferenced import write_geojson, write_kml
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam.truth import level_motion


@dataclass(frozen=True, eq=False)
class PlacedMap:
    """Where the world of a map lies in a coordinate system.

    Attributes:
        georeference: Places the frame in which x points east and y north.
        T_local_world: Brings the map's world into that frame.
        by_truth: Whether the true positions say so; else the world is taken for that frame.
    """

    georeference: Georeference
    T_local_world: Pose
    by_truth: bool

    def apply(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Give easting, northing and height [m] of points of the world (n, 3) [m]."""
        return self.georeference.apply(self.T_local_world.apply(points))

    def geographic(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Give longitude, latitude [degrees] and height [m] of points of the world (n, 3) [m]."""
        return self.georeference.geographic(self.T_local_world.apply(points))


def place_map(
    poses: Mapping[str, Pose], true: Mapping[str, Pose], georeference: Georeference
) -> PlacedMap:
    """Place a map by the true positions of its submaps, or else as odometry began.

    Args:
        poses: Corrected poses in the map's world, by id.
        true: True poses, by id; of these only the positions count.
        georeference: Places the frame of the true poses, or else the world.
    """
    known = [name for name in true if name in poses]
    if len(known) < 2:
        return PlacedMap(georeference, Pose.from_planar(SE2()), by_truth=False)
    places = np.array([poses[name].translation for name in known])
    target = np.array([true[name].translation for name in known])
    return PlacedMap(georeference, level_motion(places, target), by_truth=True)


def write_places(
    directory: Path | str,
    tracks: Mapping[str, Sequence[str]],
    poses: Mapping[str, Pose],
    placed: PlacedMap,
) -> None:
    """Write a corrected track as ``poses.geojson`` and ``poses.kml``.

    Args:
        directory: An existing folder.
        tracks: Ids of the submaps of each traverse, by its name.
        poses: Corrected poses in the map's world, by id.
        placed: Where the world lies.
    """
    places = placed.geographic(np.array([pose.translation for pose in poses.values()]))
    by_id = dict(zip(poses, places, strict=True))
    write_geojson(Path(directory, "poses.geojson"), tracks, by_id)
    write_kml(Path(directory, "poses.kml"), tracks, by_id)
