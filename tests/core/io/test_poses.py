"""Pose files: what is written comes back, and every bad row is named by its line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gpgrad_core.io.poses import read_poses, read_positions, write_poses
from gpgrad_core.recordings.pose_files import read_pose_file
from gpgrad_core.se2 import Pose
from tests.support.refusal import assert_refused

KNOWN = {0: "000", 1: "001", 7: "007"}
GOOD = "0 1 2 3 0 0 0 1"


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    translation=st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3),
    quaternion=st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(
        lambda q: np.linalg.norm(q) > 0.1
    ),
)
def test_poses_come_back(translation: list[float], quaternion: list[float], tmp_path: Path) -> None:
    pose = Pose(np.array(translation), np.array(quaternion) / np.linalg.norm(quaternion))
    write_poses(tmp_path / "poses.txt", {7: pose})
    back = read_poses(tmp_path / "poses.txt", KNOWN)[7]
    np.testing.assert_allclose(back.translation, pose.translation, rtol=0, atol=1e-6)
    np.testing.assert_allclose(back.rotation, pose.rotation, rtol=0, atol=1e-8)


def test_gaps_comments_whole_floats_and_rounded_quaternions_are_fine(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(f"# a comment\n\n{GOOD}  # the first\n7.0 0 0 0 0 0 0.6004 0.8003\n")
    poses = read_poses(path, KNOWN)
    assert sorted(poses) == [0, 7]
    np.testing.assert_array_equal(poses[0].translation, [1, 2, 3])
    assert np.linalg.norm(poses[7].quaternion) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(
    ("row", "rule"),
    [
        ("5 1 2 3 0 0 0 1", "names submap 5, which the dataset does not have"),
        ("-1 1 2 3 0 0 0 1", "names submap -1, which"),
        (GOOD, "names submap 0 a second time, after line 2"),
        ("1 1 2 3 0 0 0", "has 7 columns, but a pose needs 8"),
        ("1 1 2 3 0 0 0 1 9", "has 9 columns"),
        ("1 1 2 up 0 0 0 1", "not a number"),
        ("1 1 2 nan 0 0 0 1", "not finite"),
        ("1.5 1 2 3 0 0 0 1", "index must be a whole number, got 1.5"),
        ("1 1 2 3 0 0 0 0", "length 1, this one has 0"),
        ("1 1 2 3 1 1 1 1", "length 1, this one has 2"),
        ("001.ply 1 2 3 0 0 0 1", "not a number"),
    ],
)
def test_bad_rows_are_named_by_line(row: str, rule: str, tmp_path: Path) -> None:
    path = tmp_path / "poses_gt.txt"
    path.write_text(f"# index tx ty tz qx qy qz qw\n{GOOD}\n{row}\n")
    assert_refused(lambda: read_poses(path, KNOWN), f"{path}, line 3: ", rule)


@pytest.mark.parametrize(
    "head",
    [
        "timestamp ty tx tz qz qy qx qw",
        "x y z qw qx qy qz id",
        "qw qx qy qz z y x stamp",
        "index p.y p.x p.z orientation.w orientation.x orientation.y orientation.z",
    ],
)
def test_all_columns_are_those_that_are_named(head: str, tmp_path: Path) -> None:
    path, quaternion = tmp_path / "poses.txt", {"x": 0.1, "y": 0.3, "z": 0.5, "w": 0.65**0.5}
    place, row = {"x": 1.0, "y": 2.0, "z": 3.0}, list[float]()
    for name in head.split():
        turns = name.startswith(("q", "orientation"))
        row.append((quaternion if turns else place).get(name[-1], 1.0))
    path.write_text(f"# {head}\n{' '.join(map(str, row))}\n")
    pose = read_poses(path, KNOWN)[1]
    np.testing.assert_array_equal(pose.translation, list(place.values()))
    np.testing.assert_allclose(pose.quaternion, list(quaternion.values()), atol=1e-9)
    path.write_text(f"# {head.replace('y', 'yaw', 1)}\n{' '.join(map(str, row))}\n")
    assert_refused(lambda: read_poses(path, KNOWN), f"{path}, line 1: names the columns, but not")


def test_columns_of_positions_are_those_that_are_named(tmp_path: Path) -> None:
    path = tmp_path / "positions_gt.txt"
    path.write_text("# index y x z\n1 2 1 3\n")
    np.testing.assert_array_equal(read_positions(path, KNOWN)[1], [1, 2, 3])
    path.write_text("# index x y yaw\n1 2 1 3\n")
    assert_refused(lambda: read_positions(path, KNOWN), f"{path}, line 1: names the columns, but")


SAID = "1 1 2 3 0.8 0 0 0.6"


@pytest.mark.parametrize(
    ("head", "turn"),
    [
        ("poses as x y z and quaternion w x y z", [0, 0, 0.6, 0.8]),
        ("index position(x y z) orientation(w x y z)", [0, 0, 0.6, 0.8]),
        ("Hamilton quaternion (w, x, y, z), world from submap", [0, 0, 0.6, 0.8]),
        ("index tx[m] ty[m] tz[m] and then qw qx qy qz", [0, 0, 0.6, 0.8]),
        ("x forward, y left, z up; quaternion x y z w", [0.8, 0, 0, 0.6]),
        ("poses as x y z and then w x y z", "line 1: names the columns, but not each of x y z qx"),
        ("poses as x y z and then w x y z", "as # index tx ty tz qw qx qy qz does, or remove"),
        ("z up, x forward, y left; quaternion x y z w", "line 1: names the columns, but not"),
        ("index tx[mm] ty[mm] tz[mm] qw qx qy qz", "line 1: names columns in mm; give metres"),
        ("index tx ty tz (cm) qw qx qy qz", "line 1: names columns in cm; give metres"),
        ("index tx_km ty_km tz_km qw qx qy qz", "line 1: names columns in km; give metres"),
    ],
)
def test_what_a_sentence_says_of_columns(
    head: str, turn: list[float] | str, tmp_path: Path
) -> None:
    path = tmp_path / "poses_odom.txt"
    path.write_text(f"# {head}\n{SAID}\n")
    if isinstance(turn, str):
        assert_refused(lambda: read_poses(path, KNOWN), turn)
        assert_refused(lambda: read_pose_file(path), turn)
        return
    pose, timed = read_poses(path, KNOWN)[1], read_pose_file(path).trajectory.poses
    np.testing.assert_array_equal([pose.translation, timed.translation[0]], [[1, 2, 3]] * 2)
    np.testing.assert_allclose([pose.quaternion, timed.rotation.as_quat()[0]], [turn] * 2)


@pytest.mark.parametrize("turns", ["flat", "rough", "one", "nearly back"])
def test_turns_that_tip_submaps_over_are_asked_about(turns: str, tmp_path: Path) -> None:
    rng, path = np.random.default_rng(0), tmp_path / "poses_odom.txt"
    yaw = {"one": np.array([0.0]), "nearly back": 180 + np.linspace(1, 9, 5)}.get(
        turns, np.arange(0.0, 360.0, 15.0)
    )
    tilt = rng.normal(0, 5 * (turns == "rough"), (len(yaw), 2))
    turn = Rotation.from_euler("ZYX", np.column_stack([yaw, tilt]), degrees=True)

    def write(head: str, *, scalar_first: bool) -> None:
        rows = np.column_stack([np.arange(len(yaw)), yaw, yaw, 0 * yaw, turn.as_quat()])
        rows[:, 4:] = turn.as_quat(scalar_first=scalar_first)
        np.savetxt(path, rows, fmt="%.6f", header=head)

    rule = "poses_odom.txt: its turns tip the submaps over by ", "# index tx ty tz qw qx qy qz if w"
    known = range(len(yaw))
    write("", scalar_first=True)
    assert_refused(lambda: read_poses(path, known), *rule)
    write("index tx ty tz qw qx qy qz", scalar_first=True)
    for _ in range(2):
        read = Rotation.from_quat([pose.quaternion for pose in read_poses(path, known).values()])
        assert (read * turn.inv()).magnitude().max() < 1e-5
        write("", scalar_first=False)
