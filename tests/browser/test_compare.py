"""A beside B: kept by a button, followed by a slider, left by Escape, brought back by a link."""

from dataclasses import replace
from statistics import median
from time import perf_counter, sleep
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]
STEPS = (0.25, 0.2, 0.27, 0.22, 0.3)


def seconds_of_steps(page: Any) -> float:
    """Set the variance mask anew a few times, and give the median time until the scene has it."""
    desk, scene, times = page.viewer.sessions[0].desk, page.viewer.sessions[0].pair.scene, []
    for ratio in STEPS:
        asked = desk.state.asked
        features = replace(asked.features, max_std_ratio=ratio)
        start = perf_counter()
        desk.change(params=replace(asked, features=features))
        while scene.picture.ratio != ratio:
            sleep(0.001)
        times.append(perf_counter() - start)
        assert page.viewer.wait_idle(60.0)
    return median(times)


def test_a_stays_beside_b_and_a_link_has_both(page: Any) -> None:
    desk = page.viewer.sessions[0].desk
    before = seconds_of_steps(page)
    page.press("Keep as A")
    page.page.get_by_test_id("a-b").wait_for()
    assert "0 only in A" in page.say("changes")
    assert seconds_of_steps(page) <= 2.0 * before + 0.05
    page.type_value("Variance mask", "0.15")
    page.wait(lambda: "\t0.15" in page.say("of-B"), "the figures of B")
    assert page.viewer.wait_idle(60.0)
    number = page.viewer.sessions[0].pair.scene.picture.result.registration.num_inliers
    lost, gained, both = (
        int(text.split()[0])
        for text in page.page.locator("[data-testid=changes] > span").all_inner_texts()[:3]
    )
    assert lost > 0
    assert gained + both == number
    assert page.say("of-A").split()[2] == str(lost + both)
    page.wait(lambda: "reference.method" in page.page.evaluate("location.href"), "the link")
    link, reference = page.page.evaluate("location.href"), desk.state.reference
    page.key("Escape")
    page.wait(lambda: desk.state.reference is None, "B alone")
    page.page.get_by_test_id("a-b").wait_for(state="detached")
    page.page.goto("about:blank")
    page.page.goto(link)
    page.page.get_by_test_id("a-b").wait_for()
    assert desk.state.reference == reference
    desk.leave_reference()
