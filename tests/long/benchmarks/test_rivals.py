"""The rivals are asked the right question, and all are judged alike.

What needs a rival that is not installed is skipped.
"""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gpgrad_core.io.poses import pose_row
from gpgrad_core.se2 import SE2, Pose
from tests.core.methods.test_easy_closure import look
from tests.long.benchmarks.bench_whole import Line, best_of, describe
from tests.long.benchmarks.whole import judge
from tests.long.benchmarks.whole.kiss import SETUPS, configure


def circle(num: int = 40) -> dict[str, Pose]:
    """A drive around, that rises and tilts."""
    angle = np.linspace(0, 2 * np.pi, num)
    places = 10 * np.column_stack([np.cos(angle), np.sin(angle), 0.1 * np.sin(3 * angle)])
    turns = Rotation.from_euler("ZYX", np.column_stack([angle, 0.1 * np.sin(angle), 0 * angle]))
    return {
        f"{k}.000000": Pose(place, turn.as_quat(canonical=True))
        for k, (place, turn) in enumerate(zip(places, turns, strict=True))
    }


def write(path: Path, poses: dict[str, Pose]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(pose_row(name, pose) for name, pose in poses.items()) + "\n")


def test_the_frame_of_a_trajectory_does_not_matter() -> None:
    true = circle()
    move = Pose(np.array([3.0, -4.0, 5.0]), Rotation.from_euler("xyz", [0.3, 1, 2]).as_quat())
    found = judge.score(true, {name: move @ pose for name, pose in true.items()})
    assert found.fitted < 1e-9
    assert found.from_start < 1e-9
    assert not found.lost
    assert found.share == 1


def test_an_error_is_that_of_the_positions() -> None:
    true = circle()
    shifted = dict(true)
    for name in list(true)[20:]:
        shifted[name] = Pose(
            true[name].translation + np.array([0.0, 0.0, 1.0]), true[name].quaternion
        )
    found = judge.score(true, shifted)
    assert found.from_start == pytest.approx(np.sqrt(0.5))
    assert 0.1 < found.fitted < found.from_start
    still = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    assert judge.score(true, dict.fromkeys(true, still)).lost
    few = {name: true[name] for name in list(true)[:10]}
    assert judge.score(true, few).share == 0.25


def test_a_corrected_submap_moves_its_scans(tmp_path: Path) -> None:
    true = circle()
    names, dataset = list(true), tmp_path / "data"
    starts = [names[0], names[20]]
    for number, start in enumerate(starts):
        inside = names[20 * number : 20 * number + 20]
        local = {name: true[start].inverse() @ true[name] for name in inside}
        write(dataset / "trajectory" / f"{number:03d}.txt", local)
    write(tmp_path / "corrected.txt", {str(k): true[start] for k, start in enumerate(starts)})
    found = judge.poses_of_submaps(dataset, tmp_path / "corrected.txt")
    assert judge.score(true, found).from_start < 1e-5


def test_a_trajectory_is_stood_upright_by_the_first_pose_alone(tmp_path: Path) -> None:
    true = circle()
    first = next(iter(true.values()))
    write(tmp_path / "poses.txt", dict.fromkeys(true, first))  # it says nothing of the rest
    write(tmp_path / "kiss.txt", {name: first.inverse() @ pose for name, pose in true.items()})
    (tmp_path / "times.txt").write_text("\n".join(true) + "\n")
    judge.write_upright(tmp_path, tmp_path / "kiss.txt", tmp_path / "upright.txt")
    found = judge.poses_at_scans(tmp_path, tmp_path / "upright.txt")
    for name, pose in true.items():
        np.testing.assert_allclose(found[name].translation, pose.translation, atol=1e-4)
        np.testing.assert_allclose(found[name].rotation, pose.rotation, atol=1e-5)


def test_rows_say_who_was_lost_and_who_failed() -> None:
    lost = describe(Line("KISS-SLAM", judge.Score(7.0, 9.0, True, 1.0), 3, 20.0))
    assert lost == ["KISS-SLAM", "7.000 m (lost)", "9.000 m", "3", "20 s"]
    assert "failed: no poses" in describe(Line("KISS-SLAM", None, failure="no poses"))
    partly = describe(Line("gpgrad", judge.Score(0.1, 0.2, False, 0.9)))
    assert partly == ["gpgrad", "0.100 m (90% of the scans)", "0.200 m", "-", "-"]


def test_the_best_setup_is_shown_and_those_that_failed_are_named() -> None:
    tried = [
        (Line("KISS-SLAM (defaults)", judge.Score(0.9, 1.0, False, 1.0)), Path("a")),
        (Line("KISS-ICP (coarse)", judge.Score(0.1, 0.1, False, 1.0)), Path("b")),
        (Line("KISS-SLAM (coarse)", judge.Score(0.2, 0.3, False, 1.0)), Path("b")),
        (Line("KISS-SLAM (scaled)", None, failure="over 9 s"), Path("c")),
    ]
    best, folder = best_of(tried, "KISS-SLAM")
    assert best.score == tried[2][0].score
    assert best.system == "KISS-SLAM (coarse); KISS-SLAM (scaled): over 9 s"
    assert folder == Path("b")


@pytest.mark.filterwarnings("ignore")
def test_setups_scale_the_lengths_of_kiss_slam() -> None:
    pytest.importorskip("kiss_slam")
    configs = {name: configure(name, 10.0) for name in SETUPS}
    voxels = {name: config.odometry.mapping.voxel_size for name, config in configs.items()}
    assert voxels == {"defaults": 1.0, "scaled": 0.1, "coarse": 0.2}
    cells = {
        name: config.loop_closer.detector.density_map_resolution for name, config in configs.items()
    }
    assert cells == {"defaults": 0.5, "scaled": 0.05, "coarse": 0.1}
    assert not any(config.odometry.preprocessing.deskew for config in configs.values())


def test_a_motion_is_refined() -> None:
    pytest.importorskip("small_gicp")
    from tests.long.benchmarks.bench_refined import Refiner  # noqa: PLC0415 - it needs the library

    at_query, at_database = SE2(1.1, 0.6, -2.1), SE2(0.5, -0.3, 0.4)
    query, database = look(at_query, "q", seed=2), look(at_database, "d", seed=1)
    true = at_database.inverse() @ at_query
    refined = Refiner.of([query, database]).refine("q", "d", true @ SE2(0.15, -0.1, 0.05))
    left = true.inverse() @ refined
    assert np.hypot(left.x, left.y) < 0.03
    assert abs(left.yaw) < 0.01


def test_only_true_pairs_with_the_right_motion_are_hits() -> None:
    pytest.importorskip("small_gicp")
    from tests.long.benchmarks.bench_refined import precision_of_motions  # noqa: PLC0415

    score = np.array([4.0, 3.0, 2.0, 1.0])
    positive = np.array([True, True, False, True])
    right = np.array([True, False, True, True])
    # Hits are the first and the last of four; one true pair is missed for good.
    assert precision_of_motions(score, positive, right) == pytest.approx((1 + 2 / 4) / 3)
    assert precision_of_motions(score, positive, np.zeros(4, bool)) == 0.0
