"""What ROS messages hold: points (``sensor_msgs/PointCloud2``), and a robot's tree of frames."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.io.poses import make_pose
from gpgrad_core.recordings.conditions import Condition, Tally, kept_points
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.trajectory import Located, Poses, Trajectory

Message: TypeAlias = Any
"""A message, or a part of one; rosbags makes its types while it runs."""
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's types by the numbers that the message uses for them."""


def points_of(
    message: Message, where: str, keep: Sequence[Condition] = (), tally: Tally | None = None
) -> Float[NDArray[np.floating], "n 3"]:
    """Read x, y and z [m] of each point, also where they are NaN.

    Args:
        message: The message, deserialised by rosbags.
        where: Topic and number of the message, for the error message.
        keep: Conditions on any fields of the message; only points that meet all are read.
        tally: Counts them, if it is given.

    Raises:
        InputError: If the message has no x, y and z, lacks a field of a condition, or has fewer
            bytes than its header says.
    """
    fields = {field.name: field for field in message.fields}
    names = list(dict.fromkeys([*"xyz", *(condition.field for condition in keep)]))
    missing = [name for name in names if name not in fields]
    if missing:
        held = ", ".join(fields) or "nothing"
        raise InputError(f"{where}: its points have no field {' or '.join(missing)}, only {held}")
    order = ">" if message.is_bigendian else "<"
    formats = [order + NUMBERS.get(fields[name].datatype, "") for name in names]
    wrong = [name for name, kind in zip(names, formats, strict=True) if len(kind) < 2]
    if wrong and wrong[0] in "xyz":
        raise InputError(f"{where}: x, y and z do not have a number type of PointCloud2")
    if wrong:
        raise InputError(f"{where}: {wrong[0]} does not have a number type of PointCloud2")
    rows, columns = int(message.height), int(message.width)
    row_size = columns * int(message.point_step)
    # Some drivers leave row_step at 0 when the rows have no padding.
    step = max(int(message.row_step), row_size) if rows > 1 else row_size
    data = np.asarray(message.data, np.uint8)
    if rows * columns == 0:
        return np.empty((0, 3))
    ends = [
        fields[name].offset + np.dtype(f).itemsize for name, f in zip(names, formats, strict=True)
    ]
    if max(ends) > message.point_step or len(data) < (rows - 1) * step + row_size:
        raise InputError(
            f"{where}: is cut short: it should hold {rows * columns:,} points of "
            f"{message.point_step} bytes, but it holds {len(data):,} bytes"
        )
    layout = np.dtype(
        {
            "names": names,
            "formats": formats,
            "offsets": [fields[name].offset for name in names],
            "itemsize": int(message.point_step),
        }
    )
    bodies = [data[k * step : k * step + row_size].tobytes() for k in range(rows)]
    table = np.frombuffer(b"".join(bodies), layout)

    def values_of(name: str) -> NDArray[np.float64]:
        return table[name].astype(np.float64)

    mask = kept_points(keep, values_of, where, tally)
    if mask is not None:
        table = table[mask]
    points = np.column_stack([table[name] for name in "xyz"])
    return points.astype(np.float64 if points.dtype.itemsize > 4 else np.float32)


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

    def add(self, message: Message, *, static: bool, where: str) -> None:
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


def seconds(header: Message) -> float:
    """Give the time of a message [s]."""
    return float(header.stamp.sec) + 1e-9 * float(header.stamp.nanosec)
