"""A pipe or a device in place of any input is refused in one line; nothing is waited for."""

import contextlib
import os
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import tifffile

from tests.core.recordings.test_pds import write_product
from tests.end_to_end.process import QUICK_MAP, gpgrad
from tests.support.image_folders import write_image, write_madmax

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes")

IN_DATASET = (
    "dataset.toml",
    "poses_odom.txt",
    "poses_gt.txt",
    "images/000/0.png",
    "submaps/000.xyz",
)
AS_OPTION = {
    "p.toml": ("detect", "{data}", "--params", "{file}", "--out", "{dir}/out.json"),
    "c.json": ("slam", "{data}", "--closures", "{file}", "--out", "{out}"),
    "s.json": ("view", "{data}", "--state", "{file}", "--no-open"),
    "track.txt": ("view", "--follow", "{data}", "--track", "{file}", "--no-open"),
    "d.gpgrad": ("view", "{file}", "--no-open"),
    "r.gpgrad": ("view", "--follow", "{data}", "--record", "{file}", "--no-open"),
    "m.tif": ("locate", "{data}", "--map", "{file}", "--out", "{dir}/l.json"),
    "t.tif": ("simulate", "{out}", "--terrain", "{file}"),
    "b.mcap": ("build", "{file}", "--out", "{out}"),
    "f.mcap": ("view", "--follow", "{file}", "--no-open"),
    "a.g2o": ("build", "{data}/submaps", "--poses", "{file}", "--out", "{out}"),
    **{
        f"cloud{ending}": ("map", "{file}", "--out", "{dir}/m.npz", *QUICK_MAP)
        for ending in (".ply", ".pcd", ".npy", ".npz", ".xyz", ".las", ".bin")
    },
}


PATIENCE = 60.0
"""Seconds after which a pipe ends, so that a test of who reads it fails instead of waiting."""


@contextlib.contextmanager
def pipe(path: Path) -> Iterator[Path]:
    """Put a pipe at a place, where nobody writes."""
    os.mkfifo(path)

    def end() -> None:
        with contextlib.suppress(OSError):  # nobody reads
            os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK))

    watch = threading.Timer(PATIENCE, end)
    watch.start()
    try:
        yield path
    finally:
        watch.cancel()


def refusal_of(file: Path, *arguments: str | Path) -> str:
    """Put a pipe at a place, and give the line that a command refuses it with."""
    with pipe(file):
        line = gpgrad(*arguments).refusal
    assert "is not a regular file" in line
    return line


@pytest.mark.parametrize("name", IN_DATASET)
def test_in_a_dataset(traverse: Path, tmp_path: Path, name: str) -> None:
    data = shutil.copytree(traverse, tmp_path / "data")
    method = ()
    if name.startswith("images"):
        for k in range(4):
            (data / f"images/00{k}").mkdir(parents=True)
            write_image(data / f"images/00{k}/0.png", np.zeros((8, 8), np.uint8))
        method = ("--method", "appearance")
    (data / name).unlink(missing_ok=True)
    assert name in refusal_of(data / name, "detect", data, *method, "--out", tmp_path / "c.json")


@pytest.mark.parametrize("name", AS_OPTION)
def test_of_an_option(traverse: Path, tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    places = {"dir": tmp_path, "data": traverse, "file": file, "out": tmp_path / "out"}
    assert name in refusal_of(file, *(word.format(**places) for word in AS_OPTION[name]))


@pytest.mark.parametrize(
    "name",
    ["metadata.yaml", "tf__imu_to_B.csv", "camera_rect_left_info.txt", "gt_6DoF_gnss_and_imu.csv"],
)
def test_in_a_recording(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "recording"
    folder.mkdir()
    if name == "metadata.yaml":
        pytest.importorskip("rosbags", reason="the extra 'ros' is not installed")
        place = folder / name
    else:
        place = next(write_madmax(folder).rglob(name))
        place.unlink()
    assert name in refusal_of(place, "build", folder, "--out", tmp_path / "out")


@pytest.mark.parametrize("name", ["dem.tif.msk", "DEM.TIF.AUX.XML", "dem.aux"])
def test_beside_an_elevation_model(tmp_path: Path, name: str) -> None:
    tifffile.imwrite(tmp_path / "dem.tif", np.zeros((9, 9), np.float32))
    model = ("--terrain", tmp_path / "dem.tif")
    assert name in refusal_of(tmp_path / name, "simulate", tmp_path / "out", *model)


def test_the_image_of_a_product(tmp_path: Path) -> None:
    pytest.importorskip("pdr", reason="the extra 'pds' is not installed")
    image = write_product(tmp_path, 0, "SITE_FRAME").with_suffix(".IMG")
    image.unlink()
    assert image.name in refusal_of(image, "build", tmp_path, "--out", tmp_path / "out")


def test_a_device(traverse: Path, tmp_path: Path) -> None:
    refused = gpgrad("detect", traverse, "--params", os.devnull, "--out", tmp_path / "c.json")
    assert f"{os.devnull}: is not a regular file" in refused.refusal
