"""`gpgrad slam`, as a process."""

import json
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.io.records.closures import read_closures
from gpgrad_core.slam import read_run
from tests.core.pages.walk import read_page
from tests.end_to_end.process import gpgrad


@pytest.mark.slow
def test_a_traverse_is_corrected_and_merged(traverse: Path, tmp_path: Path) -> None:
    out = tmp_path / "map"
    finished = gpgrad("slam", traverse, "--out", out, "--merged.resolution", "0.1")
    assert finished.code == 0, finished.err
    assert "4 submaps, 1 loop closure used, 0 refused as wrong" in finished.out
    (closure,) = read_closures(out / "closures.json").accepted
    assert (closure.query, closure.database) == ("003", "000")
    assert closure.covariance is not None
    poses = np.loadtxt(out / "poses_corrected.txt")
    assert poses[:, 0].tolist() == [0, 1, 2, 3]
    # The closure says what odometry, which is right here, says too.
    np.testing.assert_allclose(poses[3, 1:3], [0.5, 0.4], atol=0.1)
    report = json.loads((out / "report.json").read_text())
    assert report["trajectory_error"] == {}  # there is no truth
    assert (out / "cloud.ply").stat().st_size > 10_000
    assert {path.suffix for path in out.iterdir()} >= {".png", ".tif", ".npz", ".g2o", ".txt"}
    page = read_page((out / "page.html").read_text(encoding="utf-8"))
    assert len(page.content["submaps"]) == 4
    assert page.content["poses"]["after"] is not None
    assert [(k[0], k[1]) for k in page.content["lines"]] == [(3, 0)]


@pytest.mark.slow
def test_closures_found_before_are_taken_and_no_map_is_made(traverse: Path, tmp_path: Path) -> None:
    closures = write_by_hand(tmp_path / "mine.json", accepted=True)
    out = tmp_path / "map"
    finished = gpgrad("slam", traverse, "--out", out, "--closures", closures, "--no-merge")
    assert "1 loop closure used" in finished.out
    assert not (out / "cloud.ply").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("accepted", "decided", "x", "said"),
    [
        (True, False, 0.5, "0 loop closures used, 0 refused as wrong"),
        (False, True, 0.5, "1 loop closure used, 0 refused as wrong"),
        # Odometry contradicts these: the solver refuses one, unless a person vouches for it.
        (True, None, 3.5, "0 loop closures used, 1 refused as wrong"),
        (True, True, 3.5, "1 loop closure used, 0 refused as wrong"),
    ],
)
def test_what_a_person_decided_is_heeded(
    accepted: bool, decided: bool | None, x: float, said: str, traverse: Path, tmp_path: Path
) -> None:
    decision = {"accepted": decided, "note": "seen from above"}
    closures = write_by_hand(tmp_path / "mine.json", accepted=accepted, x=x, decision=decision)
    flags = ("--closures", closures, "--no-merge")
    assert said in gpgrad("slam", traverse, "--out", tmp_path / "map", *flags).out


def write_by_hand(
    path: Path, *, accepted: bool, x: float = 0.5, decision: dict[str, object] | None = None
) -> Path:
    """Write one closure of the traverse, as another tool might."""
    record: dict[str, object] = {
        "query": "003",
        "database": "000",
        "num_inliers": 20,
        "score": 5.0,
        "dissimilarity": 1.0,
        "overlap_area": 20.0,
        "accepted": accepted,
        "reason": "by hand",
        "T_database_query": {"x": x, "y": 0.4, "yaw": 3.0},
    }
    if decision is not None:
        record["decision"] = decision
    content = {
        "dataset": "x",
        "method": "mine",
        "seed": 0,
        "params": {},
        "versions": {},
        "seconds": {},
        "submaps": [],
        "pairs": [record],
    }
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--closures", "none.json"), "none.json"),
        (("--search-radius", "-1"), "--search-radius must be above 0 m"),
        (("--search-radius", "far"), "--search-radius: the value must be a number, got 'far'"),
        (("--graph.odometry-drift", "7"), "--graph.odometry-drift: the value must be from 0 to 1"),
        (("--merged.voxel", "0"), "--merged.voxel: the value must be from 0.001"),
    ],
)
def test_wrong_usage_is_one_line(
    traverse: Path, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    assert said in gpgrad("slam", traverse, "--out", tmp_path / "map", *arguments).refusal
    assert not (tmp_path / "map").exists()


def test_without_odometry_it_says_so_at_once(traverse: Path, tmp_path: Path) -> None:
    line = gpgrad("slam", traverse / "submaps", "--out", tmp_path / "map").refusal
    assert "a pose graph needs odometry, and submap 000 has none" in line


@pytest.mark.slow
def test_a_recorded_drive_ends_as_it_would_without_the_record(
    traverse: Path, tmp_path: Path
) -> None:
    plain, recorded, record = tmp_path / "plain", tmp_path / "recorded", tmp_path / "run.gpgrad"
    flags = ("--no-merge", "--cache", "none")
    assert gpgrad("slam", traverse, "--out", plain, *flags).code == 0
    command = ("slam", traverse, "--out", recorded, "--record", record, *flags)
    assert gpgrad(*command).code == 0
    for name in ("poses_corrected.txt", "graph.g2o"):
        assert (plain / name).read_bytes() == (recorded / name).read_bytes()
    first, second = (read_closures(folder / "closures.json") for folder in (plain, recorded))
    assert first.pairs == second.pairs
    assert first.params == second.params
    run = read_run(record)
    assert not run.notes
    accepted = {(c.query_id, c.database_id) for m in run.moments for c in m.accepted}
    assert accepted == {(pair.query, pair.database) for pair in first.accepted}
    written = np.loadtxt(recorded / "poses_corrected.txt")[:, 1:]
    np.testing.assert_allclose(run.moments[-1].places, written, atol=1e-6)
    assert (
        "run.gpgrad: exists already"
        in gpgrad(*command[:2], "--out", tmp_path / "new", *command[4:]).refusal
    )


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--record", "run.txt"), "run.txt: the ending must be one of .gpgrad"),
        (("--record", "r.gpgrad", "--closures", "c.json"), "--record does not go with --closures"),
        (("--record", "r.gpgrad", "--scheduler", "tcp://x:1"), "does not go with --record"),
    ],
)
def test_a_record_that_cannot_be_is_refused_before_the_work(
    flags: tuple[str, ...], says: str, traverse: Path, tmp_path: Path
) -> None:
    assert says in gpgrad("slam", traverse, "--out", tmp_path / "map", *flags).refusal
