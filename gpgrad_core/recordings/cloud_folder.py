"""A folder of clouds with a file of poses, or with a pose each (`io.poses`) -> a recording."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds import CLOUD_ENDINGS, is_cloud, read_cloud
from gpgrad_core.io.poses import PosedScan
from gpgrad_core.reading.paths import in_order, order_notes, seconds_in, with_distinct_numbers
from gpgrad_core.recordings.params import BuildParams, PointFilter
from gpgrad_core.recordings.pose_files import (
    Mount,
    PoseFile,
    read_mount,
    read_pose_file,
    read_times,
    read_truth_file,
)
from gpgrad_core.recordings.recording import (
    FoundPoses,
    FoundScans,
    ReadScans,
    Recording,
    RecordingSources,
    Scan,
    assemble,
    find_file,
    identify,
    time_span,
)
from gpgrad_core.recordings.trajectory import Located, Poses
from gpgrad_core.run.folders import is_unfinished

CLOUD_FOLDERS = ("", "scans", "velodyne", "velodyne_points", "clouds")
SINCE_1970 = 1e8
"""Numbers in names from this on are times: seconds of 1973, or parts of seconds since then."""
POSE_NAMES = ("poses.txt", "poses.tum", "poses_odom.txt", "odometry.txt", "trajectory.txt")


def open_folder(path: Path, sources: RecordingSources, params: BuildParams) -> Recording:
    """Open a folder of clouds, in itself or in one of `CLOUD_FOLDERS`, with a file of poses."""
    if is_unfinished(path.resolve()):
        raise InputError(f"{path}: is a recording that is not finished; make it again")
    clouds, scans_folder = _find_clouds(path)
    places = [path] if scans_folder == path else [path, scans_folder]
    pose_path, unused = _find_poses(path, places, sources)
    poses = None if pose_path is None else read_pose_file(pose_path)
    truth_path = sources.truth or find_file(places, ("poses_gt.txt", "positions_gt.txt"))
    truth = None if truth_path is None else read_truth_file(truth_path)
    if truth_path is not None and truth is not None and pose_path is not None and poses is not None:
        unused += _check_truth(truth, poses, truth_path, pose_path)
    times_path = sources.times or find_file(places, ("times.txt", "timestamps.txt"))
    times = None if times_path is None else read_times(times_path)
    reference = poses or truth
    numbered = reference is not None and reference.numbered
    mount_path, mount, mount_notes = _find_mount(sources, places, numbered)
    if times is not None and len(times) != len(clouds) and not numbered:
        raise InputError(
            f"{times_path}: holds {len(times):,} times for {len(clouds):,} scans; "
            "the recording is not complete, or they do not belong together"
        )
    keys, stamps, notes = _stamps(clouds, reference, times, path)
    order = np.argsort(keys, kind="stable")
    keys, clouds = keys[order], [clouds[k] for k in order]
    keep = PointFilter(sources.keep)
    still = Located.all_valid(Poses.identity(len(keys)))
    scans = FoundScans(
        labels=[cloud.name for cloud in clouds],
        read=_reader(clouds, keep),
        stamps=None if stamps is None else stamps[order],
        keys=keys,
        files=[(cloud,) for cloud in clouds],
        mount=mount.pose,
        keep=keep,
    )
    poses_of_scans = FoundPoses(
        still if poses is None else poses.trajectory,
        span="" if poses is None else _span(poses),
        up="-y" if mount.on_camera else "z",
        truth=truth,
        truth_name=str(truth_path),
        notes=(*unused, *mount_notes),
    )
    texts = [pose_path, truth_path, times_path, mount_path]
    return assemble(path, sources, params, scans, poses_of_scans, texts=texts, notes=notes)


def open_posed_scans(
    path: Path, scans: Sequence[PosedScan], sources: RecordingSources
) -> Recording:
    """Open scans with a pose each; the sources must name no file."""
    each = f"the scans of {path} have a pose each, in {scans[0].source.name} and so on"
    sources.refuse(each, "poses", "truth", "times", "mount", "odometry")
    sources.refuse(f"the scans of {path} have x, y and z only", "keep")
    posed = [(scan, scan.pose) for scan in scans if scan.pose is not None]
    if not posed:
        raise InputError(f"{scans[0].source}: has no pose of a scan")
    read = _reader([scan.cloud for scan, _ in posed], PointFilter())
    notes = tuple(
        f"{scan.name}: has no pose in {scan.source.name} and was left out"
        for scan in scans
        if scan.pose is None
    )
    if scans[0].true:
        notes = ("the poses of the scans are the true ones; there is no odometry",)
    body, scans = Poses.of(*(pose for _, pose in posed)), [scan for scan, _ in posed]
    return Recording(
        name=path.resolve().name,
        identity=identify([file for scan in scans for file in (scan.cloud, scan.source)]),
        stamps=None,
        body=body,
        mount=Poses.identity(),
        read=lambda start, stop: read(range(start, stop)),
        labels=tuple(scan.cloud.name for scan in scans),
        truth=Located.all_valid(body) if scans[0].true else None,
        notes=notes,
    )


def is_scan_folder(path: Path) -> bool:
    """Whether clouds are scans rather than submaps, whose poses name them by whole numbers."""
    if not path.is_dir() or (path / "submaps").is_dir():
        return False
    try:
        _, folder = _find_clouds(path)
        pose_path = find_file([path] if folder == path else [path, folder], POSE_NAMES)
        if pose_path is None or folder != path:
            return folder != path
        poses = read_pose_file(pose_path)
    except InputError:
        return False
    stamps = poses.trajectory.stamps
    return poses.numbered or bool((stamps != np.floor(stamps)).any())


def _find_poses(
    path: Path, places: Sequence[Path], sources: RecordingSources
) -> tuple[Path | None, tuple[str, ...]]:
    """Find the file of poses, none if odometry is to make them; also give a note."""
    pose_path = sources.poses or find_file(places, POSE_NAMES)
    if sources.odometry is None and pose_path is None:
        raise InputError(
            f"{path}: has no file of poses ({', '.join(POSE_NAMES)}); say where it is: --poses "
            "FILE, or make some of a LiDAR's scans: --odometry kiss-icp"
        )
    if sources.odometry is None or pose_path is None:
        return pose_path, ()
    return None, (f"{pose_path.name}: is not used, for {sources.odometry} makes the poses",)


def _check_truth(
    truth: PoseFile, poses: PoseFile, truth_path: Path, pose_path: Path
) -> tuple[str, ...]:
    """Check that truth and poses belong together; give a note if they are not as many rows."""
    if truth.positions_only and poses.numbered:
        raise InputError(
            f"{truth_path}: has positions by time, which the KITTI poses of {pose_path.name} "
            "do not have; give TUM poses"
        )
    if truth.numbered != poses.numbered:
        raise InputError(
            f"{truth_path}: {pose_path.name} and the true poses must both be TUM or KITTI rows"
        )
    num_poses, num_true = len(poses.trajectory.stamps), len(truth.trajectory.stamps)
    rows = f"{truth_path.name}: has {num_true:,} KITTI rows and {pose_path.name} {num_poses:,}"
    return (f"{rows}, from the same first one on",) * (poses.numbered and num_poses != num_true)


def _find_clouds(path: Path) -> tuple[list[Path], Path]:
    """List the clouds, in the order of their names, and the folder that they lie in."""
    for name in CLOUD_FOLDERS:
        folder = path / name
        if not folder.is_dir():
            continue
        entries = (entry for entry in folder.iterdir() if not entry.name.startswith("."))
        if clouds := in_order([entry for entry in entries if is_cloud(entry)]):
            return clouds, folder
    raise InputError(
        f"{path}: holds no scans: neither it nor its {', '.join(CLOUD_FOLDERS[1:])} have clouds "
        f"({CLOUD_ENDINGS}), and it is not a bag"
    )


def _find_mount(
    sources: RecordingSources, places: Sequence[Path], numbered: bool
) -> tuple[Path | None, Mount, tuple[str, ...]]:
    """Find the file of the sensor's pose on the body; give its path, its content and a note."""
    # Other tools have a calib.txt too; beside KITTI's poses it is KITTI's.
    names = ("mount.txt", "calib.txt") if numbered else ("mount.txt",)
    path = sources.mount or find_file(places, names)
    if path is None:
        return None, Mount(Poses.identity()), ()
    mount = read_mount(path)
    if mount.on_camera:
        return path, mount, (f"{path.name}: is KITTI's, so the poses are of a camera: up is -y",)
    note = f"{path.name}: was found and is used as the sensor's pose on the body"
    return path, mount, () if sources.mount else (note,)


def _span(poses: PoseFile) -> str:
    stamps = poses.trajectory.stamps
    if poses.numbered:
        return f"of rows 0 to {len(stamps) - 1:,}"
    return f"from {time_span(stamps)}"


def _stamps(
    clouds: list[Path], poses: PoseFile | None, times: Float[Array, "t"] | None, path: Path
) -> tuple[Array, Float[Array, "n"] | None, tuple[str, ...]]:
    """Find the keys of the scans among the poses, their times [s] if known, and notes.

    Keys are times [s], KITTI's row numbers, or without poses the scans' places in order.
    """
    if times is not None and (poses is None or not poses.numbered):
        return times, times, order_notes(clouds, "times")
    numbers = [number_in(name) for name in with_distinct_numbers([c.stem for c in clouds])]
    if poses is not None and poses.numbered:
        rows, notes = _row_of_each(numbers, len(poses.trajectory.stamps), clouds, path)
        if times is not None and int(rows.max()) >= len(times):
            raise InputError(f"{path}: has a scan {int(rows.max())}, but only {len(times):,} times")
        return rows.astype(np.float64), None if times is None else times[rows], notes
    times_in_names = [number for number in numbers if number is not None]
    whole = len(times_in_names) == len(numbers)
    if poses is None and not (whole and min(times_in_names) >= SINCE_1970):
        order = np.argsort(np.argsort(times_in_names)) if whole else np.arange(len(clouds))
        return order.astype(np.float64), None, ()
    if not whole:
        first = clouds[numbers.index(None)].name
        raise InputError(
            f"{path}: the name {first} holds no time; give the scans' times: --times FILE"
        )
    stamps = np.array(times_in_names)
    spans = SINCE_1970 * np.array([1.0, 100.0])
    if poses is not None:
        spans = poses.trajectory.stamps[[0, -1]] + [-1.0, 1.0]
    middle = float(np.median(stamps))
    for scale, unit in ((1.0, ""), (1e-9, "nanoseconds"), (1e-6, "microseconds"), (1e-3, "ms")):
        if spans[0] <= scale * middle <= spans[1]:
            note = (f"the numbers in the scans' names are read as {unit}",) if unit else ()
            return scale * stamps, scale * stamps, note
    return stamps, stamps, ()


def _row_of_each(
    numbers: list[float | None], num_rows: int, clouds: Sequence[Path], path: Path
) -> tuple[Int[NDArray[np.int64], "n"], tuple[str, ...]]:
    """Find the KITTI row of each scan: by the number in its name, or else by its place in order."""
    whole = {int(number) for number in numbers if number is not None and number.is_integer()}
    if len(whole) == len(numbers) and max(whole) < num_rows:
        if min(whole) == 1:
            raise InputError(
                f"{path}: {len(numbers):,} scans from number 1 on and {num_rows:,} KITTI poses: "
                "the first may belong to row 0 or 1; give as many poses as scans"
            )
        rows = np.array([int(number or 0) for number in numbers])
        first, last = int(rows.argmin()), int(rows.argmax())
        note = (
            f"the KITTI rows belong to the files by number, from 0: row {rows[first]:,} to "
            f"{clouds[first].name}, row {rows[last]:,} to {clouds[last].name}; "
            f"{num_rows - len(rows):,} of {num_rows:,} have no scan and are left out"
        )
        return rows, (note,) * (len(rows) < num_rows)
    if len(numbers) != num_rows:
        raise InputError(
            f"{path}: {len(numbers):,} scans and {num_rows:,} KITTI poses, and the names do not "
            "number the rows from 0; give as many poses as scans"
        )
    return np.arange(num_rows), order_notes(clouds, "KITTI rows")


def number_in(stem: str) -> float | None:
    """Find the last number in a file's name.

    >>> number_in("scan_000012"), number_in("1311868164.363181"), number_in("ground")
    (12.0, 1311868164.363181, None)
    >>> number_in("cloud_1311868164_363181000")
    1311868164.363181
    """
    time = seconds_in(stem)
    if time:
        return float(".".join(time))
    numbers = re.findall(r"\d+(?:\.\d+)?", stem)
    return float(numbers[-1]) if numbers else None


def _reader(clouds: list[Path], keep: PointFilter) -> ReadScans:
    def read_scan(k: int) -> Scan:
        content = read_cloud(clouds[k], {condition.field for condition in keep.conditions})
        return Scan(keep.select(content.points, content.numbers.get, str(clouds[k])))

    return lambda numbers: map(read_scan, numbers)
