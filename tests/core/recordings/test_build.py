"""Scans become submaps that say where they are, what they hold and how far to believe it."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gpgrad_core.io.folder import load_dataset
from gpgrad_core.recordings.build import build_dataset
from gpgrad_core.recordings.journal import JOURNAL, open_journal
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.recording import RecordingSources
from gpgrad_core.recordings.trajectory import Poses
from gpgrad_core.run import Cancelled
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.recording import simulate_recording
from tests.support.drive import Drive, ground, make_drive, tum, write_drive
from tests.support.refusal import assert_refused

DRIVE = make_drive()
SMALL = make_drive(num_scans=12, points_a_scan=60)
SHORTER = BuildParams(max_length=1.5, min_points=20)
"""Four submaps of three scans."""


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_drive(tmp_path / "drive", DRIVE)


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return write_drive(tmp_path / "drive", SMALL)


def contents(folder: Path) -> dict[str, str]:
    """Hash of every file of a folder, by name."""
    return {
        str(file.relative_to(folder)): hashlib.blake2b(file.read_bytes()).hexdigest()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def test_points_lie_on_the_ground_that_was_driven_over(drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "data"
    (drive / "poses_gt.txt").write_text(tum(DRIVE.stamps, DRIVE.sensor))
    report = build_dataset(drive, out, BuildParams(max_length=3.0, min_points=20))
    dataset = load_dataset(out)
    assert (report.num_submaps, report.num_scans, report.num_resumed) == (4, 24, 0)
    assert dataset.notes == report.notes == ()
    assert "4 submaps of 24 scans of drive, cut after 3 m" in dataset.description
    assert not (tmp_path / "data.partial").exists()
    seen: list[int] = []
    for submap in dataset.submaps:
        world = submap.pose_odometry.apply(submap.points)
        assert np.abs(world[:, 2] - ground(world[:, :2])).max() < 0.02  # bent within a voxel
        np.testing.assert_allclose(submap.pose_odometry.rotation[:, 2], [0, 0, 1], atol=1e-9)
        np.testing.assert_allclose(submap.pose_true.apply(submap.points), world, atol=1e-4)
        assert submap.noise_std is not None
        assert 0.5 < submap.ranges.min() < submap.ranges.max() < 7.0
        rows = np.loadtxt(out / "trajectory" / f"{submap.id}.txt", ndmin=2)
        scans = [int(np.argmin(np.abs(DRIVE.stamps - stamp))) for stamp in rows[:, 0]]
        sensor, driven = submap.pose_odometry.apply(rows[:, 1:4]), DRIVE.sensor.translation
        np.testing.assert_allclose(sensor, driven[scans], atol=1e-5)
        np.testing.assert_allclose(submap.pose_odometry.translation, driven[scans[0]], atol=1e-6)
        seen += scans
    assert seen == list(range(len(DRIVE.scans)))


def test_points_already_in_the_world(small: Path, tmp_path: Path) -> None:
    worlds = [SMALL.sensor.one(k).apply(points) for k, points in enumerate(SMALL.scans)]
    write_drive(tmp_path / "world", Drive(SMALL.stamps, SMALL.body, worlds))
    build_dataset(tmp_path / "world", tmp_path / "a", replace(SHORTER, points_frame="world"))
    build_dataset(small, tmp_path / "b", SHORTER)
    both = load_dataset(tmp_path / "a").submaps, load_dataset(tmp_path / "b").submaps
    for one, other in zip(*both, strict=True):
        np.testing.assert_allclose(one.points, other.points, atol=1e-5)
        np.testing.assert_allclose(one.ranges, other.ranges, atol=1e-5)


@pytest.mark.parametrize("how", ["axis", "cloud"])
def test_a_world_that_is_not_level(how: str, drive: Path, tmp_path: Path) -> None:
    """Poses in a camera's frame, y down, or in one that nobody knows: up is found."""
    turned, params, within = {
        "axis": ([[np.pi / 2, 0.0, 0.0]], BuildParams(up="-y"), 1e-5),
        # What the ground tells is as good as the ground is level on the whole.
        "cloud": ([[0.35, -0.2, 0.0]], BuildParams(gravity="cloud"), np.radians(4.0)),
    }[how]
    world = Poses(np.zeros((1, 3)), Rotation.from_rotvec(turned))
    (drive / "poses.txt").write_text(tum(DRIVE.stamps, world @ DRIVE.sensor))
    report = build_dataset(drive, tmp_path / "data", params)
    if how == "cloud":
        assert "by the ground of 24 scans, is 2" in report.notes[0]
    seen = 0
    for submap in load_dataset(tmp_path / "data").submaps:
        np.testing.assert_allclose(submap.pose_odometry.rotation[:, 2], [0, 0, 1], atol=1e-9)
        for row in np.loadtxt(tmp_path / "data" / "trajectory" / f"{submap.id}.txt", ndmin=2):
            k = int(np.argmin(np.abs(DRIVE.stamps - row[0])))
            up = DRIVE.sensor.one(k).rotation.T[:, 2]  # in the sensor's frame, truly
            found = Rotation.from_quat(row[4:]).inv().apply([0.0, 0.0, 1.0])
            assert np.arccos(np.clip(up @ found, -1, 1)) < within
            seen += 1
    assert seen == len(DRIVE.scans)


def test_what_is_left_out_is_counted(drive: Path, tmp_path: Path) -> None:
    file = drive / f"{DRIVE.stamps[3]:.6f}.npy"
    points = np.load(file)
    points[:7] = np.nan
    points[7:10] = 1e30
    np.save(file, points)
    np.save(drive / f"{DRIVE.stamps[5]:.6f}.npy", np.empty((0, 3)))
    rows = (drive / "poses.txt").read_text().splitlines()
    (drive / "poses.txt").write_text("\n".join(rows[:-2]) + "\n")
    params = BuildParams(max_length=3.0, min_range=1.2, max_range=4.0, min_points=1200)
    report = build_dataset(drive, tmp_path / "data", params)
    told = "\n".join(report.notes)
    assert "2 of 24 scans have no pose within 0.1 s and were left out" in told
    assert "7 of 8,400 points are not finite: left out" in told
    assert "closer than 1.2 m to the sensor: left out" in told
    assert "further than 4 m from the sensor: left out" in told
    assert "1 scan has no usable point" in told
    (left,) = [note for note in report.notes if note.startswith("submap")]
    assert left.startswith("submap 003 of 4 scans was left out")
    dataset = load_dataset(tmp_path / "data")
    assert [submap.id for submap in dataset.submaps] == ["000", "001", "002"]
    assert dataset.notes == ()


def test_what_cannot_be_built_leaves_nothing(small: Path, tmp_path: Path) -> None:
    assert_refused(
        lambda: build_dataset(small, tmp_path / "data", BuildParams(min_points=100_000)),
        "no submap has 100000 points or more: the 12 scans have 720 points together",
    )
    assert not list(tmp_path.glob("data*"))
    file = small / f"{SMALL.stamps[9]:.6f}.npy"
    file.write_bytes(file.read_bytes()[:500])
    assert_refused(lambda: build_dataset(small, tmp_path / "data"), file.name, "not a complete")
    assert not (tmp_path / "data").exists()


def test_a_taken_place_and_missing_times(small: Path, tmp_path: Path) -> None:
    assert_refused(lambda: build_dataset(small, small), "is not empty; name a new")
    for k, file in enumerate(sorted(small.glob("*.npy"))):
        file.rename(small / f"{k:03d}.npy")
    turns, places = SMALL.sensor.rotation.as_matrix(), SMALL.sensor.translation
    np.savetxt(small / "poses.txt", np.dstack([turns, places[:, :, None]]).reshape(-1, 12))
    assert_refused(
        lambda: build_dataset(small, tmp_path / "data", BuildParams(max_time=3.0)),
        "max_time needs the scans' times: --times FILE",
    )


def stop(after: int, recording: Path, out: Path) -> None:
    """Build, and stop once so many scans are done."""
    left = iter(range(after))

    def count(fraction: float) -> None:
        assert 0.0 <= fraction <= 1.0
        if next(left, None) is None:
            raise Cancelled

    with pytest.raises(Cancelled):
        build_dataset(recording, out, SHORTER, progress=count)


def test_stopped_anywhere_it_goes_on_to_the_same(small: Path, tmp_path: Path) -> None:
    build_dataset(small, tmp_path / "whole", SHORTER)
    whole = contents(tmp_path / "whole")
    out = tmp_path / "data"
    for after in (1, 4, 6):
        stop(after, small, out)
        assert not out.exists()
        # What is half done is no dataset to anyone.
        assert_refused(lambda: load_dataset(tmp_path / "data.partial"), "holds no clouds")
    report = build_dataset(small, out, SHORTER)
    assert report.num_resumed == 3
    found = contents(out)
    # The names of the two datasets differ, and what holds them; nothing else.
    assert found.pop("dataset.toml") != whole.pop("dataset.toml")
    assert found == whole


@pytest.mark.parametrize(
    ("damaged", "left", "resumed"),
    [
        (JOURNAL, slice(-25), 2),  # a line cut short
        (JOURNAL, slice(0), 0),
        ("unfinished/001.ply", slice(4), 1),
        ("unfinished/000.ply", None, 0),  # lost
        ("unfinished/003.ply", b"half a cloud more", 3),
    ],
)
def test_what_a_power_cut_may_leave(
    damaged: str, left: slice | bytes | None, resumed: int, small: Path, tmp_path: Path
) -> None:
    build_dataset(small, tmp_path / "a" / "data", SHORTER)
    out, file = tmp_path / "data", tmp_path / "data.partial" / damaged
    stop(10, small, out)
    assert (tmp_path / "data.partial" / JOURNAL).read_text().count("\n") == 4
    if left is None:
        file.unlink()
    else:
        file.write_bytes(left if isinstance(left, bytes) else file.read_bytes()[left])
    assert build_dataset(small, out, SHORTER).num_resumed == resumed
    assert contents(out) == contents(tmp_path / "a" / "data")


def test_killed_while_it_took_its_name(small: Path, tmp_path: Path) -> None:
    build_dataset(small, tmp_path / "data", SHORTER)
    whole = contents(tmp_path / "data")
    (tmp_path / "data").rename(tmp_path / "data.partial")
    assert build_dataset(small, tmp_path / "data", SHORTER).num_resumed == 4
    assert contents(tmp_path / "data") == whole


def test_other_inputs_or_parameters_are_told(small: Path, tmp_path: Path) -> None:
    out = tmp_path / "data"
    stop(4, small, out)
    other = BuildParams(max_length=4.0, min_points=20)
    assert_refused(
        lambda: build_dataset(small, out, other),
        "data.partial: holds an unfinished build with max_length = 1.5, not 4.0",
        "--restart",
    )
    np.save(small / f"{SMALL.stamps[0]:.6f}.npy", SMALL.scans[0][:50])
    identity = "unfinished build with another identity"
    assert_refused(lambda: build_dataset(small, out, SHORTER), identity)
    assert build_dataset(small, out, SHORTER, restart=True).num_resumed == 0

    (tmp_path / "b.partial").mkdir()
    (tmp_path / "b.partial" / "mine.txt").touch()
    assert_refused(lambda: build_dataset(small, tmp_path / "b"), "is in the way")
    assert (tmp_path / "b.partial" / "mine.txt").exists()


def test_two_at_once(tmp_path: Path) -> None:
    pytest.importorskip("fcntl", reason="no locks on this system")
    with open_journal(tmp_path / "data", {"a": 1}):

        def second() -> None:
            with open_journal(tmp_path / "data", {"a": 1}):
                raise AssertionError

        assert_refused(second, "another process is working on it")
    assert json.loads((tmp_path / "data.partial" / JOURNAL).read_text()) == {"a": 1}


def test_a_simulated_recording_shows_its_ground(tmp_path: Path) -> None:
    """Scans laid out by the true poses agree where they overlap; by odometry they drift."""
    params = SimulationParams(
        num_submaps=4, spacing=1.0, extent=16.0, max_range=3.0, field_of_view=0.6, route="winding"
    )
    params = replace(params, noise_quadratic=0.0, rock_density=0.0, crater_density=0.0)
    simulate_recording(tmp_path / "rec", 16, params, points_a_scan=1000)
    true = RecordingSources(poses=tmp_path / "rec" / "poses_gt.txt")
    build_dataset(tmp_path / "rec", tmp_path / "data", BuildParams(max_length=1.0), sources=true)
    submaps = load_dataset(tmp_path / "data").submaps
    worlds = np.vstack([submap.pose_odometry.apply(submap.points) for submap in submaps])
    heights: dict[tuple[int, ...], list[float]] = {}
    for x, y, z in worlds.tolist():
        heights.setdefault((int(x // 0.1), int(y // 0.1)), []).append(z)
    spreads = [np.ptp(z) for z in heights.values() if len(z) > 3]
    assert len(spreads) > 500
    assert np.median(spreads) < 0.06
    odometry = np.loadtxt(tmp_path / "rec" / "poses.txt")
    truth = np.loadtxt(tmp_path / "rec" / "poses_gt.txt")
    off = np.linalg.norm(odometry[:, 1:4] - truth[:, 1:4], axis=1)
    assert off[0] < 0.01
    assert 0.02 < off[-1] < 1.0
    turns = Rotation.from_quat(truth[:, 4:])
    steps = (turns[:-1].inv() * turns[1:]).magnitude()
    assert steps.max() < 0.5  # it turns round bit by bit, as its odometry must see
    assert steps.sum() > 3.0
    assert_refused(lambda: simulate_recording(tmp_path / "rec", 5, params), "is not empty")
    assert_refused(lambda: simulate_recording(tmp_path / "one", 1, params), "2 or more scans")
