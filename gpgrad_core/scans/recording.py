"""What a recording is to all that follows, whatever files it came in."""

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.scans.params import BuildParams
from gpgrad_core.scans.trajectory import Located, Poses, Trajectory

Reader: TypeAlias = Callable[[int, int], Iterator[Float[NDArray[np.floating], "n 3"]]]


@dataclass(frozen=True)
class RecordingSources:
    """Where the parts of a recording are, so far as they are not found by themselves.

    Attributes:
        poses: File of poses: TUM or KITTI rows.
        truth: File of true poses, which are passed on for evaluation.
        times: File of the scans' times [s], one a row.
        mount: File of the sensor's pose on the body that the poses are of.
        cloud_topic: Topic of a bag's clouds.
        pose_topic: Topic of a bag's poses.
        world_frame: Frame of a bag's transforms that the map is built in.
    """

    poses: Path | None = None
    truth: Path | None = None
    times: Path | None = None
    mount: Path | None = None
    cloud_topic: str | None = None
    pose_topic: str | None = None
    world_frame: str | None = None


@dataclass(frozen=True, eq=False)
class Recording:
    """Scans with a pose each; what has none was left out and is told in the notes.

    Attributes:
        name: As shown to people.
        identity: Hash of what was read, to know the same recording again.
        stamps: Time of each scan [s]; None where nothing tells it.
        body: Pose of the robot's body at each scan, ``T_world_body``.
        mount: Pose of the sensor on it, ``T_body_sensor``: one, or one a scan.
        read: Yields the points [m] of a stretch of scans, from the first up to the last, one
            scan in memory at a time.
        labels: What each scan is called, for messages.
        up: Axis of the world that the kind of recording suggests as up.
        covariance: Of each position [m²], where the source gives it.
        truth: True poses of the body at the scans, where there is a source of them.
        notes: What was left out or assumed, a line each.
    """

    name: str
    identity: str
    stamps: Float[Array, "n"] | None
    body: Poses
    mount: Poses
    read: Reader
    labels: tuple[str, ...]
    up: str = "z"
    covariance: Float[Array, "n 3 3"] | None = None
    truth: Located | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Number of scans."""
        return len(self.body)

    def sensor(self, index: int) -> Poses:
        """Pose of the sensor at a scan, ``T_world_sensor``."""
        one = slice(index, index + 1)
        return self.body[one] @ (self.mount if len(self.mount) == 1 else self.mount[one])


def identify(files: Iterable[Path]) -> str:
    """Hash names, sizes and times of change of files: their contents would take minutes."""
    digest = hashlib.blake2b(digest_size=16)
    for file in files:
        status = file.stat()
        digest.update(f"{file.name}\0{status.st_size}\0{status.st_mtime_ns}\n".encode())
    return digest.hexdigest()


def place(
    stamps: Float[Array, "n"], located: Located, trajectory: str, where: str, params: BuildParams
) -> tuple[str, ...]:
    """Check which scans have a pose.

    Args:
        stamps: Times of the scans [s].
        located: The poses found for them.
        trajectory: The stretch of time that the poses span, in words.
        where: What is recorded, for messages.
        params: Says how far from a pose a scan may be.

    Returns:
        A note if some have none.

    Raises:
        InputError: If none has.
    """
    missing = int(np.sum(~located.known))
    if missing == len(stamps):
        raise InputError(
            f"{where}: no scan has a pose within {params.max_time_difference:g} s: the scans are "
            f"from {spelled(stamps)}, the poses {trajectory}; give the poses of this recording, or "
            "raise max_time_difference"
        )
    if not missing:
        return ()
    have = "has" if missing == 1 else "have"
    return (
        f"{missing:,} of {len(stamps):,} scans {have} no pose within "
        f"{params.max_time_difference:g} s and {'was' if missing == 1 else 'were'} left out",
    )


def spelled(stamps: Float[Array, "n"]) -> str:
    """Say a stretch of time.

    >>> spelled(np.array([1.0, 2.5]))
    '1.000 to 2.500 s'
    """
    return f"{stamps.min():.3f} to {stamps.max():.3f} s"


def truth_at(
    truth: Trajectory | None, stamps: Float[Array, "n"], where: str, params: BuildParams
) -> tuple[Located | None, tuple[str, ...]]:
    """Find the true poses of scans, and say if some have none.

    Raises:
        InputError: If none has.
    """
    if truth is None:
        return None, ()
    located = truth.at(stamps, params)
    place(stamps, located, f"from {spelled(truth.stamps)}", where, params)
    missing = int(np.sum(~located.known))
    note = f"{missing:,} of {len(stamps):,} scans have no true pose"
    return located, (note,) if missing else ()
