"""A recording: scans with poses, whatever files they came from."""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.recordings.params import BuildParams, Condition, PointFilter
from gpgrad_core.recordings.pose_files import PoseFile
from gpgrad_core.recordings.trajectory import Located, Poses, Trajectory, cut

NUM_SAMPLED = 24
"""Number of scans, spread over a recording, that tell what is so of all: up, range, frame."""
PAIRED_WITHIN = 0.01
"""The images of a pair are taken within this time [s]."""


@dataclass(frozen=True, eq=False)
class Scan:
    """The points of one scan, in the sensor's frame."""

    points: Float[NDArray[np.floating], "n 3"]  # [m]; NaN may be among them
    # standard deviation of each point's distance from the sensor [m]; None if it is not known
    std: Float[NDArray[np.floating], "n"] | None = None
    # number of neighbouring points that have their error in common
    together: float = 1.0

    @property
    def finite(self) -> Float[Array, "n 3"]:
        points = np.asarray(self.points, np.float64)
        return points[np.isfinite(points).all(axis=1)]


Reader: TypeAlias = Callable[[int, int], Iterator[Scan]]
"""Reads the scans of a recording from one number to before another."""
ReadScans: TypeAlias = Callable[[Sequence[int]], Iterator[Scan]]
"""Reads the scans of some numbers, which increase, among all that a kind of recording finds."""


@dataclass(frozen=True)
class RecordingSources:
    """Where the parts of a recording are, if they are not to be found automatically.

    Attributes:
        poses: File of poses: TUM or KITTI rows.
        truth: File of true poses, which the dataset keeps for evaluation.
        times: File of the scans' times [s], one per row.
        mount: File of the sensor's pose on the body whose poses are recorded.
        cloud_topic: Topic of the clouds in a bag, of depth images, or of a pair's left images.
        right_topic: Topic of the right images in a bag.
        calibration: Files of cameras' calibrations, left before right, if the recording has none.
        pose_topic: Topic of the poses in a bag.
        gnss_topic: Topic of the satellite positions in a bag, which become the truth.
        world_frame: Frame of a bag's transforms in which the map is built.
        odometry: What makes poses of the scans, if they have none or others are wanted.
        keep: Conditions that a point must meet to be kept, such as ``intensity>3``.
        root: Folder outside of which nothing is looked for.
    """

    poses: Path | None = None
    truth: Path | None = None
    times: Path | None = None
    mount: Path | None = None
    cloud_topic: str | None = None
    right_topic: str | None = None
    calibration: tuple[Path, ...] = ()
    pose_topic: str | None = None
    gnss_topic: str | None = None
    world_frame: str | None = None
    odometry: Literal["kiss-icp"] | None = None
    keep: tuple[Condition, ...] = ()
    root: Path | None = None

    def refuse(self, reason: str, *names: str) -> None:
        """Refuse some of the sources, which a kind of recording cannot have.

        Raises:
            InputError: If one of them is given; the message has its flag and the reason.
        """
        for name in names:
            value = getattr(self, name)
            if value:
                shown = value[0] if isinstance(value, tuple) else value
                raise InputError(f"--{name.replace('_', '-')} {shown}: {reason}")


@dataclass(frozen=True, eq=False)
class Recording:
    """Scans with one pose each; scans without a pose were left out, as the notes report."""

    name: str  # the name that people see
    identity: str  # hash by which the same recording is recognised
    stamps: Float[Array, "n"] | None  # time of each scan [s]; None if the times are not known
    body: Poses  # pose of the robot's body at each scan, ``T_world_body``
    # pose of the sensor on the body, ``T_body_sensor``: one for all scans, or one each
    mount: Poses
    read: Reader  # ``read(start, stop)`` yields scans start to stop - 1, one after the other
    labels: tuple[str, ...]  # name of each scan, for messages
    up: str = "z"  # axis of the world that points up, as far as the kind of recording tells
    # covariance of each position [m²], where the source gives it
    covariance: Float[Array, "n 3 3"] | None = None
    truth: Located | None = None  # true poses of the body at the scans, where the source gives them
    # whether the truth has positions only, with z up, and its turns mean nothing
    positions_only: bool = False
    notes: tuple[str, ...] = ()  # what was left out or assumed, one line each
    # latitude, longitude [degrees] and height [m] of the frame of the truth, or else of the poses,
    # whose x points east and y north; None if unknown
    origin: tuple[float, float, float] | None = None
    keep: PointFilter = field(default_factory=PointFilter)  # counts the points that were read
    advice: str = ""  # what may be wrong if no scan has any points
    # numbers of scans to which the motion is not known: a submap must not span one
    breaks: tuple[int, ...] = ()
    # whether the points of the scans are in the world, not in the sensor's frame
    in_world: bool = False

    def __len__(self) -> int:
        return len(self.body)

    def sensor(self, index: int) -> Poses:
        """Pose of the sensor at a scan, ``T_world_sensor``."""
        row = slice(index, index + 1)
        return self.body[row] @ (self.mount if len(self.mount) == 1 else self.mount[row])

    def pieces(self, params: BuildParams) -> list[range]:
        stamps = np.zeros(len(self)) if self.stamps is None else self.stamps
        return cut(stamps, self.body, params, self.covariance, self.breaks)

    def sample(self) -> Iterator[tuple[int, Scan]]:
        """Read up to `NUM_SAMPLED` scans, spread evenly over the recording, with their numbers."""
        for k in np.unique(np.linspace(0, len(self) - 1, NUM_SAMPLED).astype(int)).tolist():
            (scan,) = self.read(k, k + 1)
            yield k, scan


@dataclass(frozen=True, eq=False)
class FoundScans:
    """All scans that a kind of recording finds, whether or not they have a pose."""

    labels: Sequence[str]  # name of each scan, for messages
    read: ReadScans
    stamps: Float[Array, "n"] | None  # time of each scan [s]; None if the times are not known
    # by what the poses are looked up, if not by the times: KITTI's rows
    keys: Float[Array, "n"] | None = None
    files: Sequence[tuple[Path, ...]] = ()  # the files of each scan
    mount: Poses | None = None  # as in `Recording`; None if the sensor is the body
    keep: PointFilter = field(default_factory=PointFilter)
    advice: str = ""
    in_world: bool = False


@dataclass(frozen=True, eq=False)
class FoundPoses:
    """Poses of the body that a kind of recording finds, and the true ones."""

    poses: Trajectory | Located  # over time, or at each scan
    span: str = ""  # when poses at the scans are from, in words; a trajectory tells by itself
    up: str = "z"
    truth: PoseFile | None = None
    truth_name: str = ""
    origin: tuple[float, float, float] | None = None  # None: that of the truth
    notes: tuple[str, ...] = ()  # these follow that on scans without a pose


def assemble(
    path: Path,
    sources: RecordingSources,
    params: BuildParams,
    scans: FoundScans,
    pose_source: FoundPoses,
    *,
    texts: Sequence[Path | None] = (),
    notes: tuple[str, ...] = (),
    name: str = "",
) -> Recording:
    """Make a recording of all scans that a kind found, without those that have no pose."""
    keys = scans.stamps if scans.keys is None else scans.keys
    if keys is None:
        keys = np.arange(len(scans.labels), dtype=np.float64)
    if isinstance(pose_source.poses, Trajectory):
        body = pose_source.poses.at(keys, params)
        span = pose_source.span or f"from {time_span(pose_source.poses.stamps)}"
    else:
        body, span = pose_source.poses, pose_source.span
    notes += check_posed(keys, body, span, str(path), params, scans.labels[0])
    posed = np.flatnonzero(body.valid)
    if scans.stamps is not None:
        in_time = posed[np.argsort(scans.stamps[posed], kind="stable")]
        if num_moved := int(np.sum(in_time != posed)):
            notes += (
                f"{num_moved:,} of {len(posed):,} scans were recorded out of the order of their "
                "times: they are taken in that of their times",
            )
        posed = in_time
    truth, origin = pose_source.truth, pose_source.origin
    true_poses, truth_notes = truth_at(truth, keys[posed], pose_source.truth_name, params)
    mount = Poses.identity() if scans.mount is None else scans.mount
    numbers = posed.tolist()
    own_files = (file for k in numbers for file in scans.files[k]) if scans.files else ()
    return Recording(
        name=name or path.resolve().name,
        identity=identify([*own_files, *(text for text in texts if text is not None)]),
        stamps=None if scans.stamps is None else scans.stamps[posed],
        body=body.poses[posed],
        mount=mount if len(mount) == 1 else mount[posed],
        read=lambda start, stop: scans.read(numbers[start:stop]),
        labels=tuple(scans.labels[k] for k in numbers),
        up=pose_source.up,
        covariance=None if body.covariance is None else body.covariance[posed],
        truth=true_poses,
        positions_only=truth is not None and truth.positions_only,
        notes=(*notes, *pose_source.notes, *truth_notes, *condition_notes(sources)),
        origin=truth.origin if origin is None and truth is not None else origin,
        keep=scans.keep,
        advice=scans.advice,
        in_world=scans.in_world,
    )


def find_file(places: Sequence[Path], names: Sequence[str]) -> Path | None:
    """Find the first of some files in the first of some folders that has one."""
    return next((p / name for p in places for name in names if (p / name).exists()), None)


def identify(files: Iterable[Path]) -> str:
    """Hash the names, sizes and modification times of files; the contents would take minutes."""
    digest = hashlib.blake2b(digest_size=16)
    for file in files:
        status = file.stat()
        digest.update(f"{file.name}\0{status.st_size}\0{status.st_mtime_ns}\n".encode())
    return digest.hexdigest()


def check_posed(
    stamps: Float[Array, "n"],
    located: Located,
    trajectory: str,
    where: str,
    params: BuildParams,
    first: str = "",
) -> tuple[str, ...]:
    """Check which scans have a pose by stamps [s]; gives a note if some have none."""
    missing = int(np.sum(~located.valid))
    if missing == len(stamps):
        raise InputError(
            f"{where}: no scan has a pose within {params.max_time_difference:g} s: the scans are "
            f"from {time_span(stamps)}{first and f' ({first} is the first)'}, the poses are "
            f"{trajectory}; give the poses of this "
            "recording, or raise max_time_difference"
        )
    if not missing:
        return ()
    have = "has" if missing == 1 else "have"
    return (
        f"{missing:,} of {len(stamps):,} scans {have} no pose within "
        f"{params.max_time_difference:g} s and {'was' if missing == 1 else 'were'} left out",
    )


def condition_notes(sources: RecordingSources) -> tuple[str, ...]:
    """Describe which points the conditions drop, if there are any."""
    conditions = " and ".join(str(condition) for condition in sources.keep)
    return (f"only points with {conditions} are kept",) if conditions else ()


def time_span(stamps: Float[Array, "n"]) -> str:
    """Describe a time span.

    >>> time_span(np.array([1.0, 2.5]))
    '1.000 to 2.500 s'
    """
    return f"{stamps.min():.3f} to {stamps.max():.3f} s"


def pair_stamps(
    left: Float[Array, "n"], right: Float[Array, "m"], where: str, names: Sequence[object]
) -> tuple[Int[NDArray[np.intp], "p 2"], tuple[str, ...]]:
    """Find images of two cameras of one time [s]: pairs of numbers, and a note on the others."""
    order = np.argsort(right, kind="stable")
    after = np.clip(np.searchsorted(right[order], left), 1, max(len(right) - 1, 1))
    near = np.stack([np.clip(after - 1, 0, len(right) - 1), np.clip(after, 0, len(right) - 1)])
    off = np.abs(right[order][near] - left)
    nearest, apart = np.argmin(off, axis=0), off.min(axis=0)
    partner = order[near[nearest, np.arange(len(left))]]
    together = np.flatnonzero(apart <= PAIRED_WITHIN)
    if not len(together):
        raise InputError(
            f"{where}: no images of {names[0]} and {names[1]} were taken within "
            f"{PAIRED_WITHIN:g} s of each other: the nearest are {apart.min():.3f} s apart; the "
            f"left ones are from {time_span(left)}, the right ones from {time_span(right)}"
        )
    together = together[np.argsort(apart[together], kind="stable")]
    together = together[np.unique(partner[together], return_index=True)[1]]  # the nearest of two
    paired = together[np.argsort(left[together], kind="stable")]
    without = len(left) - len(paired)
    have = "image has" if without == 1 else "images have"
    note = (
        f"{without:,} of {len(left):,} left {have} no right one within {PAIRED_WITHIN:g} s and "
        f"{'was' if without == 1 else 'were'} left out"
    )
    return np.column_stack([paired, partner[paired]]), (note,) if without else ()


def truth_at(
    truth: PoseFile | None, stamps: Float[Array, "n"], where: str, params: BuildParams
) -> tuple[Located | None, tuple[str, ...]]:
    """Find the true poses of scans, and make a note if some have none."""
    if truth is None:
        return None, ()
    located = truth.trajectory.at(stamps, params)
    check_posed(stamps, located, f"from {time_span(truth.trajectory.stamps)}", where, params)
    missing = int(np.sum(~located.valid))
    note = f"{missing:,} of {len(stamps):,} scans have no true pose"
    return located, (note,) if missing else ()
