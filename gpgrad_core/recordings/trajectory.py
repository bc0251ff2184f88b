"""Poses over time, the pose at any time between them, and where a submap ends."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation, Slerp

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.se2 import Pose

Stack: TypeAlias = Float[Array, "n 3"]
SHORTEST_STEP = 0.05
"""Length is counted in steps of this [m] or more: a robot that stands still does not drive."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Rigid motions ``T_a_b``, one per row; ``T_a_b @ T_b_c`` is ``T_a_c``."""

    translation: Stack  # offsets (n, 3) [m]
    rotation: Rotation  # as many rotations

    def __len__(self) -> int:
        return len(self.translation)

    def __getitem__(self, chosen: NDArray[np.bool_] | NDArray[np.intp] | slice) -> "Poses":
        return Poses(self.translation[chosen], self.rotation[chosen])

    def __matmul__(self, other: "Poses") -> "Poses":
        """Compose two stacks of the same length, or one pose with a stack."""
        return Poses(self.apply(other.translation), self.rotation * other.rotation)

    def apply(self, points: Float[NDArray[np.floating], "n 3"]) -> Float[Array, "m 3"]:
        """Transform points, each by its pose, all by one, or one by all."""
        return self.rotation.apply(points) + self.translation

    def repeated(self, count: int) -> "Poses":
        return self[np.zeros(count, np.intp)]

    def inverse(self) -> "Poses":
        back = self.rotation.inv()
        return Poses(-back.apply(self.translation), back)

    def one(self, index: int) -> Pose:
        return Pose(self.translation[index], self.rotation[index].as_quat(canonical=True))

    @classmethod
    def of(cls, *poses: Pose) -> "Poses":
        return cls(
            np.array([pose.translation for pose in poses]),
            Rotation.from_quat([pose.quaternion for pose in poses]),
        )

    @classmethod
    def identity(cls, count: int = 1) -> "Poses":
        return cls(np.zeros((count, 3)), Rotation.identity(count))


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses by time."""

    stamps: Float[Array, "n"]  # times [s], increasing
    poses: Poses  # one pose per time
    # covariance of each position [m²], where the source gives it; NaN if it is not known
    covariance: Float[Array, "n 3 3"] | None = None
    # whether the single pose holds at all times, as that of a sensor on a robot
    fixed: bool = False

    @classmethod
    def in_order(
        cls,
        stamps: Float[Array, "n"],
        poses: Poses,
        covariance: Float[Array, "n 3 3"] | None = None,
    ) -> "Trajectory":
        """Make a trajectory sorted by time; of poses with the same time the first is kept."""
        stamps, first = np.unique(stamps, return_index=True)
        covariances = None if covariance is None else covariance[first]
        return cls(stamps, poses[first], covariances)

    def at(self, times: Float[Array, "m"], params: BuildParams) -> "Located":
        if self.fixed:
            return Located.all_valid(self.poses.repeated(len(times)))
        last = len(self.stamps) - 1
        after = np.clip(np.searchsorted(self.stamps, times), 0, last)
        before = np.maximum(after - 1, 0)
        earlier = np.abs(times - self.stamps[before]) <= np.abs(self.stamps[after] - times)
        nearest = np.where(earlier, before, after)
        near = np.abs(self.stamps[nearest] - times) <= params.max_time_difference
        covariance = None if self.covariance is None else self.covariance[nearest]
        if params.pose_matching == "nearest" or last == 0:
            return Located(self.poses[nearest], near, covariance)
        # Beyond either end, the last known pose is used.
        inside = np.clip(times, self.stamps[0], self.stamps[-1])
        step = self.stamps[after] - self.stamps[before]
        share = np.where(step > 0, (inside - self.stamps[before]) / np.where(step > 0, step, 1), 0)
        ends = self.poses.translation
        translation = ends[before] + share[:, None] * (ends[after] - ends[before])
        rotation = Slerp(self.stamps, self.poses.rotation)(inside)
        return Located(Poses(translation, rotation), near, covariance)


@dataclass(frozen=True, eq=False)
class Located:
    """Poses at requested times."""

    poses: Poses  # one pose per time
    # whether each pose is valid (n,); if not, it has no meaning
    valid: Bool[NDArray[np.bool_], "n"]
    # covariance of each position (n, 3, 3) [m²], if the source gives it
    covariance: Float[Array, "n 3 3"] | None = None

    @classmethod
    def all_valid(cls, poses: Poses) -> "Located":
        return cls(poses, np.ones(len(poses), bool))

    def __matmul__(self, other: "Located") -> "Located":
        """Compose motions; a result is valid if both motions are."""
        return Located(self.poses @ other.poses, self.valid & other.valid, self.covariance)

    def inverse(self) -> "Located":
        return Located(self.poses.inverse(), self.valid)


@dataclass(frozen=True, eq=False)
class FrameTree:
    """The tree of a bag's frames."""

    parents: dict[str, str]  # parent of each frame, by the frame's name
    # pose of each frame in its parent over time, ``T_parent_frame``, by its name
    edges: dict[str, Trajectory]
    # errors of frames with several parents, by name: no way between frames may lead over them
    disputed: Mapping[str, str] = field(default_factory=dict[str, str])

    def root(self, frame: str) -> str:
        return self._way_up(frame)[-1]

    def carrier(self, frame: str) -> str:
        """Find the last frame on the way to the root that a frame is fixed to: its robot."""
        for above in self._way_up(frame)[1:]:
            if not self.edges[frame].fixed or frame in self.disputed:
                break
            frame = above
        return frame

    def mover(self, frame: str) -> str | None:
        """Find the frame below another one that moves furthest; None if none of them moves."""
        lengths = {
            name: float(np.linalg.norm(np.ptp(edge.poses.translation, axis=0)))
            for name, edge in self.edges.items()
            if not edge.fixed and frame in self._way_up(name)[1:]
        }
        return max(lengths, key=lengths.__getitem__, default=None)

    def is_below(self, frame: str, other: str) -> bool:
        return other in self._way_up(frame)

    def between(
        self, target: str, source: str, stamps: Float[Array, "n"], params: BuildParams
    ) -> Located | None:
        """Find ``T_target_source`` at given times [s]; None if no transforms join the frames."""
        ways = self.ways(target, source)
        if ways is None:
            return None
        down, up = (self._climb(way, stamps, params) for way in ways)
        return down.inverse() @ up

    def ways(self, target: str, source: str) -> tuple[list[str], list[str]] | None:
        """The frames below the first common one, on the way up; InputError if one is disputed."""
        up_target, up_source = self._way_up(target), self._way_up(source)
        common = next((frame for frame in up_target if frame in up_source), None)
        ways = [list(takewhile(lambda frame: frame != common, up)) for up in (up_target, up_source)]
        for frame in (frame for way in ways for frame in way if frame in self.disputed):
            raise InputError(self.disputed[frame])
        return None if common is None else (ways[0], ways[1])

    def _way_up(self, frame: str) -> list[str]:
        way = [frame]
        while way[-1] in self.parents and self.parents[way[-1]] not in way:
            way.append(self.parents[way[-1]])
        return way

    def _climb(self, frames: list[str], stamps: Float[Array, "n"], params: BuildParams) -> Located:
        """Compose the poses of frames, each in its parent: ``T_top_bottom``."""
        motion = Located.all_valid(Poses.identity(len(stamps)))
        for frame in frames:
            motion = self.edges[frame].at(stamps, params) @ motion
        return motion


def cut(
    stamps: Float[Array, "n"],
    poses: Poses,
    params: BuildParams,
    covariance: Float[Array, "n 3 3"] | None = None,
    breaks: Sequence[int] = (),
) -> list[range]:
    """Divide scans into submaps: one that reaches a limit, or one of the `breaks`, begins the next.

    Uncertainty grows from the first known covariance [m²] of a submap; z of the poses points up.
    """
    if params.max_uncertainty is not None and covariance is None:
        raise InputError(
            "max_uncertainty needs poses with covariances: Odometry or "
            "PoseWithCovarianceStamped of a bag, or TUM rows with 36 further columns"
        )
    x_axis, positions = poses.rotation.apply([1.0, 0.0, 0.0]), poses.translation
    heading = np.arctan2(x_axis[:, 1], x_axis[:, 0])
    starts: list[int] = []
    travelled, anchor, begun, least = 0.0, np.zeros(3), 0, 0
    for k in range(len(stamps)):
        if covariance is not None and not np.isfinite(covariance[least]).all():
            least = k
        step = float(np.linalg.norm(positions[k] - anchor))
        if step >= SHORTEST_STEP:
            travelled, anchor = travelled + step, positions[k]
        if not starts or (
            k in breaks
            or _reached(travelled, params.max_length)
            or _reached(stamps[k] - stamps[begun], params.max_time)
            or _reached(_turn(heading[k] - heading[begun]), params.max_turn)
            or (
                covariance is not None
                and _reached(_growth(covariance[least], covariance[k]), params.max_uncertainty)
            )
        ):
            starts.append(k)
            travelled, anchor, begun, least = 0.0, positions[k], k, k
    return [range(a, b) for a, b in zip(starts, [*starts[1:], len(stamps)], strict=True)]


def _reached(value: float, limit: float | None) -> bool:
    # Allow for rounding: 50 steps of 0.1 m add up to 4.999999999 m.
    return limit is not None and bool(value >= limit * (1.0 - 1e-6))


def _turn(angle: float) -> float:
    return abs((angle + np.pi) % (2.0 * np.pi) - np.pi)


def _growth(before: Float[Array, "3 3"], after: Float[Array, "3 3"]) -> float:
    """Compute how much a position's standard deviation has grown, in its worst direction [m]."""
    if not np.isfinite(after - before).all():
        return 0.0
    return float(np.sqrt(max(0.0, float(np.linalg.eigvalsh(after - before)[-1]))))
