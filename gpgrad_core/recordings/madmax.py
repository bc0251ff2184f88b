"""A run of the MADMAX dataset -> a recording.

The dataset is that of Meyer et al., *The MADMAX data set for visual-inertial rover navigation on
Mars* (Journal of Field Robotics 2021). Its archives unpack to ``img_rect_left/`` and
``img_rect_right/`` with ``img_rect_left_TIME.png`` (TIME in ns; rectified, grey, 1032 x 772),
``calibration/`` with ``camera_rect_left_info.txt`` and ``camera_rect_right_info.txt`` (a
``CameraInfo`` as ROS prints it) and transforms such as ``tf__imu_to_camera_left.csv`` (a line of
names, then ``position.x .. orientation.w``), and ``ground_truth/`` with
``gt_6DoF_gnss_and_imu.csv`` or ``gt_5DoF_gnss.csv``: comments, then columns ``UNIX time``,
``x-enu(m)`` and so on for the frame B of the rig.

The specification here was what three programs read: the class MadmaxDataset of a visual odometry,
VSLAM-LAB's dataset_madmax.py, and granite's convert_madmax_to_euroc.py (which has folders
``rect_left`` and ``rect_right``). The transforms are taken as ROS's tf means them: ``a_to_b`` is
the pose of b in a. A fourth program has the camera ahead of B, looking down, which fits.

Unverified, as nothing could be downloaded: the files themselves, and whether the clocks of images
and GNSS agree to more than the authors say.
"""

import re
from pathlib import Path

import numpy as np

from gpgrad_core.errors import InputError
from gpgrad_core.io.poses import make_pose
from gpgrad_core.reading.text import lines_of, parse_numbers, read_text
from gpgrad_core.recordings.cameras import read_camera
from gpgrad_core.recordings.euroc import LARGEST_TABLE, rows_of
from gpgrad_core.recordings.image_pairs import choose_poses, images_in, is_pair, open_pairs
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.recording import Recording, RecordingSources, pair_stamps
from gpgrad_core.recordings.stereo import make_rig
from gpgrad_core.recordings.trajectory import Poses, Trajectory
from gpgrad_core.se2 import Pose

SIDES = ("left", "right")
TRUTHS = ("gt_6DoF_gnss_and_imu.csv", "gt_5DoF_gnss.csv")
COLUMNS = (
    "UNIX time", "x-enu(m)", "y-enu(m)", "z-enu(m)",
    "orientation.x", "orientation.y", "orientation.z", "orientation.w",
)  # fmt: skip
TIME = re.compile(r"(\d{16,19})$")


def _folders(path: Path) -> tuple[Path, Path] | None:
    if not path.is_dir():
        return None
    for left in sorted(path.glob("*rect_left*")):
        right = path / left.name.replace("left", "right")
        if is_pair(left, right) and TIME.search(images_in(left)[0].stem):
            return left, right
    return None


def is_madmax(path: Path) -> bool:
    """Tell whether a folder is a run of MADMAX."""
    return _folders(path) is not None


def open_madmax(path: Path, sources: RecordingSources, params: BuildParams) -> Recording:
    """Open a run. Its folder ``calibration`` is in it or beside it; so may be its ground truth."""
    folders = _folders(path)
    assert folders is not None
    sources.refuse("the images have their times in their names", "times")
    left, right = (images_in(folder) for folder in folders)
    times = [np.array([_time(file) for file in files]) for files in (left, right)]
    names = [folder.name for folder in folders]
    numbers, notes = pair_stamps(times[0], times[1], str(path), names)
    infos = [_find(path, f"camera_rect_{side}_info.txt", sources.root) for side in SIDES]
    cameras = [read_camera(info) for info in infos]
    rig = make_rig(cameras[0], cameras[1], rectified=True)
    frames = [_find(path, f"tf__imu_to_{name}.csv", sources.root) for name in ("B", "camera_left")]
    imu_b, imu_camera = (_transform(file) for file in frames)
    tables = [file for name in TRUTHS for file in sorted(path.glob(f"**/{name}"))]
    own = _read_truth(tables[0]) if tables else None
    trajectory, truth, pose_notes = choose_poses(path, own, sources)
    return open_pairs(
        path,
        [(left[i], right[k]) for i, k in numbers],
        times[0][numbers[:, 0]],
        rig,
        imu_b.inverse() @ imu_camera,
        trajectory,
        truth,
        sources,
        params,
        files=[*infos, *frames, *tables[:1]],
        notes=(*notes, *pose_notes),
    )


def _time(file: Path) -> float:
    found = TIME.search(file.stem)
    if found is None:
        raise InputError(f"{file}: its name does not end with a time in nanoseconds")
    return 1e-9 * int(found[1])


def _find(path: Path, name: str, root: Path | None) -> Path:
    """Find a file of the calibration, within a root if there is one."""
    places = (path, path.resolve().parent)
    candidates = (
        file
        for place in places
        if root is None or place.resolve().is_relative_to(root.resolve())
        for file in sorted(place.glob(f"*calibration*/**/{name}"))
        if root is None or file.resolve().is_relative_to(root.resolve())
    )
    found = next(candidates, None)
    if found is None:
        raise InputError(
            f"{path}: has no calibration/{name}, and neither has the folder that it is in; unpack "
            "the calibration there"
        )
    return found


def _transform(path: Path) -> Poses:
    """Read a pose in the frame that the name gives first."""
    rows = rows_of(path)
    where, cells = rows[-1] if rows else (str(path), [])
    words = cells if len(cells) == 7 else " ".join(cells).split()
    if len(words) != 7:
        raise InputError(f"{where}: must be x y z qx qy qz qw, it has {len(words)} numbers")
    return Poses.of(make_pose(parse_numbers(words, where), where))


def _read_truth(path: Path) -> Trajectory:
    head: list[str] | None = None
    for line in lines_of(read_text(path, LARGEST_TABLE)):
        names = [name.strip(" %#") for name in line.split(",")]
        if COLUMNS[0] in names:
            head = names
            break
    missing = [name for name in COLUMNS if head is None or name not in head]
    if head is None or missing:
        raise InputError(f"{path}: has no column {', '.join(missing)}")
    at = [head.index(name) for name in COLUMNS]
    stamps: list[float] = []
    poses: list[Pose] = []
    for where, cells in rows_of(path):
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
