# ruff: noqa: T201 - tells where its pictures are
"""The card of the verdict in every state, on a desk and on a phone, to be looked at.

It prints a folder with the pictures. The pair is the demo's; what was found of it is made up, so
that each state is there. Would a stranger know what was decided, and why?
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import pytest

from app.viewer.session.decisions import Decisions, with_verdict
from app.viewer.viewer import Viewer
from gpgrad_core.detection import PairResult, PipelineParams
from gpgrad_core.detection.verdict import classify
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.types import Agreement, Context, Registration
from tests.browser.chromium import ViewerPage, find_chromium, launch

pytestmark = pytest.mark.browser
SIZES = ((1440, 900), (390, 844))
PLAIN = Agreement(0.009, 0.0064, 0.3)


def changed(
    result: PairResult, params: PipelineParams, context: Context | None, **changes: object
) -> PairResult:
    """Judge a pair with other figures."""
    registration: Registration = replace(result.registration, **changes)  # type: ignore[arg-type]
    closure = classify(registration, params.closure, context=context)
    return replace(result, registration=closure.registration, closure=closure)


def states(result: PairResult, params: PipelineParams) -> dict[str, PairResult]:
    """Make a result for each state of the card."""

    def make(context: Context | None = None, **changes: object) -> PairResult:
        return changed(result, params, context, **{"agreement": PLAIN, **changes})

    return {
        "closure": make(),
        "none": make(agreement=Agreement(0.09, 0.03, 0.3), score=0.4),
        "no_motion": make(T_database_query=None, agreement=None, score=0.0),
        "undecided_small": make(overlap_area=0.7, score=1.2),
        "undecided_smooth": make(agreement=Agreement(0.009, 0.008, 0.02), score=1.2),
        "undecided_sliding": make(covariance=result.registration.covariance * 1e4),  # type: ignore[operator]
        "repeated": make(Context(4.1, 0.3, 1.1, -3.8, 3)),
        "supported": make(Context(2.2, 3.3, 1.0, 1.1, 1), score=2.2),
        "unusual_heights": make(Context(4.1, 1.9, 3.2, 0.0, 1)),
        "masked": make(T_database_query=None, nothing_trusted=True, score=0.0),
    }


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_every_card(size: tuple[int, int]) -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    viewer = Viewer(load_dataset(demo_path()), PipelineParams(), port=0, source=str(demo_path()))
    folder = Path(tempfile.mkdtemp(prefix="walk-cards-"))
    try:
        with launch(executable) as browser:
            page = ViewerPage(browser, viewer.url, size=SIZES[0])
            page.page.set_viewport_size({"width": size[0], "height": size[1]})
            page.page.wait_for_timeout(2000)
            session = viewer.sessions[0]
            card = session.pair._verdict
            state, found = card._result  # type: ignore[misc]

            def take(name: str) -> None:
                page.page.wait_for_timeout(600)
                page.page.screenshot(path=str(folder / f"{name}.png"))
                verdict = page.page.get_by_test_id("card")
                inside = "node => node.scrollHeight <= node.clientHeight + 1"
                assert verdict.evaluate(inside), f"{name}: the card is cut"

            for name, result in states(found, state.params).items():
                card.show(state, result)
                take(name)
            pair = state.compared_pair
            card.show(state, found)
            for name, accepted in (("by_hand_refused", False), ("by_hand_accepted", True)):
                card.decide(with_verdict(Decisions(), pair, accepted))
                take(name)
            page.page.get_by_text("Figures", exact=True).click()
            take("figures")
            print(f"\n{folder}")
            assert page.errors == []
    finally:
        viewer.close()
