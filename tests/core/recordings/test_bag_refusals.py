"""Bags of contradictory frames, covariances and fields: what is used, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpgrad_core.recordings.build import open_recording
from gpgrad_core.recordings.level import level_recording
from gpgrad_core.recordings.params import BuildParams
from tests.support.bags import BagWriter
from tests.support.drive import MOUNT, assert_same_poses, make_drive
from tests.support.recordings import opened, refused

FEW = make_drive(num_scans=6, points_a_scan=50)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, 1.7e308])
def test_a_covariance_that_is_none_is_unknown(value: float, tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    with BagWriter(path, ros1=True) as bag:
        for k, stamp in enumerate(FEW.stamps):
            bag.odometry("/odom", stamp, FEW.body, k, value if k < 2 else 0.01 * k)
            bag.cloud("/points", stamp, "base_link", FEW.scans[k])
    recording = open_recording(path)
    assert any("2 of 6 poses have a covariance" in note for note in recording.notes)
    assert recording.covariance is not None
    assert np.isnan(recording.covariance).all(axis=(1, 2)).tolist() == [True] * 2 + [False] * 4
    # It has grown by 0.1² m² at every scan, as far as it is known: from the third scan on.
    grown = BuildParams(max_length=None, max_uncertainty=0.17)
    assert recording.pieces(grown) == [range(5), range(5, 6)]
    assert recording.pieces(BuildParams(max_length=1000.0)) == [range(6)]


def one_cloud(path: Path, **changed: Any) -> Path:
    """A bag of one cloud, of 50 points of 24 bytes, and its pose."""
    path.unlink(missing_ok=True)
    with BagWriter(path, ros1=True) as bag:
        bag.odometry("/odom", FEW.stamps[0], FEW.body, 0)
        fields = changed.pop("fields", None)
        if fields:
            make = bag.type("sensor_msgs/msg/PointField")
            changed["fields"] = [make(*values, count=1) for values in fields]
        bag.cloud("/points", FEW.stamps[0], "base_link", FEW.scans[0], **changed)
    return path


def test_fields_that_do_not_say_where_points_are(tmp_path: Path) -> None:
    path, reals = tmp_path / "a.bag", [("x", 0, 7), ("y", 4, 7), ("z", 12, 7)]
    for number in range(1, 7):  # INT8 to UINT32
        fields = [("x", 0, number), ("y", 4, number), ("z", 12, number)]
        refused(
            one_cloud(path, fields=fields), "message 0: its x, y, z are whole numbers", "FLOAT32"
        )
    refused(one_cloud(path, fields=[*reals[:2], ("z", 12, 5)]), "its z are whole numbers")
    refused(one_cloud(path, fields=[*reals, ("x", 8, 7)]), "message 0", "two fields x")
    refused(one_cloud(path, fields=[*reals[:2], ("z", 22, 7)]), "end at byte 26 of a point")
    one_cloud(path, fields=[*reals, ("ring", 8, 2), ("ring", 9, 2)])
    assert len(next(open_recording(path).read(0, 1)).points) == 50


def test_rows_of_a_cloud_are_where_their_size_says(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    for step in (0, 24 * 25, 24 * 50, 99_999):  # rows without padding, whatever row_step says
        one_cloud(path, height=2, width=25, row_step=step)
        (scan,) = open_recording(path).read(0, 1)
        np.testing.assert_allclose(scan.points, FEW.scans[0], atol=1e-5)
    one_cloud(path, height=2, width=20, row_step=24 * 25)  # 5 points of padding
    (scan,) = open_recording(path).read(0, 1)
    kept = [*range(20), *range(25, 45)]
    np.testing.assert_allclose(scan.points, FEW.scans[0][kept], atol=1e-5)
    one_cloud(path, height=2, width=20, row_step=24 * 50)
    refused(path, "2 rows that begin 1,200 bytes apart (row_step)", "holds 1,200 bytes")


@pytest.mark.parametrize("changes", ["clouds", "poses", "body"])
def test_a_frame_that_changes(changes: str, tmp_path: Path) -> None:
    path, late = tmp_path / "a.bag", FEW.stamps[3]
    with BagWriter(path, ros1=True) as bag:
        bag.transform(FEW.stamps[0], "base_link", "lidar", MOUNT, 0, topic="/tf_static")
        bag.transform(FEW.stamps[0], "lidar", "other", MOUNT, 0, topic="/tf_static")
        for k, stamp in enumerate(FEW.stamps):
            slash = "/" * (k % 2)  # that makes no difference
            names = {"poses": "odom", "body": "base_link", "clouds": "lidar"}
            if stamp >= late:
                names[changes] = "other"
            frames = f"{slash}{names['poses']}", f"{slash}{names['body']}"
            bag.odometry("/odom", stamp, FEW.body, k, frames=frames)
            bag.cloud("/points", stamp, f"{slash}{names['clouds']}", FEW.scans[k])
    refused(path, f"at {late:.3f} s: the frame of ", "changes from ", " to 'other'")


def test_two_parents_matter_only_on_the_way_that_is_needed(tmp_path: Path) -> None:
    path, mount = tmp_path / "a.bag", tmp_path / "mount.txt"
    mount.write_text("0 0 0 0 0 0 1\n")
    for clouds, above in (("base_link", "base_link"), ("lidar", "odom"), ("lidar", "lidar")):
        path.unlink(missing_ok=True)
        with BagWriter(path, ros1=True) as bag:
            bag.transform(FEW.stamps[0], "base_link", "lidar", MOUNT, 0, topic="/tf_static")
            for k, stamp in enumerate(FEW.stamps):
                bag.transform(stamp, "map" if k % 2 else "world", above, FEW.body, k)
                bag.odometry("/odom", stamp, FEW.body, k)
                bag.cloud("/points", stamp, clouds, FEW.scans[k])
        if above == "lidar":
            refused(path, "the frame 'lidar'", "'base_link' and 'world'", "--mount FILE")
            assert len(opened(path, mount=mount)) == 6
        else:
            driven = FEW.sensor if clouds == "lidar" else FEW.body
            assert_same_poses(open_recording(path).sensor(3), driven[3:4])
    refused(path, "the frame 'lidar'", "two parents", pose_topic="/tf")


@pytest.mark.parametrize("poses", ["odometry", "tf"])
def test_a_transform_that_is_missing_in_time_is_named(poses: str, tmp_path: Path) -> None:
    path, sent = tmp_path / "a.bag", FEW.stamps[0] - 100
    with BagWriter(path, ros1=True) as bag:
        bag.transform(sent, "base_link", "lidar", MOUNT, 0)  # latched, but not on /tf_static
        for k, stamp in enumerate(FEW.stamps):
            if poses == "tf":
                bag.transform(stamp, "odom", "base_link", FEW.body, k)
            else:
                bag.odometry("/odom", stamp, FEW.body, k)
            bag.cloud("/points", stamp, "lidar", FEW.scans[k])
    refused(path, "the transform base_link > lidar", f"from {sent:.3f}", "/tf_static")


@pytest.mark.parametrize("kind", ["above", "drifts", "tf", "on the robot", "apart"])
def test_points_in_another_frame_of_the_world(kind: str, tmp_path: Path) -> None:
    """Mapping gives its clouds in map, and odometry is in odom; what joins them is used."""
    path, drives = tmp_path / "a.bag", kind in ("tf", "on the robot")
    frames = {"tf": "odom", "on the robot": "lidar"}.get(kind, "map")
    with BagWriter(path, ros1=True) as bag:
        bag.transform(FEW.stamps[0], "base_link", "lidar", MOUNT, 0, topic="/tf_static")
        for k, stamp in enumerate(FEW.stamps):
            if kind != "apart":
                topic = "/tf" if kind in ("drifts", "tf") else "/tf_static"
                bag.transform(stamp, "map", "odom", MOUNT, 0, topic=topic)
            if drives:
                bag.transform(stamp, "odom", "base_link", FEW.body, k)
            if kind != "tf":
                bag.odometry("/odom", stamp, FEW.body, k)
            world = FEW.sensor[k : k + 1].apply(FEW.scans[k])
            given = MOUNT.apply(world) if kind in ("above", "drifts") else world
            bag.cloud("/points", stamp, frames, given)
    if not drives:
        refused(path, "no transforms join", "--points-frame world")
    params = BuildParams(points_frame="world")
    recording = open_recording(path, params=params)
    assert any("are moved from 'map' to 'odom'" in note for note in recording.notes) == (
        kind in ("above", "drifts")
    )
    level, _ = level_recording(recording, params)
    for k, scan in enumerate(level.read(0, len(level))):
        world = FEW.sensor[k : k + 1].apply(FEW.scans[k])
        np.testing.assert_allclose(level.sensor(k).apply(scan.points), world, atol=1e-4)
    assert_same_poses(level.body, FEW.body)


def test_scans_recorded_out_of_order_are_taken_by_their_times(tmp_path: Path) -> None:
    read: list[list[np.ndarray]] = []
    for name, swapped in (("in_order", 0.0), ("swapped", 1.5 * float(np.diff(FEW.stamps)[0]))):
        with BagWriter(tmp_path / f"{name}.bag", ros1=True) as bag:
            for k, stamp in enumerate(FEW.stamps):
                bag.odometry("/odom", stamp, FEW.body, k)
                late = 0.02 + swapped * (k % 2 == 0)
                bag.cloud("/points", stamp, "base_link", FEW.scans[k], late=late)
        recording = open_recording(tmp_path / f"{name}.bag")
        assert recording.stamps is not None
        assert np.array_equal(recording.stamps, np.sort(recording.stamps))
        assert any("out of the order of their times" in n for n in recording.notes) == bool(swapped)
        read.append([scan.points for scan in recording.read(0, len(recording.stamps))])
    for ours, theirs in zip(*read, strict=True):
        assert np.array_equal(ours, theirs)
