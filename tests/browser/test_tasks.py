"""Ten tasks that users bring, from the map that opens first: each in at most so many acts.

An act is a click, a key, a drag, a place on which the pointer rests, or a line that is typed. The
numbers are printed by ``pytest tests/browser/test_tasks.py -n 0 -m browser -s``.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from app.viewer.features.desk import Desk
from tests.browser.conftest import QUICK

pytestmark = [pytest.mark.browser, pytest.mark.slow]
LONG_S = 600.0
"""What a film may take on a busy machine."""
CELL = """(svg, [row, column]) => {
    const {left, top, side} = svg.dataset;
    const at = new DOMPoint(+left + (column + .5) * side, +top + (row + .5) * side)
        .matrixTransform(svg.getScreenCTM());
    return [at.x, at.y];
}"""
MISSED = """svg => {
    const mark = svg.querySelector('[data-outcome=missed] use').getAttribute('href');
    const [x, y] = svg.querySelector(mark).getAttribute('d').match(/[\\d.]+/g).map(Number);
    const {left, top, side} = svg.dataset;
    return [Math.floor((y - top) / side), Math.floor((x - left) / side)];
}"""
"""The row and the column of the first pair that is missed."""


class Hand:
    """Does on a page what a person does, and counts the acts."""

    def __init__(self, page: Any) -> None:
        self.page, self.acts = page, 0

    def __getattr__(self, name: str) -> Callable[..., Any]:
        """Give an act of the page by its name, such as a press or a drag."""
        act = getattr(self.page, name)

        def counted(*arguments: Any) -> Any:
            self.acts += 1
            return act(*arguments)

        return counted

    def click(self, x: float, y: float) -> None:
        self.page.page.mouse.click(x, y)
        self.acts += 1

    def rest_on(self, part: Any) -> None:
        part.hover(position={"x": 2, "y": 2})
        self.acts += 1

    def command(self, name: str) -> None:
        """Find a command by its name: two keys, and a line between them."""
        self.key("Control+k")
        keyboard = self.page.page.keyboard
        self.page.page.wait_for_function("document.activeElement.tagName === 'INPUT'")
        keyboard.type(name)
        self.page.page.wait_for_timeout(300)  # the list is narrowed by then
        keyboard.press("Enter")
        self.acts += 2


def open_cell(hand: Hand, find: str = "") -> None:
    """Open a pair from the matrix beside the map: the one that a script finds, or 004 and 000."""
    hand.key("Shift+P")
    page = hand.page
    page.page.get_by_text("in 45 pairs").first.wait_for()
    assert page.viewer.wait_idle(LONG_S)
    matrix = page.page.locator("body > [data-board] svg[data-asks]")
    row, column = matrix.evaluate(find) if find else (4, 0)
    hand.click(*matrix.evaluate(CELL, [row, column]))
    pair = f"{row:03d}", f"{column:03d}"
    page.wait(lambda: page.pair() == pair, f"the pair {pair}")
    assert page.viewer.wait_idle(LONG_S)
    assert not page.accepted()


def measure_a_slope(hand: Hand) -> None:
    hand.click(*hand.page.map_spot())
    hand.page.wait(lambda: re.search(r"slope\s+\d\.\d\d m/m", hand.page.say("place")), "a slope")


def find_the_worst_drift(hand: Hand) -> None:
    hand.tab("Pose graph")
    hand.press("Optimise")
    found = r"largest correction\s+\d\.\d\d m, of 00\d"
    hand.page.wait(lambda: re.search(found, hand.page.say("graph-result")), "it", LONG_S)


def find_a_missed_closure(hand: Hand) -> None:
    strict = replace(QUICK, closure=replace(QUICK.closure, min_score=9.0))
    hand.page.viewer.sessions[0].desk.change(params=strict)
    open_cell(hand, MISSED)


def say_why_it_was_refused(hand: Hand) -> None:
    open_cell(hand)
    assert re.search(r"\w+ .*\.", hand.page.say("why"))
    assert re.search(r"\d", hand.page.say("evidence"))


def find_the_length_scale_at_which_it_breaks(hand: Hand) -> None:
    hand.press("Tune")
    strip = hand.page.widget("Length-scale").locator("[data-strip]")
    strip.wait_for(timeout=1000 * LONG_S)
    hand.rest_on(strip)
    assert re.search(r"loop closure (from|at) [\d.]+", strip.get_attribute("title"))


def compare_two_settings(hand: Hand) -> None:
    hand.press("Tune")
    hand.key("0")
    hand.page.page.get_by_test_id("a-b").wait_for()
    hand.drag("Variance mask", -20)
    lost = hand.page.page.locator("[data-testid=changes] > span").first
    hand.page.wait(lambda: lost.inner_text().split()[0] != "0", "inliers that only A has")
    hand.page.viewer.sessions[0].desk.leave_reference()


def show_a_colleague(hand: Hand) -> None:
    page = hand.page.page
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    hand.key("Shift+L")
    hand.page.wait(
        lambda: "#query=007&database=001" in page.evaluate("navigator.clipboard.readText()"),
        "the link",
    )


def download(hand: Hand, command: str) -> Path:
    """Take a file that a command makes; gives where it lies, by the name that it has."""
    with hand.page.page.expect_download(timeout=1000 * LONG_S) as coming:
        hand.command(command)
    path = Path(coming.value.path())
    return path.rename(path.with_name(coming.value.suggested_filename))


def make_a_slide(hand: Hand) -> None:
    path = download(hand, "Save slides")
    assert path.read_bytes().startswith(b"%PDF")


def make_a_film(hand: Hand) -> None:
    path = download(hand, "Save film")
    assert path.suffix in (".mp4", ".webm")
    assert path.stat().st_size > 50_000


def report_a_wrong_verdict(hand: Hand) -> None:
    path = download(hand, "Report a wrong verdict")
    assert "Refused by hand" in path.read_text()
    hand.page.viewer.sessions[0].desk.take_back()


TASKS: dict[Callable[[Hand], None], int] = {
    measure_a_slope: 1,
    find_the_worst_drift: 2,
    find_a_missed_closure: 2,
    say_why_it_was_refused: 2,
    find_the_length_scale_at_which_it_breaks: 2,
    compare_two_settings: 3,
    show_a_colleague: 1,
    make_a_slide: 3,
    make_a_film: 3,
    report_a_wrong_verdict: 3,
}
"""What users bring, and in how many acts it is done."""


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.__name__)
def test_a_task_takes_few_acts(page: Any, task: Callable[[Hand], None]) -> None:
    page.press("Explore")
    assert page.viewer.sessions[0].world.is_drawn(LONG_S)
    assert page.viewer.wait_idle(LONG_S)
    hand = Hand(page)
    task(hand)
    print(f"{task.__name__}: {hand.acts}")  # noqa: T201 - what was counted
    assert hand.acts <= TASKS[task]
    desk: Desk = page.viewer.sessions[0].desk
    desk.update(lambda now: replace(now, board=False))
