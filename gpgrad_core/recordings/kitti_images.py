"""KITTI's folders of image pairs -> a recording.

A sequence of KITTI's odometry benchmark has ``image_0`` and ``image_1`` (grey) or ``image_2`` and
``image_3`` (colour) with ``000000.png …``, rectified; ``calib.txt`` with the projections ``P0:`` to
``P3:``; ``times.txt``; and ``poses.txt`` with the poses of camera 0, whose y axis points down. The
poses may also be TUM rows, of the same camera.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.reading.paths import order_notes
from gpgrad_core.recordings.cameras import read_kitti_cameras
from gpgrad_core.recordings.cloud_folder import POSE_NAMES
from gpgrad_core.recordings.image_pairs import images_in, is_pair, open_pairs
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.pose_files import read_pose_file, read_times, read_truth_file
from gpgrad_core.recordings.recording import Recording, RecordingSources
from gpgrad_core.recordings.stereo import make_rig
from gpgrad_core.recordings.trajectory import Poses, Trajectory

CAMERAS = ((0, 1), (2, 3))
CALIBRATION, TIMES = "calib.txt", "times.txt"


def is_kitti_pairs(path: Path) -> bool:
    """Tell whether a folder has image pairs as KITTI's do."""
    return _numbers(path) is not None


def _numbers(path: Path) -> tuple[int, int] | None:
    pairs = (k for k in CAMERAS if is_pair(path / f"image_{k[0]}", path / f"image_{k[1]}"))
    return next(pairs, None)


def open_kitti_pairs(path: Path, sources: RecordingSources, params: BuildParams) -> Recording:
    """Open a sequence."""
    numbers = _numbers(path)
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
    calibration = path / CALIBRATION
    if not calibration.is_file():
        raise InputError(f"{path}: has no {CALIBRATION}, the calibration of its cameras")
    cameras = read_kitti_cameras(calibration, numbers)
    rig = make_rig(*cameras, rectified=True)
    times_path = sources.times or path / TIMES
    if not times_path.is_file():
        raise InputError(f"{path}: has no {TIMES}; say where it is: --times FILE")
    times = read_times(times_path)
    if len(times) != len(left):
        raise InputError(
            f"{times_path}: holds {len(times):,} times for {len(left):,} left images; the "
            "recording is not complete, or they do not belong together"
        )
    row_of = {file: k for k, file in enumerate(left)}
    stamps = np.array([times[row_of[file]] for file, _ in pairs])
    beside = (path / name for name in POSE_NAMES)
    pose_path = sources.poses or next((file for file in beside if file.is_file()), None)
    if pose_path is None:
        raise InputError(f"{path}: has no poses.txt; say where the poses are: --poses FILE")
    poses = read_pose_file(pose_path)
    trajectory = poses.trajectory
    if poses.numbered:
        trajectory = _timed(trajectory, times, pose_path)
    found = sources.truth or path / "poses_gt.txt"
    truth = read_truth_file(found) if sources.truth is not None or found.is_file() else None
    if truth is not None and truth.numbered:
        truth = replace(truth, trajectory=_timed(truth.trajectory, times, found))
    # The poses are those of camera 0, of which P says how far a camera is to the right.
    projection = cameras[0].projection
    assert projection is not None
    offset = -projection[0, 3] / projection[0, 0]
    return open_pairs(
        path,
        pairs,
        stamps,
        rig,
        Poses(np.array([[offset, 0.0, 0.0]]), Rotation.identity(1)),
        trajectory,
        truth,
        sources,
        params,
        up="-y" if poses.numbered else "z",
        files=[calibration, times_path, pose_path, *([found] if truth is not None else [])],
        notes=notes,
    )


def _timed(poses: Trajectory, times: Float[Array, "n"], path: Path) -> Trajectory:
    """Give KITTI's rows their times [s]."""
    if len(poses.stamps) != len(times):
        raise InputError(f"{path}: holds {len(poses.stamps):,} poses for {len(times):,} times")
    return Trajectory.in_order(times, poses.poses)
