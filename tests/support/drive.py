"""A short drive over known ground, and how outside tools would have recorded it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gpgrad_core.recordings.trajectory import Poses

START = 1_700_000_000.0
PERIOD = 0.5
NUM_SCANS = 24
MOUNT = Poses(np.array([[0.3, 0.0, 0.9]]), Rotation.from_euler("ZYX", [[0.1, 0.4, 0.0]]))
"""Where the sensor sits on the body: it looks ahead and down."""


def ground(xy: np.ndarray) -> np.ndarray:
    """Height [m]."""
    return 0.3 * np.sin(0.9 * xy[:, 0]) + 0.2 * np.cos(1.1 * xy[:, 1] + 0.3 * xy[:, 0])


def assert_same_poses(poses: Poses, driven: Poses, off: float = 1e-6) -> None:
    """Compare poses, within some metres and as many radians."""
    np.testing.assert_allclose(poses.translation, driven.translation, rtol=0, atol=off)
    assert (poses.rotation * driven.rotation.inv()).magnitude().max() < off


@dataclass(frozen=True, eq=False)
class Drive:
    """Scans and where they were taken."""

    stamps: np.ndarray
    body: Poses
    scans: list[np.ndarray]  # in the sensor's frame

    @property
    def sensor(self) -> Poses:
        return self.body @ MOUNT


def make_drive(num_scans: int = NUM_SCANS, points_a_scan: int = 400) -> Drive:
    """Drive along a bend, tilted as if by the ground, half a metre from scan to scan."""
    rng = np.random.default_rng(4)
    along = 0.5 * np.arange(num_scans)
    yaw = 0.06 * along
    xy = np.column_stack([along, 0.03 * along**2])
    tilt = rng.normal(0, 0.05, (num_scans, 2))
    turn = Rotation.from_euler("ZYX", np.column_stack([yaw, tilt]))
    body = Poses(np.column_stack([xy, ground(xy)]), turn)
    scans: list[np.ndarray] = []
    for k in range(num_scans):
        seen = xy[k] + rng.uniform(-4, 4, (points_a_scan, 2))
        world = np.column_stack([seen, ground(seen)])
        back = (body[k : k + 1] @ MOUNT).inverse()
        scans.append(back.rotation.apply(world) + back.translation)
    return Drive(START + PERIOD * np.arange(num_scans), body, scans)


def tum(stamps: np.ndarray, poses: Poses) -> str:
    """Spell poses as TUM rows."""
    rows = np.column_stack([stamps, poses.translation, poses.rotation.as_quat()])
    return "\n".join(" ".join(f"{value:.9f}" for value in row) for row in rows) + "\n"


def as_kitti(path: Path, points: np.ndarray, fourth: np.ndarray | float = 0.5) -> None:
    """Write a cloud as KITTI does: x, y, z and a fourth number, in single precision."""
    column = np.broadcast_to(fourth, len(points))
    np.column_stack([points, column]).astype("<f4").tofile(path)


def write_drive(
    folder: Path,
    drive: Drive,
    ending: str = ".npy",
    write: Callable[[Path, np.ndarray], None] = np.save,
) -> Path:
    """Write a drive as a folder of clouds named by time, with poses of the sensor."""
    folder.mkdir(parents=True, exist_ok=True)
    for stamp, points in zip(drive.stamps, drive.scans, strict=True):
        write(folder / f"{stamp:.6f}{ending}", points)
    (folder / "poses.txt").write_text(tum(drive.stamps, drive.sensor))
    return folder
