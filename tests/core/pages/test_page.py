"""What the page of a dataset says, read back from its text."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.detection import register_pair
from gpgrad_core.errors import InputError
from gpgrad_core.io.records.closures import Decision
from gpgrad_core.pages import page_of_dataset, page_of_pair, write_page
from gpgrad_core.pages.page import ACCEPTED, BARRED, RIGHT, TRUE
from gpgrad_core.run.memo import Memo
from tests.core.pages.walk import PARAMS, Read, read_page, subject, walk

pytest.importorskip("gtsam", reason="GTSAM has no wheels for this system")


@pytest.fixture(scope="module")
def page() -> str:
    return page_of_dataset(subject(commands=["gpgrad evaluate walk --out report"]))


@pytest.fixture(scope="module")
def read(page: str) -> Read:
    return read_page(page)


def test_it_names_no_other_address(page: str) -> None:
    assert not re.search(r"https?://|src=|url\(|@import|href=", page)
    assert "default-src 'none'" in page


def test_every_pair_is_there_with_its_verdict(read: Read) -> None:
    _, closures = walk()
    arrays = {name: found[0] for name, found in read.arrays.items() if name not in ("known",)}
    ids = [submap["id"] for submap in read.content["submaps"]]
    pairs = [(ids[q], ids[d]) for q, d in zip(arrays["query"], arrays["database"], strict=True)]
    assert pairs == [(c.query_id, c.database_id) for c in closures]
    assert [bool(s & ACCEPTED) for s in arrays["state"]] == [c.accepted for c in closures]
    accepted = arrays["state"][1:]
    assert all(accepted & RIGHT)
    assert any(accepted & TRUE)
    assert read.content["threshold"] <= min(arrays["score"][1:])
    motion = closures[1].registration.T_database_query
    assert arrays["yaw"][1] == pytest.approx(motion.yaw)
    assert np.isnan(arrays["x"][0])  # no motion was found


def test_poses_before_and_after_and_of_the_truth_lie_in_one_frame(read: Read) -> None:
    poses = read.content["poses"]
    before, after, truth = (np.array(poses[name]) for name in ("before", "after", "truth"))
    off = [np.abs(rows[:, :2] - truth[:, :2]).max() for rows in (before, after)]
    assert off[1] < 0.5 * off[0]


def test_terrain_is_that_of_the_submaps(read: Read) -> None:
    assert len(read.arrays["heights"]) == len(read.content["submaps"]) == 5
    for heights, submap in zip(read.arrays["heights"], read.content["submaps"], strict=True):
        assert len(heights) == 2 * submap["rows"] * submap["columns"]
        assert 2.2 < submap["cell"] * submap["rows"] < 3.6


def test_decisions_and_names_are_those_of_the_dataset() -> None:
    name = "</script><script>alert(1)</script><b>"
    shown = subject()
    decisions = {shown.report.pairs[1].pair: Decision(accepted=False)}
    report = replace(shown.report, decisions=decisions)
    page = page_of_dataset(replace(shown, name=name, report=report))
    assert "<script>alert" not in page
    read = read_page(page)
    assert read.content["name"] == name
    state = read.arrays["state"][0][1]  # the decision outweighs the score
    assert state & BARRED
    assert not state & ACCEPTED


def test_submaps_without_poses_or_pairs_stand_in_rows() -> None:
    shown = replace(subject(), before={}, after=None, truth={}, evaluation=None)
    read = read_page(page_of_dataset(replace(shown, report=replace(shown.report, pairs=()))))
    assert len(read.arrays["query"][0]) == 0
    assert read.content["curve"] is None
    poses = read.content["poses"]
    assert (poses["known"], poses["after"], poses["truth"]) == (False, None, None)
    places = np.array(poses["before"])[:, :2]
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2)
    assert gaps[~np.eye(5, dtype=bool)].min() > 3.0


def test_a_pair_is_shown_with_its_inliers() -> None:
    dataset, _ = walk()
    result = register_pair(dataset.submaps[4], dataset.submaps[0], PARAMS, Memo())
    read = read_page(page_of_pair(result))
    assert read.content["poses"] is None
    assert [submap["id"] for submap in read.content["submaps"]] == ["000", "008"]
    kept = result.registration.num_inliers
    assert kept > 3
    (line,) = read.arrays["line"]
    assert line.shape == (4 * kept,)


def test_a_folder_that_is_missing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no folder"):
        write_page(tmp_path / "gone" / "page.html", subject())
