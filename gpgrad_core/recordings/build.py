"""Recording -> dataset: find up, cut, accumulate, write; one scan and one submap in memory."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gpgrad_core import __version__
from gpgrad_core.errors import InputError, readable
from gpgrad_core.ground import submap_of_cloud
from gpgrad_core.io.clouds.ply import write_ply
from gpgrad_core.io.folder import check_vacant, write_all_but_clouds
from gpgrad_core.io.poses import find_posed_scans, pose_row
from gpgrad_core.reading.files import check_regular
from gpgrad_core.reading.paths import check_path
from gpgrad_core.reading.text import write_lines
from gpgrad_core.recordings.bag import open_bag
from gpgrad_core.recordings.bag_reader import is_bag, is_split_bag
from gpgrad_core.recordings.cloud_folder import is_scan_folder, open_folder, open_posed_scans
from gpgrad_core.recordings.image_pairs import (
    is_euroc,
    is_kitti_pairs,
    is_madmax,
    open_euroc,
    open_kitti_pairs,
    open_madmax,
)
from gpgrad_core.recordings.journal import Entry, Journal, open_journal
from gpgrad_core.recordings.katwijk import is_katwijk, open_katwijk
from gpgrad_core.recordings.level import level_recording, usable
from gpgrad_core.recordings.odometry import estimate_poses
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.pds import has_products, open_products
from gpgrad_core.recordings.recording import Recording, RecordingSources
from gpgrad_core.recordings.trajectory import Poses
from gpgrad_core.recordings.voxels import Voxels, VoxelSums
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.se2 import Pose, level_pose
from gpgrad_core.types import Dataset

TOPICS = ("cloud_topic", "pose_topic", "world_frame", "gnss_topic")
COUNTED = ("measured", "not_finite", "too_close", "too_far", "empty_scans")
ODOMETRY_SHARE = 0.9
"""Share of a build's time that odometry takes, where it is made."""


@dataclass(frozen=True)
class RecordingKind:
    """A kind of recording."""

    fits: Callable[[Path], bool]  # whether a path is one
    open: Callable[[Path, RecordingSources, BuildParams], Recording]
    unposed: bool = False  # whether it is opened without poses where odometry is to make them


KINDS = (
    RecordingKind(is_bag, open_bag, unposed=True),
    RecordingKind(is_katwijk, open_katwijk),
    RecordingKind(has_products, open_products),
    RecordingKind(is_scan_folder, open_folder, unposed=True),
    RecordingKind(is_madmax, open_madmax),
    RecordingKind(is_euroc, open_euroc),
    RecordingKind(is_kitti_pairs, open_kitti_pairs),
    RecordingKind(is_split_bag, open_bag, unposed=True),
)


@dataclass(frozen=True, eq=False)
class BuildReport:
    """The result of a build.

    Attributes:
        num_submaps: Number of submaps written.
        num_scans: Number of scans in them.
        num_resumed: Number of submaps that an earlier, unfinished run had written.
        notes: What was left out or assumed, one line each.
        num_failed: Number of scans at which the odometry failed, if any was made.
    """

    num_submaps: int
    num_scans: int
    num_resumed: int
    notes: tuple[str, ...]
    num_failed: int = 0


def is_recording(path: Path | str) -> bool:
    """Whether a path holds scans, of which `build_dataset` makes a dataset."""
    return any(kind.fits(Path(path)) for kind in KINDS)


def open_recording(
    path: Path | str, sources: RecordingSources | None = None, params: BuildParams | None = None
) -> Recording:
    """Open a recording of one of `KINDS`, scans with a pose each, or a folder of clouds."""
    path = check_path(path)
    sources, params = sources or RecordingSources(), params or BuildParams()
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    with readable(path):
        if not path.is_dir():
            check_regular(path)
        kind = next((kind for kind in KINDS if kind.fits(path)), None)
        if sources.odometry is not None:
            reason = f"--odometry {sources.odometry} makes the poses"
            sources.refuse(reason, "poses", "pose_topic", "world_frame")
        if kind is not None and not kind.unposed:
            sources.refuse("is for bags and folders of clouds", "odometry")
        if kind is not None:
            return kind.open(path, sources, params)
        if path.is_file():
            raise InputError(
                f"{path}: is one file; give a folder of clouds or of image pairs, or a bag (.bag "
                ".mcap .db3)"
            )
        if scans := find_posed_scans(path):
            return open_posed_scans(path, scans, sources)
        return open_folder(path, sources, params)


def build_dataset(
    scans: Path | str,
    directory: Path | str,
    params: BuildParams | None = None,
    *,
    sources: RecordingSources | None = None,
    restart: bool = False,
    overwrite: bool = False,
    progress: Progress = silent,
) -> BuildReport:
    """Build a dataset of submaps from scans and poses.

    Each submap's frame is level. Its origin is the robot's body at the first scan, and its x axis
    is the body's x axis there as seen from above. The points are the means of voxels, each with
    the standard deviation of its height, the range from which it was seen and the number of its
    points. ``trajectory/`` has the sensor's pose at each scan in the submap's frame.

    If a build was stopped or killed, the same call resumes it, and the result is the same byte for
    byte. Until it is finished, its folder is called ``DATASET.partial``.

    Args:
        scans: A folder of clouds with poses, or a ROS bag; without poses if the sources name an
            odometry.
        directory: The dataset to make; it must not exist or be empty.
        params: Where to cut, which direction is up, and how points are put together.
        sources: Where the parts of the recording are, if they are not to be found automatically.
        restart: Whether to delete an unfinished build and begin again.
        overwrite: Whether to replace a dataset that gpgrad made, once the new one is finished.
        progress: Called once per scan; may raise Cancelled.

    Raises:
        InputError: If the recording cannot be used, or the directory is not empty; the message
            says what is wrong and what to do.
    """
    directory = Path(directory)
    sources, params = sources or RecordingSources(), params or BuildParams()
    check_vacant(directory, overwrite=overwrite)  # before the recording is read
    recording = open_recording(scans, sources, params)
    if sources.odometry is not None:
        recording = estimate_poses(recording, params, part(progress, 0.0, ODOMETRY_SHARE))
        progress = part(progress, ODOMETRY_SHARE, 1.0)
    recording, notes = level_recording(recording, params)
    if params.max_time is not None and recording.stamps is None:
        raise InputError(f"{scans}: max_time needs the scans' times: --times FILE")
    pieces = recording.pieces(params)
    header = {
        "made_by": f"gpgrad {__version__}",
        "recording": recording.name,
        "identity": recording.identity,
        "params": asdict(params),
        "topics": [getattr(sources, name) for name in TOPICS],
    }
    further = {
        "right_topic": sources.right_topic,
        "odometry": sources.odometry,
        "keep": [str(condition) for condition in sources.keep],
    }
    header |= {name: value for name, value in further.items() if value}
    with open_journal(directory, header, restart=restart, overwrite=overwrite) as begun:
        resumed = len(begun.entries)
        whole, count = begun, len(recording)
        for scans_of_one in pieces[resumed:]:
            within = part(progress, scans_of_one.start / count, scans_of_one.stop / count)
            whole = _add_submap(whole, recording, scans_of_one, params, within)
        written = [entry for entry in whole.entries if entry.hash is not None]
        if not written:
            whole.abandon()
            measured = sum(entry.measured for entry in whole.entries)
            advice = f"; {recording.advice}" if recording.advice else ""
            raise InputError(
                f"{scans}: no submap has {params.min_points} points or more: "
                f"the {len(recording):,} scans have {measured:,} points together{advice}"
            )
        _write_rest(whole, recording, pieces, params)
        whole.finish(overwrite=overwrite)
    progress(1.0)
    return BuildReport(
        num_submaps=len(written),
        num_scans=sum(entry.scans[1] - entry.scans[0] for entry in written),
        num_resumed=resumed,
        notes=(*recording.notes, *notes, *_left_out(whole.entries, params)),
        num_failed=len(recording.breaks),
    )


def _add_submap(
    journal: Journal, recording: Recording, scans: range, params: BuildParams, progress: Progress
) -> Journal:
    submap_id, cloud = f"{len(journal.entries):03d}", None
    keep = recording.keep
    read, met = keep.num_read, keep.num_passed
    gathered = gather(recording, scans, params, progress)
    voxels = gathered.voxels
    if len(voxels.keys) >= params.min_points and _is_terrain(voxels):
        cloud = journal.clouds / f"{submap_id}.ply"
        extras = {"noise_std": voxels.noise_std, "range": voxels.ranges, "count": voxels.counts}
        write_ply(cloud, voxels.points, extras=extras)
    num_read = keep.num_read - read
    entry = Entry(
        id=submap_id,
        scans=(scans.start, scans.stop),
        before_keep=num_read or None,
        kept=keep.num_passed - met if num_read else None,
        points=len(voxels.keys),
        hash=None,
        **gathered.counts,
    )
    return journal.added(entry, cloud)


@dataclass(frozen=True, eq=False)
class Gathered:
    """The points of the scans of a submap, in its level frame."""

    voxels: Voxels
    counts: Counter[str]  # how many points were measured, and dropped for which reason


def gather(
    recording: Recording, scans: range, params: BuildParams, progress: Progress = silent
) -> Gathered:
    """Merge the points of some scans of a level recording; only one scan is in memory at a time."""
    from_world = Poses.of(level_pose(recording.body.one(scans.start))).inverse()
    sums = VoxelSums(params.voxel_size)
    counts = Counter[str](dict.fromkeys(COUNTED, 0))
    for k, scan_points in zip(scans, recording.read(scans.start, scans.stop), strict=True):
        scan, dropped = usable(scan_points, params)
        points = scan.points
        counts.update(dropped)
        counts["empty_scans"] += not len(points)
        sensor = from_world @ recording.sensor(k)
        if len(points):
            turned = sensor.rotation.apply(points)
            ranges = np.linalg.norm(points, axis=1)
            errors = None
            if scan.std is not None:
                errors = turned * (scan.std / np.maximum(ranges, 1e-9))[:, None]
            sums.add(turned + sensor.translation, ranges, errors, scan.together)
        progress((k + 1 - scans.start) / len(scans))
    return Gathered(sums.total(), counts)


def _is_terrain(voxels: Voxels) -> bool:
    """Whether the points span an area; a submap that does not would spoil the dataset."""
    try:
        submap_of_cloud(voxels.points)
    except InputError:
        return False
    return True


def _write_rest(
    journal: Journal, recording: Recording, pieces: list[range], params: BuildParams
) -> None:
    odometry: dict[int, Pose] = {}
    truth: dict[int, Pose] = {}
    trajectories = journal.folder / "trajectory"
    trajectories.mkdir(exist_ok=True)
    for number, (scans, entry) in enumerate(zip(pieces, journal.entries, strict=True)):
        if entry.hash is None:
            continue
        first = slice(scans.start, scans.start + 1)
        level = Poses.of(level_pose(recording.body.one(scans.start)))
        odometry[number] = level.one(0)
        if recording.truth is not None and recording.truth.valid[scans.start]:
            in_body = recording.body[first].inverse() @ level
            true = recording.truth.poses[first]
            truth[number] = (true if recording.positions_only else true @ in_body).one(0)
        rows = ["# timestamp tx ty tz qx qy qz qw   (p_submap = R p_sensor + t)"]
        for k in scans:
            stamp = f"{k}" if recording.stamps is None else f"{recording.stamps[k]:.6f}"
            rows.append(pose_row(stamp, (level.inverse() @ recording.sensor(k)).one(0)))
        write_lines(trajectories / f"{entry.id}.txt", rows)
    # The antenna's place stands for that of the body: its mount is not known.
    dataset = Dataset(
        journal.directory.name,
        (),
        description=(
            f"{len(odometry)} submap{'s' * (len(odometry) != 1)} of {len(recording):,} scans of "
            f"{recording.name}, cut "
            f"{_limits(params)} (gpgrad build)."
        ),
        positions_only=recording.positions_only and bool(truth),
        origin=recording.origin,
    )
    write_all_but_clouds(journal.folder, dataset, truth, odometry)


def _limits(params: BuildParams) -> str:
    limits = {
        "after {:g} m": params.max_length,
        "at an uncertainty of {:g} m": params.max_uncertainty,
        "at a turn of {:g} rad": params.max_turn,
        "after {:g} s": params.max_time,
    }
    return " or ".join(text.format(limit) for text, limit in limits.items() if limit is not None)


def _left_out(entries: Sequence[Entry], params: BuildParams) -> Iterator[str]:
    total = {key: sum(getattr(entry, key) for entry in entries) for key in COUNTED}
    before = sum(entry.before_keep or 0 for entry in entries)
    remaining = sum(entry.kept or 0 for entry in entries)
    if before:
        share = remaining / before
        yield f"{remaining:,} of {before:,} points ({share:.1%}) meet --keep and are kept"
    reasons = {
        "not_finite": "not finite",
        "too_close": f"closer than {params.min_range:g} m to the sensor",
        "too_far": (
            f"further than {params.max_range:g} m from the sensor"
            if params.max_range
            else f"further from the sensor than voxels of {params.voxel_size:g} m reach"
        ),
    }
    for key, reason in reasons.items():
        if total[key]:
            yield f"{total[key]:,} of {total['measured']:,} points are {reason}: left out"
    if total["empty_scans"]:
        number = total["empty_scans"]
        have = "scan has" if number == 1 else "scans have"
        yield f"{number:,} {have} no usable point"
    for entry in entries:
        if entry.hash is None:
            first, stop = entry.scans
            yield (
                f"submap {entry.id} of {stop - first:,} scans was left out: its "
                f"{entry.points:,} points are fewer than {params.min_points:,}, or lie on one "
                "line"
            )
