"""Folders of image pairs -> recordings: those of EuRoC, KITTI and MADMAX.

**EuRoC.** In the folder, or in its ``mav0/``, each of ``cam0/`` and ``cam1/`` has ``data/`` with
images, ``data.csv`` with rows ``time [ns], file name``, and ``sensor.yaml`` with ``resolution``,
``intrinsics``, the distortion and ``T_BS``, the camera's pose on the body. The images are as they
were taken. ``state_groundtruth_estimate0/data.csv`` may have the true poses of the body: rows of
the time [ns], x, y, z [m] and the quaternion w, x, y, z. ``mocap0/`` may stand in its place.

**KITTI.** A sequence of the odometry benchmark has ``image_0`` and ``image_1`` (grey) or
``image_2`` and ``image_3`` (colour) with ``000000.png …``, rectified; ``calib.txt`` with the
projections ``P0:`` to ``P3:``; ``times.txt``; and ``poses.txt`` with the poses of camera 0, whose y
axis points down. The poses may also be TUM rows, of the same camera.

**MADMAX.** Meyer et al., *The MADMAX data set for visual-inertial rover navigation on Mars*
(Journal of Field Robotics 2021). Its archives unpack to ``img_rect_left/`` and ``img_rect_right/``
with ``img_rect_left_TIME.png`` (TIME in ns; rectified, grey, 1032 x 772), ``calibration/`` with
``camera_rect_left_info.txt`` and ``camera_rect_right_info.txt`` (a ``CameraInfo`` as ROS prints it)
and transforms such as ``tf__imu_to_camera_left.csv`` (a line of names, then ``position.x ..
orientation.w``), and ``ground_truth/`` with ``gt_6DoF_gnss_and_imu.csv`` or ``gt_5DoF_gnss.csv``:
comments, then columns ``UNIX time``, ``x-enu(m)`` and so on for the frame B of the rig. The
specification here was what three programs read: the class MadmaxDataset of a visual odometry,
VSLAM-LAB's dataset_madmax.py, and granite's convert_madmax_to_euroc.py (which has folders
``rect_left`` and ``rect_right``). The transforms are taken as ROS's tf means them: ``a_to_b`` is
the pose of b in a. A fourth program has the camera ahead of B, looking down, which fits.
Unverified, as nothing could be downloaded: the files themselves, and whether the clocks of images
and GNSS agree to more than the authors say.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.io.poses import make_pose
from gpgrad_core.reading.images import read_images
from gpgrad_core.reading.paths import in_order, order_notes
from gpgrad_core.reading.text import lines_of, parse_numbers, read_text
from gpgrad_core.recordings.cameras import read_camera, read_kitti_cameras
from gpgrad_core.recordings.cloud_folder import POSE_NAMES
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.pose_files import (
    LARGEST_TABLE,
    PoseFile,
    read_mount,
    read_pose_file,
    read_timed_poses,
    read_times,
    read_truth_file,
    table_rows,
)
from gpgrad_core.recordings.recording import (
    FoundPoses,
    FoundScans,
    Recording,
    RecordingSources,
    Scan,
    assemble,
    find_file,
    pair_stamps,
)
from gpgrad_core.recordings.stereo import NO_MATCH, Rig, make_rig
from gpgrad_core.recordings.trajectory import Poses, Trajectory
from gpgrad_core.se2 import Pose

ENDINGS = (".png", ".jpg", ".jpeg", ".pgm", ".bmp", ".tif", ".tiff")
BATCH = 8
"""Number of pairs that are decoded together."""
EUROC_CAMERAS = ("cam0", "cam1")
EUROC_TRUTHS = ("state_groundtruth_estimate0", "mocap0")
EUROC_STATES = (0, 1, 2, 3, 5, 6, 7, 4), True
"""Columns of the time, x, y, z, qx, qy, qz and qw of true poses, whose times are in nanoseconds."""
KITTI_CAMERAS = ((0, 1), (2, 3))
MADMAX_TRUTHS = ("gt_6DoF_gnss_and_imu.csv", "gt_5DoF_gnss.csv")
MADMAX_COLUMNS = (
    "UNIX time", "x-enu(m)", "y-enu(m)", "z-enu(m)",
    "orientation.x", "orientation.y", "orientation.z", "orientation.w",
)  # fmt: skip
MADMAX_TIME = re.compile(r"(\d{16,19})$")


def images_in(folder: Path) -> list[Path]:
    """List the images of a folder in the order of their names; there may be none, or no folder."""
    if not folder.is_dir():
        return []
    files = in_order(list(folder.iterdir()))
    return [k for k in files if k.suffix.lower() in ENDINGS and not k.name.startswith(".")]


def is_pair(one: Path, other: Path) -> bool:
    """Whether two folders have images."""
    return bool(images_in(one)) and bool(images_in(other))


def _open_pairs(
    path: Path,
    pairs: Sequence[tuple[Path, Path]],
    stamps: Float[NDArray[np.float64], "n"],
    rig: Rig,
    mount: Poses,
    sources: RecordingSources,
    params: BuildParams,
    *,
    own: Trajectory | None = None,
    poses: Trajectory | None = None,
    truth: PoseFile | None = None,
    up: str = "z",
    files: Sequence[Path] = (),
    notes: tuple[str, ...] = (),
) -> Recording:
    """Make a recording of pairs by times [s]; the mount is ``T_body_camera`` of the left one.

    The recording's own true poses are the poses if no others are named, and the truth otherwise.
    """
    if truth is None and sources.truth is not None:
        truth = read_truth_file(sources.truth)
    if poses is None and sources.poses is not None:
        poses = read_timed_poses(sources.poses)
        if truth is None and own is not None:
            truth = PoseFile(own, numbered=False)
    elif poses is None and own is not None:
        poses = own
        notes += ("the poses are the true ones of the recording; there is no odometry",)
    if poses is None:
        raise InputError(f"{path}: has no poses; say where they are: --poses FILE")
    sources.refuse("image pairs have x, y and z only", "keep")
    sources.refuse("the folder has its own calibration", "calibration")

    def read(numbers: Sequence[int]) -> Iterator[Scan]:
        chosen = [pairs[k] for k in numbers]
        images = read_images([file for pair in chosen for file in pair], 2 * BATCH)
        for (left, _), one, other in zip(chosen, images, images, strict=True):
            yield rig.scan(one, other, str(left), params.min_range)

    scans = FoundScans(
        labels=[left.name for left, _ in pairs],
        read=read,
        stamps=stamps,
        files=pairs,
        mount=mount if sources.mount is None else read_mount(sources.mount).pose,
        advice=NO_MATCH,
    )
    poses_of_scans = FoundPoses(poses, up=up, truth=truth, truth_name=str(sources.truth or path))
    texts = [*files, sources.poses, sources.truth, sources.mount]
    return assemble(path, sources, params, scans, poses_of_scans, texts=texts, notes=notes)


def _euroc_root(path: Path) -> Path:
    return path / "mav0" if (path / "mav0").is_dir() else path


def is_euroc(path: Path) -> bool:
    """Whether a folder has image pairs as EuRoC's do."""
    root = _euroc_root(path)
    return is_pair(*(root / camera / "data" for camera in EUROC_CAMERAS))


def open_euroc(path: Path, sources: RecordingSources, params: BuildParams) -> Recording:
    """Open a folder of image pairs; true poses that it brings are used as far as needed."""
    root = _euroc_root(path)
    sources.refuse("the images have their times in data.csv", "times")
    files = [
        root / camera / name for camera in EUROC_CAMERAS for name in ("data.csv", "sensor.yaml")
    ]
    (left_times, left), (right_times, right) = (
        _euroc_images(root / camera) for camera in EUROC_CAMERAS
    )
    numbers, notes = pair_stamps(left_times, right_times, str(path), EUROC_CAMERAS)
    cameras = [read_camera(root / camera / "sensor.yaml") for camera in EUROC_CAMERAS]
    on_body = [camera.on_body for camera in cameras]
    if on_body[0] is None or on_body[1] is None:
        raise InputError(f"{files[1] if on_body[0] is None else files[3]}: has no T_BS")
    rig = make_rig(cameras[0], cameras[1], on_body[0].inverse() @ on_body[1])
    tables = [file for name in EUROC_TRUTHS if (file := root / name / "data.csv").is_file()]
    own = read_timed_poses(tables[0], EUROC_STATES) if tables else None
    return _open_pairs(
        path,
        [(left[i], right[k]) for i, k in numbers],
        left_times[numbers[:, 0]],
        rig,
        on_body[0],
        sources,
        params,
        own=own,
        files=[*files, *tables[:1]],
        notes=notes,
    )


def _euroc_images(folder: Path) -> tuple[Float[NDArray[np.float64], "n"], list[Path]]:
    """Read the times [s] and the files of a camera's images."""
    table = folder / "data.csv"
    stamps: list[float] = []
    files: list[Path] = []
    for where, cells in table_rows(table):
        if len(cells) != 2 or Path(cells[1]).name != cells[1]:
            raise InputError(f"{where}: must be a time [ns] and the name of a file in data/")
        if not (folder / "data" / cells[1]).is_file():
            raise InputError(f"{where}: {folder / 'data' / cells[1]}: no such file")
        stamps.append(1e-9 * parse_numbers(cells[:1], where)[0])
        files.append(folder / "data" / cells[1])
    if not files:
        raise InputError(f"{table}: holds no images")
    return np.array(stamps), files


def is_kitti_pairs(path: Path) -> bool:
    """Whether a folder has image pairs as KITTI's do."""
    return _kitti_cameras(path) is not None


def _kitti_cameras(path: Path) -> tuple[int, int] | None:
    pairs = (k for k in KITTI_CAMERAS if is_pair(path / f"image_{k[0]}", path / f"image_{k[1]}"))
    return next(pairs, None)


def open_kitti_pairs(path: Path, sources: RecordingSources, params: BuildParams) -> Recording:
    """Open a sequence."""
    numbers = _kitti_cameras(path)
    assert numbers is not None
    left, right = (images_in(path / f"image_{number}") for number in numbers)
    by_name = {file.stem: file for file in right}
    pairs = [(file, by_name[file.stem]) for file in left if file.stem in by_name]
    if not pairs:
        raise InputError(
            f"{path}: no image of image_{numbers[0]} has the name of one of image_{numbers[1]}"
        )
    notes = order_notes(left, "times")
    if len(pairs) < len(left):
        notes += (f"{len(left) - len(pairs):,} of {len(left):,} left images have no right one",)
    calibration = path / "calib.txt"
    if not calibration.is_file():
        raise InputError(f"{path}: has no calib.txt, the calibration of its cameras")
    cameras = read_kitti_cameras(calibration, numbers)
    rig = make_rig(*cameras, rectified=True)
    times_path = sources.times or path / "times.txt"
    if not times_path.is_file():
        raise InputError(f"{path}: has no times.txt; say where it is: --times FILE")
    times = read_times(times_path)
    if len(times) != len(left):
        raise InputError(
            f"{times_path}: holds {len(times):,} times for {len(left):,} left images; the "
            "recording is not complete, or they do not belong together"
        )
    row_of = {file: k for k, file in enumerate(left)}
    stamps = np.array([times[row_of[file]] for file, _ in pairs])
    pose_path = sources.poses or find_file([path], POSE_NAMES)
    if pose_path is None:
        raise InputError(f"{path}: has no poses.txt; say where the poses are: --poses FILE")
    poses = read_pose_file(pose_path)
    trajectory = poses.trajectory
    if poses.numbered:
        trajectory = _timed(trajectory, times, pose_path)
    truth_path = sources.truth or path / "poses_gt.txt"
    truth = (
        read_truth_file(truth_path) if sources.truth is not None or truth_path.is_file() else None
    )
    if truth is not None and truth.numbered:
        truth = replace(truth, trajectory=_timed(truth.trajectory, times, truth_path))
    # The poses are those of camera 0, of which P says how far a camera is to the right.
    projection = cameras[0].projection
    assert projection is not None
    offset = -projection[0, 3] / projection[0, 0]
    return _open_pairs(
        path,
        pairs,
        stamps,
        rig,
        Poses(np.array([[offset, 0.0, 0.0]]), Rotation.identity(1)),
        sources,
        params,
        poses=trajectory,
        truth=truth,
        up="-y" if poses.numbered else "z",
        files=[calibration, times_path, pose_path, *([truth_path] if truth is not None else [])],
        notes=notes,
    )


def _timed(poses: Trajectory, times: Float[Array, "n"], path: Path) -> Trajectory:
    if len(poses.stamps) != len(times):
        raise InputError(f"{path}: holds {len(poses.stamps):,} poses for {len(times):,} times")
    return Trajectory.in_order(times, poses.poses)


def _madmax_folders(path: Path) -> tuple[Path, Path] | None:
    if not path.is_dir():
        return None
    for left in sorted(path.glob("*rect_left*")):
        right = path / left.name.replace("left", "right")
        if is_pair(left, right) and MADMAX_TIME.search(images_in(left)[0].stem):
            return left, right
    return None


def is_madmax(path: Path) -> bool:
    """Whether a folder is a run of MADMAX."""
    return _madmax_folders(path) is not None


def open_madmax(path: Path, sources: RecordingSources, params: BuildParams) -> Recording:
    """Open a run. Its folder ``calibration`` is in it or beside it; so may be its ground truth."""
    folders = _madmax_folders(path)
    assert folders is not None
    sources.refuse("the images have their times in their names", "times")
    left, right = (images_in(folder) for folder in folders)
    times = [np.array([_madmax_time(file) for file in files]) for files in (left, right)]
    names = [folder.name for folder in folders]
    numbers, notes = pair_stamps(times[0], times[1], str(path), names)
    infos = [
        _find_calibration(path, f"camera_rect_{side}_info.txt", sources.root)
        for side in ("left", "right")
    ]
    cameras = [read_camera(info) for info in infos]
    rig = make_rig(cameras[0], cameras[1], rectified=True)
    frames = [
        _find_calibration(path, f"tf__imu_to_{name}.csv", sources.root)
        for name in ("B", "camera_left")
    ]
    imu_b, imu_camera = (_read_transform(file) for file in frames)
    tables = [file for name in MADMAX_TRUTHS for file in sorted(path.glob(f"**/{name}"))]
    return _open_pairs(
        path,
        [(left[i], right[k]) for i, k in numbers],
        times[0][numbers[:, 0]],
        rig,
        imu_b.inverse() @ imu_camera,
        sources,
        params,
        own=_read_madmax_truth(tables[0]) if tables else None,
        files=[*infos, *frames, *tables[:1]],
        notes=notes,
    )


def _madmax_time(file: Path) -> float:
    match = MADMAX_TIME.search(file.stem)
    if match is None:
        raise InputError(f"{file}: its name does not end with a time in nanoseconds")
    return 1e-9 * int(match[1])


def _find_calibration(path: Path, name: str, root: Path | None) -> Path:
    """Find a file of the calibration, within a root if there is one."""
    places = (path, path.resolve().parent)
    candidates = (
        file
        for place in places
        if root is None or place.resolve().is_relative_to(root.resolve())
        for file in sorted(place.glob(f"*calibration*/**/{name}"))
        if root is None or file.resolve().is_relative_to(root.resolve())
    )
    calibration = next(candidates, None)
    if calibration is None:
        raise InputError(
            f"{path}: has no calibration/{name}, and neither has the folder that it is in; unpack "
            "the calibration there"
        )
    return calibration


def _read_transform(path: Path) -> Poses:
    """Read a pose in the frame that the name gives first."""
    rows = table_rows(path)
    where, cells = rows[-1] if rows else (str(path), [])
    words = cells if len(cells) == 7 else " ".join(cells).split()
    if len(words) != 7:
        raise InputError(f"{where}: must be x y z qx qy qz qw, it has {len(words)} numbers")
    return Poses.of(make_pose(parse_numbers(words, where), where))


def _read_madmax_truth(path: Path) -> Trajectory:
    head: list[str] | None = None
    for line in lines_of(read_text(path, LARGEST_TABLE)):
        names = [name.strip(" %#") for name in line.split(",")]
        if MADMAX_COLUMNS[0] in names:
            head = names
            break
    missing = [name for name in MADMAX_COLUMNS if head is None or name not in head]
    if head is None or missing:
        raise InputError(f"{path}: has no column {', '.join(missing)}")
    at = [head.index(name) for name in MADMAX_COLUMNS]
    stamps: list[float] = []
    poses: list[Pose] = []
    for where, cells in table_rows(path):
        if cells[0] == head[0]:
            continue  # the names, where they are no comment
        if len(cells) <= max(at):
            raise InputError(f"{where}: has {len(cells)} columns, the names are {len(head)}")
        stamp, *pose = parse_numbers([cells[k] for k in at], where)
        stamps.append(stamp)
        poses.append(make_pose(pose, where))
    if not poses:
        raise InputError(f"{path}: holds no poses")
    return Trajectory.in_order(np.array(stamps), Poses.of(*poses))
