"""The tree of frames of a robot, and the motion between any two of them over time."""

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array
from gpgrad_core.datasets.poses import make_pose
from gpgrad_core.errors import InputError
from gpgrad_core.scans.params import BuildParams
from gpgrad_core.scans.trajectory import Located, Poses, Trajectory


@dataclass(frozen=True, eq=False)
class FrameTree:
    """The tree of a bag's frames.

    Attributes:
        parents: Parent of each frame, by the frame's name.
        edges: Pose of each frame in its parent over time, ``T_parent_frame``, by its name.
    """

    parents: dict[str, str]
    edges: dict[str, Trajectory]

    def root(self, frame: str) -> str:
        """Find the root of a frame's tree."""
        return self._way_up(frame)[-1]

    def between(
        self, target: str, source: str, stamps: Float[Array, "n"], params: BuildParams
    ) -> Located | None:
        """Find ``T_target_source`` at given times [s]; None if no transforms join the frames."""
        up_target, up_source = self._way_up(target), self._way_up(source)
        common = next((frame for frame in up_target if frame in up_source), None)
        if common is None:
            return None
        down = self._climb(up_target[: up_target.index(common)], stamps, params)
        up = self._climb(up_source[: up_source.index(common)], stamps, params)
        return down.inverse() @ up

    def _way_up(self, frame: str) -> list[str]:
        way = [frame]
        while way[-1] in self.parents and self.parents[way[-1]] not in way:
            way.append(self.parents[way[-1]])
        return way

    def _climb(self, frames: list[str], stamps: Float[Array, "n"], params: BuildParams) -> Located:
        """Compose the poses of frames, each in its parent: ``T_top_bottom``."""
        motion = Trajectory(np.zeros(1), Poses.identity(), fixed=True).at(stamps, params)
        for frame in frames:
            motion = self.edges[frame].at(stamps, params) @ motion
        return motion


@dataclass(frozen=True, eq=False)
class FrameRows:
    """Collects transforms while a bag is read.

    Attributes:
        parents: Parent of each frame, by the frame's name.
        rows: Rows of time [s], offset [m] and quaternion of each frame, by its name.
        static: Names of the frames whose transforms do not change.
    """

    parents: dict[str, str] = field(default_factory=dict[str, str])
    rows: dict[str, list[list[float]]] = field(default_factory=lambda: defaultdict(list))
    static: set[str] = field(default_factory=set[str])

    def add(self, message: Any, *, static: bool, where: str) -> None:
        """Add the transforms of a ``TFMessage``.

        Raises:
            InputError: If a frame has a second parent, or a quaternion is not of unit length.
        """
        for transform in message.transforms:
            parent, child = plain(transform.header.frame_id), plain(transform.child_frame_id)
            if self.parents.setdefault(child, parent) != parent:
                raise InputError(
                    f"{where}: the frame {child!r} has two parents, {self.parents[child]!r} and "
                    f"{parent!r}; choose a topic of poses: --pose-topic"
                )
            if static:
                self.static.add(child)
                self.rows[child] = []  # only the latest counts
            move, turn = transform.transform.translation, transform.transform.rotation
            stamp = seconds(transform.header)
            values = [float(v) for v in (move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w)]
            make_pose(values, f"{where}, {parent} > {child} at {stamp:.3f} s")
            self.rows[child].append([stamp, *values])

    def tree(self) -> FrameTree:
        """Make the tree of all transforms so far."""
        edges = {child: _edge(rows, child in self.static) for child, rows in self.rows.items()}
        return FrameTree(dict(self.parents), edges)


def _edge(rows: list[list[float]], fixed: bool) -> Trajectory:
    table = np.array(rows, np.float64)
    poses = Poses(table[:, 1:4], Rotation.from_quat(table[:, 4:]))
    return (
        Trajectory(table[:, 0], poses, fixed=True)
        if fixed
        else Trajectory.in_order(table[:, 0], poses)
    )


def plain(frame: str) -> str:
    """Remove the slash that ROS 1 may put before a frame's name."""
    return frame.lstrip("/")


def seconds(header: Any) -> float:
    """Give the time of a message [s]."""
    return float(header.stamp.sec) + 1e-9 * float(header.stamp.nanosec)
