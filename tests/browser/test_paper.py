"""The paper's method in a real browser: chosen, refused by h, and left again."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from gpgrad_core.detection import PipelineParams
from gpgrad_core.mapping.gradient_map import MapParams

if TYPE_CHECKING:
    from tests.browser.chromium import ViewerPage

pytestmark = [pytest.mark.browser, pytest.mark.slow]
COARSE = PipelineParams(map=MapParams(max_points=3000, resolution=0.1))
"""SURF finds enough on these cells, and software draws every one of them."""


def row(page: "ViewerPage", name: str) -> str:
    """Read a figure of the card."""
    lines = page.verdict().replace("\t", "\n").split("\n")
    return lines[lines.index(name) + 1]


def test_the_paper_is_chosen_and_left(open_viewer: Callable[..., "ViewerPage"]) -> None:
    page = open_viewer(COARSE)
    by_gradient = page.verdict()
    page.choose("Method", "paper")
    page.wait(lambda: "inliers n" in page.verdict().lower(), "the paper's card")
    page.settle()
    assert "database" in row(page, "length-scale")
    assert "no limit" in row(page, "h")
    assert page.page.locator("label").filter(has_text="Minimum score").count() == 0
    page.tick("no limit on h")
    page.wait(lambda: "at most" in row(page, "h"), "a limit on h")
    page.type_value("Maximum h", "1e8")
    page.wait(lambda: "(h)" in page.verdict() and not page.accepted(), "a refusal by h")
    page.choose("Method", "gradient")
    page.wait(lambda: page.verdict() == by_gradient, "the gradient method's verdict")
