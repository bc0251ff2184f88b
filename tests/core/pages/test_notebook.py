"""What a notebook shows."""

from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import gpgrad_core as gg
from gpgrad_core.detection import DetectionResult
from gpgrad_core.types import Grid
from tests.core.pages.walk import PARAMS, read_page, walk

pytest.importorskip("gtsam", reason="GTSAM has no wheels for this system")


class Tags(HTMLParser):
    """Collects tags, and fails on one that is not closed."""

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
    zeros = np.zeros((3, 4))
    untrusted = gg.GradientMap(
        Grid((0, 0), 0.1, (3, 4)), zeros, zeros + 1, np.zeros((3, 4, 2)), 0.1, 0.3
    )
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
