"""What the page of a dataset says, read back from its text, and what a notebook shows."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gpgrad_core as gg
from gpgrad_core.detection import DetectionResult, register_pair
from gpgrad_core.errors import InputError
from gpgrad_core.io.records.closures import Decision
from gpgrad_core.pages import page_of_dataset, page_of_pair, write_page
from gpgrad_core.pages.page import (
    ACCEPTED,
    BARRED,
    FINEST,
    LARGEST,
    RIGHT,
    TRUE,
    Pack,
    Packed,
    pack_terrain,
)
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Grid
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


def unpacked(packed: Packed, shape: tuple[int, int]) -> np.ndarray:
    """Do what the page's script does."""
    cells = shape[0] * shape[1]
    folded = packed.deltas[:cells].astype(int) | packed.deltas[cells:].astype(int) << 8
    deltas = (folded >> 1) ^ -(folded & 1)
    heights = packed.base + packed.step * np.cumsum(deltas.reshape(shape), axis=1)
    known = np.unpackbits(packed.trusted, bitorder="little")[:cells].reshape(shape)
    return np.where(known == 1, heights, np.nan)


@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e5))
def test_heights_come_back_to_half_a_step(seed: int, relief: float) -> None:
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(1, 30)), int(rng.integers(1, 30)))
    heights = relief * rng.standard_normal(shape) - 3.0
    known = rng.random(shape) < rng.random()
    packed = pack_terrain(heights, known)
    back = unpacked(packed, shape)
    assert (np.isnan(back) == ~known).all()
    if known.any():
        assert np.abs(back - heights)[known].max() <= 0.5001 * packed.step + 1e-9 * relief
    assert packed.step >= FINEST
    assert packed.step <= max(FINEST, np.ptp(heights) / LARGEST)


def test_smooth_ground_takes_about_a_byte_a_cell() -> None:
    x, y = np.meshgrid(np.linspace(0, 12, 120), np.linspace(0, 12, 120))
    heights = 0.3 * np.sin(x) * np.cos(0.7 * y)
    pack = Pack()
    pack.add("heights", pack_terrain(heights, heights > -1).deltas)
    assert len(pack.text) < 1.0 * x.size


class Tags(HTMLParser):
    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict[str, str | None]]] = []
        self.feed(html)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append((tag, dict(attrs)))
        self.open += [tag] if tag != "img" else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def named(self, name: str) -> list[dict[str, str | None]]:
        return [attributes for tag, attributes in self.seen if tag == name]


def test_a_dataset_is_a_page_in_a_frame_of_its_own(tmp_path: Path) -> None:
    dataset, closures = walk()
    shown = gg.show(dataset, DetectionResult(tuple(closures), {}), params=PARAMS)
    (frame,) = Tags(shown._repr_html_()).named("iframe")
    assert frame["srcdoc"] == shown.page
    assert frame["sandbox"] == "allow-scripts"
    assert shown.save(tmp_path / "page.html").read_text(encoding="utf-8") == shown.page
    assert len(read_page(shown.page).arrays["query"][0]) == 5


def test_results_are_pictures_and_tables() -> None:
    dataset, closures = walk()
    pair = gg.register_pair(dataset.submaps[4], dataset.submaps[0], PARAMS, gg.Memo())
    found = DetectionResult(tuple(closures), {})
    zeros, grid = np.zeros((3, 4)), Grid((0, 0), 0.1, (3, 4))
    untrusted = gg.GradientMap(grid, zeros, zeros + 1, np.zeros((3, 4, 2)), 0.1, 0.3)
    words = {
        untrusted: "0 % of the cells",
        pair.query_map: "Gradient map",
        pair: "008 on 000",
        pair.registration: "associations",
        pair.closure: "000",
        found: "4 loop closures in 5 pairs",
        gg.evaluate(dataset, {"by <hand>": found}): "by &lt;hand&gt;",
    }
    for shown, said in words.items():
        html = shown._repr_html_()
        assert said in html
        for picture in Tags(html).named("img"):
            assert str(picture["src"]).startswith("data:image/png;base64,")
    assert len(Tags(pair._repr_html_()).named("img")) == 4
