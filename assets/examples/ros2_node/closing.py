"""What the node does, without ROS: scans with poses in, loop closures out."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import gpgrad_core as gg


@dataclass(frozen=True)
class Constraint:
    """A loop closure, in the numbers of a ``PoseWithCovarianceStamped``.

    Attributes:
        query: Id of the later submap.
        database: Id of the earlier submap, in whose frame the pose is.
        position: Position of the query's frame [m].
        quaternion: Its orientation, x y z w.
        covariance: Of x, y, z [m] and the turns about them [rad], 36 numbers row by row.
    """

    query: str
    database: str
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    covariance: tuple[float, ...]


class ScanCloser:
    """Puts scans together to level submaps, and closes loops between these.

    With a viewer, the submaps go there, and it closes the loops: then `poses` are what it tells.
    """

    def __init__(
        self,
        length: float = 5.0,
        voxel: float = 0.05,
        live: gg.Live | None = None,
        **options: object,
    ) -> None:
        """Begin without a scan.

        Args:
            length: Way along which scans make one submap [m].
            voxel: Side of the cubes of which each keeps one point [m].
            live: The connection to a viewer; None closes the loops here.
            options: Arguments of `gg.LoopCloser`.
        """
        self._length, self._voxel, self._live = length, voxel, live
        self._closer = gg.LoopCloser(**options)  # type: ignore[arg-type]
        self._start: gg.Pose | None = None
        self._last, self._way = np.zeros(3), 0.0
        self._count = 0 if live is None else len(live.kept)  # goes on after a restart
        self._points: list[np.ndarray] = []

    def add(self, points: np.ndarray, T_odom_sensor: gg.Pose) -> Iterator[Constraint]:
        """Take a scan, and give the loop closures that a finished submap brings.

        Args:
            points: Positions (n, 3) in the sensor's frame [m].
            T_odom_sensor: The sensor's pose in the frame of odometry, whose z points up.
        """
        place = T_odom_sensor.translation
        if self._start is None:
            self._start, self._way, self._last = level(T_odom_sensor), 0.0, place
        self._way += float(np.linalg.norm(place - self._last))
        self._last = place
        finite = points[np.isfinite(points).all(axis=1)]
        self._points.append((self._start.inverse() @ T_odom_sensor).apply(finite))
        if self._way >= self._length:
            yield from self.finish()

    def finish(self) -> Iterator[Constraint]:
        """Make a submap of the scans so far."""
        if self._start is None:
            return
        points, start = thinned(np.vstack(self._points), self._voxel), self._start
        self._points, self._start = [], None
        try:
            submap = gg.Submap.from_points(points, f"{self._count:04d}", pose_odometry=start)
        except gg.InputError:
            return  # too few points, or all on a line: no ground
        self._count += 1
        if self._live is not None:  # returns when the submap is on the viewer's disk
            self._live.add(submap.points, start, id=submap.id, wait=False)
            return
        for closure in self._closer.add(submap).accepted:
            yield constraint(closure)

    @property
    def poses(self) -> dict[str, gg.Pose]:
        """The corrected poses of all submaps, by id."""
        if self._live is not None:
            return dict(self._live.track)
        return dict(self._closer.result.poses)

    def close(self) -> None:
        """Remove temporary files, and hang up."""
        self._closer.close()
        if self._live is not None:
            self._live.close()


def level(pose: gg.Pose) -> gg.Pose:
    """Keep position and heading of a pose, but neither roll nor pitch."""
    return gg.Pose.from_planar(pose.planar, float(pose.translation[2]))


def thinned(points: np.ndarray, voxel: float) -> np.ndarray:
    """Keep the first point of each cube."""
    _, first = np.unique(np.floor(points / voxel).astype(np.int64), axis=0, return_index=True)
    return points[np.sort(first)]


def constraint(closure: gg.LoopClosure) -> Constraint:
    """Write a loop closure in the numbers of a message."""
    found = closure.registration
    motion = found.T_database_query
    assert motion is not None  # an accepted closure has one
    covariance = np.zeros((6, 6))
    if found.covariance is not None:
        rows = np.array([0, 1, 5])  # x, y and the turn about z
        planar = found.covariance_at(np.zeros(2))  # at the origin of the submap's frame
        covariance[np.ix_(rows, rows)] = 0.5 * (planar + planar.T)
        covariance[2, 2] = (found.z_std or 0.0) ** 2
    return Constraint(
        closure.query_id,
        closure.database_id,
        (motion.x, motion.y, found.z_offset),
        (0.0, 0.0, float(np.sin(0.5 * motion.yaw)), float(np.cos(0.5 * motion.yaw))),
        tuple(covariance.ravel().tolist()),
    )
