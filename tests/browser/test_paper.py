"""The paper's method in a real browser: every slider acts on keypoints, n, h or the verdict."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from gpgrad_core.detection import PipelineParams
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods.paper import PaperPair, register_paper_pair

if TYPE_CHECKING:
    from tests.browser.chromium import ViewerPage

pytestmark = pytest.mark.browser
COARSE = PipelineParams(map=MapParams(max_points=3000, resolution=0.1))
"""SURF finds enough on these cells, and software draws every one of them."""
Open = Callable[..., "ViewerPage"]


def figures(page: "ViewerPage") -> tuple[object, ...]:
    """Give keypoints, n and h of what is set, as the session's memo has them."""
    session = page.viewer.sessions[0]  # type: ignore[attr-defined]
    state = session.state
    result: PaperPair = register_paper_pair(*state.pair, state.given, session.desk.memo)
    return (
        len(result.query_features),
        len(result.database_features),
        result.registration.num_inliers,
        result.registration.dissimilarity,
        result.closure.accepted,
    )


def row(page: "ViewerPage", name: str) -> str:
    """Read a figure of the card."""
    lines = page.verdict().replace("\t", "\n").split("\n")
    return lines[lines.index(name) + 1]


@pytest.mark.slow
def test_every_slider_acts_on_the_papers_method(open_viewer: Open) -> None:
    page = open_viewer(COARSE)
    by_gradient = page.verdict()
    page.choose("Method", "paper")
    page.wait(lambda: "inliers n" in page.verdict().lower(), "the paper's card")
    page.settle()
    start = page.verdict()
    assert "database" in row(page, "length-scale")
    assert "no limit" in row(page, "h")
    assert page.page.locator("label").filter(has_text="Minimum score").count() == 0
    seen = figures(page)
    for name, pixels, kept in (
        ("Length-scale", 14, 0),
        ("Variance mask", -25, 0),
        ("Inlier radius", -36, 2),  # keypoints stay, n does not
        ("Minimum inliers", 120, 4),  # only the verdict changes
    ):
        card = page.verdict()
        page.drag(name, pixels)
        page.wait(lambda card=card: page.verdict() != card, f"another card by {name}")
        page.settle()
        after = figures(page)
        assert after[:kept] == seen[:kept], name
        changed = after[kept:] != seen[kept:]
        assert changed or name == "Minimum inliers", name
        seen = after
    page.press("Reset parameters")
    page.wait(lambda: page.verdict() == start, "the card of before")
    page.tick("no limit on h")
    page.wait(lambda: "at most" in row(page, "h"), "a limit on h")
    page.type_value("Maximum h", "1e8")
    page.wait(lambda: "(h)" in page.verdict() and not page.accepted(), "a refusal by h")
    page.choose("Method", "gradient")
    page.wait(lambda: page.verdict() == by_gradient, "the gradient method's verdict")
