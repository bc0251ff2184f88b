"""`gpgrad detect`: what it finds, and what it leaves."""

import json
import math
import shutil
import tempfile
from pathlib import Path
from typing import Any

import cv2
import pytest

from app.cli import run
from gpgrad_core import comparing
from gpgrad_core.detection import stored, with_store
from gpgrad_core.io.records.closures import read_closures
from gpgrad_core.run.folders import private_folder
from gpgrad_core.run.parallel import WORTH_PROCESSES
from gpgrad_core.run.store import Store
from gpgrad_core.simulation.demo import demo_path
from tests.core.methods.test_appearance import picture, turned
from tests.end_to_end.process import gpgrad, run_on_terminal
from tests.support.closures import content_of


@pytest.fixture(scope="module")
def detected(traverse: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with what one run wrote."""
    folder = tmp_path_factory.mktemp("detected")
    finished = gpgrad(
        "detect", traverse, "--out", folder / "closures.json", "--g2o", folder / "graph.g2o"
    )
    assert finished.code == 0, finished.err
    assert finished.err == ""  # no bar into a pipe
    assert "1 loop closure in 6 pairs of 4 submaps" in finished.out
    return folder


def test_the_revisit_is_found_and_nothing_else(detected: Path) -> None:
    report = read_closures(detected / "closures.json")
    (closure,) = report.accepted
    assert closure.pair == ("003", "000")
    motion = closure.registration.T_database_query
    assert motion is not None
    # The query's true pose in the database's frame, which lies in the world's origin.
    assert motion.x == pytest.approx(0.5, abs=0.1)
    assert motion.y == pytest.approx(0.4, abs=0.1)
    assert motion.yaw == pytest.approx(3.0, abs=0.05)
    assert closure.registration.num_inliers >= report.params["closure"]["min_inliers"]
    assert closure.registration.score == max(pair.registration.score for pair in report.pairs)


def test_every_unordered_pair_is_there_once(detected: Path) -> None:
    report = read_closures(detected / "closures.json")
    pairs = [(pair.database_id, pair.query_id) for pair in report.pairs]
    assert sorted(pairs) == sorted((a, b) for a in report.submaps for b in report.submaps if a < b)
    assert set(report.seconds) == {"maps", "features", "pairs", "total"}
    assert report.dataset == "small traverse"


def test_the_graph_has_the_closure_as_an_edge(detected: Path) -> None:
    lines = (detected / "graph.g2o").read_text().splitlines()
    assert sum(line.startswith("VERTEX_SE3:QUAT ") for line in lines) == 4
    edges = [line.split()[1:3] for line in lines if line.startswith("EDGE_SE3:QUAT ")]
    assert edges == [["0", "1"], ["1", "2"], ["2", "3"], ["0", "3"]]


def test_only_the_best_candidates_are_compared(
    traverse: Path, detected: Path, tmp_path: Path
) -> None:
    out = tmp_path / "closures.json"
    finished = gpgrad("detect", traverse, "--out", out, "--candidates", "1")
    assert finished.code == 0, finished.err
    assert "1 loop closure in 3 pairs (3 were not compared) of 4 submaps" in finished.out
    whole, few = read_closures(detected / "closures.json"), read_closures(out)
    assert (whole.num_pairs_skipped, few.num_pairs_skipped) == (0, 3)
    whole_rows, few_rows = (content_of(report)["pairs"] for report in (whole, few))
    assert all(row in whole_rows for row in few_rows)
    assert [pair.pair for pair in few.accepted] == [pair.pair for pair in whole.accepted]


def test_the_same_seed_gives_the_same_file(traverse: Path, detected: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.json"
    assert gpgrad("detect", traverse, "--out", again).code == 0
    first, second = (json.loads(path.read_text()) for path in (detected / "closures.json", again))
    for content in (first, second):
        content.pop("seconds")
    assert first == second


@pytest.mark.slow
def test_a_flag_overrides_the_file_and_the_file_the_dataset(traverse: Path, tmp_path: Path) -> None:
    toml = tmp_path / "mine.toml"
    toml.write_text("[map]\nresolution = 0.1\nnoise_std = 0.02\n[closure]\nmin_inliers = 500\n")
    out = tmp_path / "closures.json"
    finished = gpgrad(
        *("detect", traverse, "--out", out, "--params", toml),
        *("--map.noise-std", "0.03", "--registration.seed", "7", "--matching.no-mutual"),
    )
    assert finished.code == 0, finished.err
    report = read_closures(out)
    assert report.params["map"]["noise_std"] == 0.03  # flag, over the file
    assert report.params["map"]["resolution"] == 0.1  # file, over the dataset
    assert report.params["map"]["length_scale"] == 0.25  # dataset, over the built-in
    assert report.params["matching"]["mutual"] is False
    assert report.seed == 7
    assert not report.accepted  # nothing has 500 inliers
    best = max(report.pairs, key=lambda pair: pair.registration.score)
    assert "inliers < 500" in best.reason


def test_a_rival_finds_the_same_loop_and_is_named(traverse: Path, tmp_path: Path) -> None:
    out = tmp_path / "closures.json"
    finished = gpgrad("detect", traverse, "--out", out, "--method", "smoothed")
    assert finished.code == 0, finished.err
    report = read_closures(out)
    assert report.method == "smoothed"
    best = max(report.pairs, key=lambda pair: pair.registration.score)
    assert best.pair == ("003", "000")


@pytest.mark.slow
def test_an_interrupt_ends_all_workers_and_leaves_nothing(tmp_path: Path) -> None:
    out = tmp_path / "closures.json"
    assert math.comb(10, 2) >= WORTH_PROCESSES  # the demo's pairs are compared in processes
    code, seen = run_on_terminal("detect", demo_path(), "--out", out, interrupt_at=b"pairs")
    assert code == 130
    assert "gpgrad: interrupted" in seen
    assert "Traceback" not in seen
    assert not out.exists()


@pytest.mark.slow
def test_without_a_cache_the_results_of_many_lie_in_a_folder_that_goes_with_the_run(
    traverse: Path, detected: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stored, "ALL_UP_TO", 2)  # as if four submaps were many
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    folders: list[str] = []

    def noted(detector: object, store: Store | None) -> object:
        assert store is not None
        folders.append(str(store.folder))
        return with_store(detector, store)  # type: ignore[type-var]

    monkeypatch.setattr(comparing, "with_store", noted)
    out = tmp_path / "closures.json"
    assert run(["detect", str(traverse), "--out", str(out), "--cache", "none"]) == 0
    one, other = (read_closures(path) for path in (out, detected / "closures.json"))
    assert content_of(one)["pairs"] == content_of(other)["pairs"]
    assert len(folders) == 1
    own = private_folder(tmp_path)
    assert folders[0].startswith(str(own / "gpgrad-results-"))
    assert not list(own.iterdir())
    assert sorted(tmp_path.iterdir()) == sorted([own, out])


@pytest.mark.slow
def test_images_are_counted_apart_and_may_veto(traverse: Path, tmp_path: Path) -> None:
    data = shutil.copytree(traverse, tmp_path / "traverse")
    (data / "poses_gt.txt").write_text((traverse / "poses_odom.txt").read_text())
    for index, image in ((0, picture(2)), (3, turned(picture(2), math.degrees(3.0)))):
        (data / f"images/{index:03d}").mkdir(parents=True)
        cv2.imwrite(str(data / f"images/{index:03d}/front.png"), image)
    asked = ("--out", tmp_path / "found.json", "--closure.images", "veto", "--overwrite")
    finished = gpgrad("detect", data, *asked)
    assert finished.code == 0, finished.err
    assert "1 loop closure in 6 pairs" in finished.out
    assert "images: 1 confirmed, 0 contradicted, 0 silent" in finished.out
    # The vehicle came back turned about, so the same image again cannot be of the same place.
    cv2.imwrite(str(data / "images/003/front.png"), picture(2))
    finished = gpgrad("detect", data, *asked)
    assert "0 loop closures in 6 pairs" in finished.out
    assert "images: 0 confirmed, 1 contradicted, 0 silent" in finished.out
    (refused,) = [pair for pair in read_closures(tmp_path / "found.json").pairs if pair.images]
    assert not refused.accepted
    assert "the images contradict the motion" in refused.reason
    assert "the image is turned by 0°, and the motion turns by 17" in refused.reason
    judged = gpgrad(
        "evaluate", data, "--out", tmp_path / "report", "--closures", tmp_path / "found.json"
    )
    assert judged.code == 0, judged.err
    assert "gradient: images: 0 confirmed, 1 contradicted, 0 silent" in judged.out
    report = json.loads((tmp_path / "report/report.json").read_text())
    assert report["images"]["gradient"]["contradicted"] == {"true": 1, "false": 0, "left_out": 0}
    assert "| gradient | contradicted | 1 | 0 | 0 |" in (tmp_path / "report/report.md").read_text()


@pytest.mark.slow
def test_events_tell_closures_as_the_file_has_them(traverse: Path, tmp_path: Path) -> None:
    finished = gpgrad("detect", traverse, "--out", tmp_path / "closures.json", "--json")
    assert (finished.code, finished.err) == (0, "")
    events = [json.loads(line) for line in finished.out.splitlines()]
    assert events[0]["event"] == "started"
    assert {event["stage"] for event in events if event["event"] == "progress"} >= {"load", "pairs"}
    (told,) = [event for event in events if event["event"] == "closure"]
    (kept,) = [pair for pair in json_of(tmp_path / "closures.json")["pairs"] if pair["accepted"]]
    for name in ("query", "database", "score", "num_inliers", "T_database_query", "z_offset"):
        assert told[name] == kept[name]
    assert events[-1]["event"] == "result"
    assert events[-1]["output"] == str(tmp_path / "closures.json")
    assert events[-1]["values"]["closures"] == 1


def json_of(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))
