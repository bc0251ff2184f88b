# ruff: noqa: T201 - tells where its pictures are
"""A walk through every reader: files of its form are built, searched and looked at.

One simulated drive, there and back, is written by independent writers in each form; the forms that
a drive cannot be put into (images of a LiDAR on a flat beach, and images of a rover's cameras) get
the files of their tests. It prints a line for each reader and the folder of the pictures.
"""

import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.viewer.viewer import Viewer
from gpgrad_core import load_dataset, read_closures
from gpgrad_core.detection import PipelineParams
from gpgrad_core.params import preferred_parameters
from gpgrad_core.recordings.build import open_recording
from gpgrad_core.recordings.trajectory import Poses
from tests.browser.chromium import ViewerPage, find_chromium, launch
from tests.core.io.test_posed_scans import write_scans
from tests.core.recordings.test_katwijk import beach, named, write_image
from tests.core.recordings.test_pds import write_product
from tests.support.bags import BagWriter, write_bag
from tests.support.drive import MOUNT, Drive, as_kitti, tum, write_drive

pytestmark = pytest.mark.browser
SIMULATED = ("--scans", "60", "--sensor", "lidar", "--num-submaps", "6", "--spacing", "2",
             "--extent", "30")  # fmt: skip
LONG = ("--max-length", "3", "--max-range", "9")


@dataclass(frozen=True)
class Written:
    """Files of a form.

    Attributes:
        path: Of the recording.
        flags: Of ``gpgrad build``; None opens it as it is.
        closes: Whether the drive comes back, so that there are loop closures.
    """

    path: Path
    flags: tuple[str, ...] | None = LONG
    closes: bool = True


def run(*words: str | Path) -> str:
    """Run gpgrad; it must succeed."""
    command = [sys.executable, "-m", "app", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """Simulate a drive there and back."""
    folder = tmp_path_factory.mktemp("drive") / "recording"
    run("simulate", folder, *SIMULATED)
    recording = open_recording(folder)
    count = len(recording)
    scans = list(recording.read(0, count))
    sensor = [recording.sensor(k) for k in range(count)]
    poses = Poses(
        np.concatenate([pose.translation for pose in sensor]),
        Rotation.concatenate([pose.rotation for pose in sensor]),
    )
    stamps = 1_700_000_000.0 + 0.5 * np.arange(count)
    return Drive(stamps, poses @ MOUNT.inverse(), scans)


def _folder(root: Path, drive: Drive) -> Written:
    return Written(write_drive(root / "drive", drive))


def _kitti(root: Path, drive: Drive) -> Written:
    (root / "00" / "velodyne").mkdir(parents=True)
    for k, points in enumerate(drive.scans):
        as_kitti(root / "00" / "velodyne" / f"{k:06d}.bin", points)
    matrices = np.concatenate(
        [drive.sensor.rotation.as_matrix(), drive.sensor.translation[:, :, None]], axis=2
    )
    np.savetxt(root / "00" / "poses.txt", matrices.reshape(-1, 12))
    return Written(root / "00")


def _mcap(root: Path, drive: Drive) -> Written:
    return Written(write_bag(root / "bag", drive, ros1=False, poses="odometry", storage="mcap"))


def _s3li(root: Path, drive: Drive) -> Written:
    with BagWriter(root / "s3li_loops.bag", ros1=True) as bag:
        for stamp, points in zip(drive.stamps, drive.scans, strict=True):
            bag.cloud("/bf_lidar/points_raw", stamp, "bf_lidar", points)
    (root / "slam.txt").write_text(tum(drive.stamps, drive.sensor))
    poses = "--poses", str(root / "slam.txt"), "--cloud-topic", "/bf_lidar/points_raw"
    return Written(root / "s3li_loops.bag", (*LONG, *poses))


def _cpet(root: Path, drive: Drive) -> Written:
    few = slice(None, None, 4)
    every = Drive(drive.stamps[few], drive.body[few], drive.scans[few])
    return Written(write_scans(root / "p2at_met", every), flags=None)


def _katwijk(root: Path, drive: Drive) -> Written:
    del drive
    (root / "Part1" / "Velodyne").mkdir(parents=True)
    for k in range(12):
        for kind, values in zip(("range", "azimuth", "intensity"), beach(), strict=True):
            name = f"Velodyne_{named(0.5 * k)}_{kind}.png"
            write_image(root / "Part1" / "Velodyne" / name, values)
    rows = [
        f"{named(0.1 * k)} 4 {52.2 + 3e-7 * k:.9f} {4.4 + 5e-7 * k:.9f} 5.000 0.01 0.01 0.02"
        for k in range(-5, 70)
    ]
    (root / "Part1" / "gps-latlong.txt").write_text("\n".join(rows) + "\n")
    return Written(root / "Part1", ("--min-range", "1.5", "--max-range", "30"), closes=False)


def _rover(root: Path, drive: Drive) -> Written:
    del drive
    (root / "sol").mkdir()
    for k in range(3):
        write_product(root / "sol", k, "ROVER_NAV_FRAME")
    return Written(root / "sol", ("--max-length", "1"), closes=False)


WRITERS: dict[str, Callable[[Path, Drive], Written]] = {
    "folder": _folder,
    "kitti": _kitti,
    "mcap": _mcap,
    "s3li": _s3li,
    "cpet": _cpet,
    "katwijk": _katwijk,
    "rover": _rover,
}
PICTURES = Path(tempfile.mkdtemp(prefix="walk-readers-"))


@pytest.mark.parametrize("name", WRITERS)
def test_a_recording_is_built_searched_and_seen(name: str, drive: Drive, tmp_path: Path) -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    written = WRITERS[name](tmp_path, drive)
    dataset = written.path
    if written.flags is not None:
        dataset = tmp_path / "dataset"
        run("build", written.path, "--out", dataset, *written.flags)
    run("detect", dataset, "--out", tmp_path / "closures.json")
    pairs = read_closures(tmp_path / "closures.json").pairs
    accepted = sum(pair.accepted for pair in pairs)
    assert accepted > 0 or not written.closes
    loaded = load_dataset(dataset)
    viewer = Viewer(
        loaded, preferred_parameters(loaded, PipelineParams()), port=0, source=str(dataset)
    )
    try:
        with launch(executable) as browser:
            page = ViewerPage(browser, viewer.url, size=(1280, 900))
            page.settle()
            page.page.screenshot(path=str(PICTURES / f"{name}.png"))
            print(
                f"\n{name}: {len(loaded.submaps)} submaps, {accepted} of {len(pairs)} pairs "
                f"accepted, shown: {page.page.title()}; picture in {PICTURES}"
            )
            assert page.errors == []
    finally:
        viewer.close()
