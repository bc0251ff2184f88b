"""The viewer in a real browser: every control moves the picture and the verdict."""

import json
import re
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from app.viewer.features.params.tab import MAIN_PARAMETERS
from gpgrad_core.detection import PipelineParams

if TYPE_CHECKING:
    from tests.browser.chromium import ViewerPage

pytestmark = pytest.mark.browser
Open = Callable[..., "ViewerPage"]


def expect_change(page: "ViewerPage", act: Callable[[], None], *, verdict: bool = True) -> None:
    """Act, and wait until the picture, and if asked the verdict card, is another."""
    from tests.browser.chromium import changed, is_blank  # noqa: PLC0415

    card, before = page.verdict(), page.picture()
    act()
    if verdict:
        page.wait(lambda: page.verdict() != card, "another verdict card")
    # The camera is still and `settle` saw the picture stand still: an unchanged scene gives 0.
    page.wait(lambda: changed(before, page.picture()) > 5e-5, "another picture")
    assert not is_blank(page.settle())


def opens_on_a_closure(page: "ViewerPage") -> None:
    assert page.accepted()
    assert page.pair()[0] == "007"
    assert "Up to date" in page.status()
    assert page.legend().startswith("Gradient (steepness) [m/m]")
    on_canvas = page.page.get_by_test_id("canvas-legend").inner_text()
    assert "Gradient (steepness) [m/m]" in on_canvas
    assert re.search(r"frame of the database: query turned \+16[5-7]°", on_canvas)
    assert not page.is_blank()


def test_the_demo_opens_on_a_closure(page: "ViewerPage") -> None:
    opens_on_a_closure(page)
    page.resize(1100, 720)
    page.rest()
    for name in MAIN_PARAMETERS.values():  # in sight without opening or scrolling
        box = page.thumb(name).bounding_box()
        assert box is not None
        assert box["y"] < 720


@pytest.mark.nightly
def test_the_demo_opens_as_a_stranger_finds_it(open_viewer: Open) -> None:
    opens_on_a_closure(open_viewer(PipelineParams(), size=(1100, 720)))


@pytest.mark.slow
def test_each_slider_moves_all_and_reset_brings_it_back(page: "ViewerPage") -> None:
    card = page.verdict()
    before = {name: page.value(name) for name in MAIN_PARAMETERS.values()}
    for name, pixels in (
        ("Length-scale", 14),
        ("Noise", 10),  # more, and with the mask below nothing would be left to judge
        ("Variance mask", -6),
        ("Inlier radius", -36),
        ("Minimum inliers", 120),
    ):
        expect_change(page, lambda name=name, pixels=pixels: page.drag(name, pixels))
        assert page.value(name) != before[name]
    page.type_value("Minimum inliers", "1000")
    page.wait(lambda: "at least 1000 are needed" in page.verdict(), "the typed value's verdict")
    assert not page.accepted()  # no pair has as many
    expect_change(page, lambda: page.press("Reset parameters"))
    assert page.verdict() == card
    assert {name: page.value(name) for name in before} == before


@pytest.mark.slow
def test_escape_or_h_closes_the_help_and_it_can_be_opened_again(page: "ViewerPage") -> None:
    dialog = page.page.get_by_role("dialog")
    for closing in ("Escape", "h"):
        page.key("h")
        page.page.get_by_test_id("help").wait_for()
        page.page.keyboard.press(closing)
        dialog.wait_for(state="detached")


@pytest.mark.slow
def test_layers_layout_and_switches_change_the_picture_only(page: "ViewerPage") -> None:
    from tests.browser.chromium import changed  # noqa: PLC0415

    card, start = page.verdict(), page.settle()
    for layer, title in (
        ("standard deviation", "Standard deviation of the elevation [m]"),
        ("elevation", "Elevation [m]"),
        ("dz/dy", "Slope along y, dz/dy [m/m]"),
        ("mask", "Variance mask"),
        ("gradient", "Gradient (steepness) [m/m]"),
    ):
        expect_change(page, lambda layer=layer: page.choose("Layer", layer), verdict=False)
        assert page.legend().startswith(title)
    expect_change(page, lambda: page.choose("Layout", "registered"), verdict=False)
    expect_change(page, lambda: page.choose("Layout", "side by side"), verdict=False)
    switches = ("Point clouds", "Inlier lines", "Surfaces")
    for switch in switches:
        expect_change(page, lambda switch=switch: page.tick(switch), verdict=False)
    for switch in switches:
        page.tick(switch)
    page.wait(lambda: changed(start, page.picture()) < 1e-3, "the first picture again")
    assert page.verdict() == card


def marks_of(page: "ViewerPage") -> dict[str, int]:
    """Count the marks of the matrix by outcome."""
    script = """() => [...document.querySelectorAll('[data-testid=affinity-all] [data-outcome]')]
        .map(node => [node.dataset.outcome, +node.dataset.count])"""
    return dict(page.page.evaluate(script))


def drag_threshold(page: "ViewerPage") -> None:
    """Draw the threshold from where nothing is accepted to where much is."""
    place = "() => document.querySelector('[data-threshold]').getCTM().e"
    scores = page.page.get_by_test_id("scores")
    scores.scroll_into_view_if_needed()
    box = scores.bounding_box()
    assert box is not None
    y = box["y"] + 0.12 * box["height"]
    page.page.mouse.move(box["x"] + 0.9 * box["width"], y)
    page.page.mouse.down()
    places = []
    for step in range(10):
        page.page.mouse.move(box["x"] + (0.9 - 0.06 * step) * box["width"], y)
        places.append(float(page.page.evaluate(place)))
    assert places == sorted(places, reverse=True)  # it follows the hand without the server
    assert len(set(places)) > 7
    page.page.mouse.up()
    page.wait(lambda: "right" in marks_of(page), "accepted pairs again")
    asked = float(scores.get_attribute("aria-valuenow") or "nan")
    page.wait(lambda: page.value("Minimum score") == asked, "the slider at the threshold")
    assert 2.0 < asked < 9.0
    assert page.viewer.wait_idle(120.0)
    page.settle()  # whatever the server said meanwhile, it stays there
    assert float(scores.get_attribute("aria-valuenow") or "nan") == asked
    assert float(page.page.evaluate(place)) == places[-1]


def click_a_mark(page: "ViewerPage") -> None:
    """Open the missed pair of the lowest score by its mark below the scores."""
    marks = page.page.get_by_test_id("disagreements")
    marks.scroll_into_view_if_needed()
    box = marks.bounding_box()
    assert box is not None
    x, query, database, _ = json.loads(marks.get_attribute("data-marks") or "")[-1]
    assert page.pair() != (query, database)
    page.page.mouse.click(box["x"] + x * box["width"] / 300.0, box["y"] + box["height"] / 2)
    page.wait(lambda: page.pair() == (query, database), "the pair of the mark")


def click_a_cell(page: "ViewerPage") -> None:
    """Point at the cell of 006 and 002, read it and open it."""
    matrix = page.page.get_by_test_id("affinity-all")
    matrix.scroll_into_view_if_needed()
    box = matrix.bounding_box()
    assert box is not None
    left, side, scale = (
        float(matrix.get_attribute("data-left") or "nan"),
        float(matrix.get_attribute("data-side") or "nan"),
        box["width"] / 300.0,
    )
    x, y = box["x"] + scale * (left + 2.5 * side), box["y"] + scale * (1.0 + 6.5 * side)
    page.page.mouse.move(x, y)
    assert page.say("matrix-said-all").startswith("006 → 002 · score ")
    page.page.mouse.click(x, y)
    page.wait(lambda: page.pair() == ("006", "002"), "the pair of the cell")
    page.settle()


def decide_by_keys(page: "ViewerPage") -> None:
    """Refuse and accept the pair that is shown, and go to the next."""
    page.wait(lambda: bool(page.say("triage")), "the list")
    assert page.viewer.wait_idle(120.0)
    pair = page.pair()
    for key, said in (("x", "Refused by hand"), ("a", "Accepted by hand")):
        page.key(key)
        page.wait(lambda said=said: said in page.say("verdict"), said)
    page.key("g")
    page.wait(lambda: page.pair() != pair, "the next undecided pair")
    page.wait(lambda: "by hand" not in page.say("verdict"), "a verdict of its own")


@pytest.mark.slow
def test_all_pairs_are_run_judged_and_decided(open_viewer: Open) -> None:
    page = open_viewer()
    page.tab("All pairs")
    page.press("Run all pairs")
    page.page.get_by_test_id("affinity-all").wait_for()
    assert "loop closures in 45 pairs" in page.page.get_by_text("in 45 pairs").inner_text()
    page.page.get_by_test_id("operating-point").wait_for(state="visible")
    assert page.page.get_by_test_id("operating-point").count() == 1
    before = marks_of(page)
    page.type_value("Minimum score", "11.5")  # nothing is accepted any more
    page.wait(lambda: marks_of(page) != before, "other marks")
    assert marks_of(page)
    assert all("missed" in outcome for outcome in marks_of(page))
    click_a_mark(page)
    drag_threshold(page)
    click_a_cell(page)
    decide_by_keys(page)
