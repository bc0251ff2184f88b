"""Recordings of four shapes of one drive, rendered: built, detected, and looked at."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.viewer.viewer import Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.io.records.closures import read_closures
from gpgrad_core.run.store import Store
from tests.end_to_end.process import gpgrad
from tests.support.image_folders import write_madmax
from tests.support.sensor_bags import write_baseprod, write_livox, write_realsense
from tests.support.stereo import Filmed, rendered_drive

pytestmark = [pytest.mark.browser, pytest.mark.nightly]

APART = 3
"""Submaps that came so many apart are a revisit."""


@pytest.fixture(scope="module")
def filmed() -> Filmed:
    return rendered_drive()


def _madmax(folder: Path, filmed: Filmed) -> list[Path | str]:
    return [write_madmax(folder / "run", filmed)]


def _baseprod(folder: Path, filmed: Filmed) -> list[Path | str]:
    bag = write_baseprod(folder / "log", filmed)
    named = {"poses": "poses.txt", "mount": "mount.txt", "calibration": "depth.yaml"}
    return [bag, *(part for flag, name in named.items() for part in (f"--{flag}", folder / name))]


def _realsense(folder: Path, filmed: Filmed) -> list[Path | str]:
    return [write_realsense(folder / "realsense", filmed)]


def _livox(folder: Path, filmed: Filmed) -> list[Path | str]:
    clouds = [filmed.cloud(k, 5_000) for k in range(len(filmed.body))]
    sensor = filmed.body @ filmed.mount
    return [write_livox(folder / "livox.bag", clouds, sensor, "livox_ros_driver")]


@pytest.mark.parametrize("write", [_realsense, _madmax, _baseprod, _livox])
def test_a_revisit_is_found_and_shown(
    write: Callable[[Path, Filmed], list[Path | str]], filmed: Filmed, browser: Any, tmp_path: Path
) -> None:
    from tests.browser.chromium import ViewerPage  # noqa: PLC0415

    data, found = tmp_path / "data", tmp_path / "closures.json"
    given = write(tmp_path, filmed)
    built = gpgrad("build", *given, "--out", data, "--max-length", "5.5", "--max-range", "6")
    assert built.code == 0, built.err
    detected = gpgrad("detect", data, "--out", found)
    assert detected.code == 0, detected.err

    dataset = load_dataset(data)
    driven = {s.id: s.pose_odometry.planar for s in dataset.submaps if s.pose_odometry is not None}
    assert len(driven) == len(dataset.submaps) >= APART + 1
    accepted = read_closures(found).accepted
    for pair in accepted:
        motion = pair.registration.T_database_query
        assert motion is not None
        off = (driven[pair.database_id].inverse() @ driven[pair.query_id]).inverse() @ motion
        assert np.hypot(off.x, off.y) < 0.3, pair
        assert abs(off.yaw) < 0.05, pair
    again = [pair for pair in accepted if int(pair.query_id) - int(pair.database_id) >= APART]
    assert again

    best = max(again, key=lambda pair: pair.registration.score)
    viewer = Viewer(dataset, PipelineParams(), port=0, source=str(data), store=Store())
    with contextlib.closing(viewer), contextlib.closing(ViewerPage(browser, viewer.url)) as page:
        page.choose_submap("query", best.query_id)
        page.choose_submap("database", best.database_id)
        page.wait(lambda: page.pair() == best.pair, "the pair")
        page.settle()
        assert page.accepted()
        assert not page.is_blank()
        assert page.errors == []
