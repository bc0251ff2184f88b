"""The time line in a real browser: it plays, goes back, and follows a slider."""

from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]
LAST = 9


def test_play_scrub_change_and_leave(page: Any) -> None:
    session = page.viewer.sessions[0]
    strip = page.page.get_by_test_id("timeline")
    time = page.page.get_by_test_id("time")
    moment = page.page.get_by_test_id("moment")

    def at() -> int:
        return int(strip.get_attribute("data-at") or -1)

    def rests() -> bool:
        return strip.get_attribute("data-playing") == strip.get_attribute("data-busy") == "false"

    assert not strip.is_visible()
    page.press("Explore")
    strip.wait_for(state="visible")
    strip.get_by_label("Play").click()
    page.wait(lambda: at() == LAST and rests(), "the end of the drive")
    assert strip.locator("[data-kind=closure]").count() >= 3
    assert strip.locator("[data-kind=correction]").count() >= 1
    assert not page.is_blank()
    whole = page.picture()
    time.focus()
    for _ in range(6):
        page.page.keyboard.press("ArrowLeft")
    page.wait(lambda: at() == LAST - 6 and moment.inner_text().startswith("003"), "an early moment")
    page.wait(lambda: bool((page.picture() != whole).any()), "a smaller map")
    before = session.timeline.moments

    asked = session.desk.state.asked
    page.press("Tune")
    strip.wait_for(state="hidden")
    page.type_value("Minimum score", "9.0")
    page.press("Explore")
    page.wait(
        lambda: (
            session.timeline.moments is not before and session.desk.state.asked != asked and rests()
        ),
        "the drive by another threshold",
    )
    assert at() == LAST - 6
    num_accepted = [
        sum(len(m.accepted) for m in moments) for moments in (before, session.timeline.moments)
    ]
    assert num_accepted[1] < num_accepted[0]

    time.focus()
    page.page.keyboard.press("End")
    page.wait(lambda: at() == LAST and rests(), "the end again")
    strip.get_by_label("Leave the time line").click()
    page.wait(lambda: at() == -1, "the whole world")
    assert session.world.world is not None
