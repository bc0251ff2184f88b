import threading
from bisect import bisect

import pytest

from app.viewer.features.desk import Desk
from app.viewer.features.params import sensitivity as module
from app.viewer.features.params.sensitivity import (
    SensitivityTool,
    Tried,
    finer,
    in_words,
    strip_of,
    values_of,
)
from app.viewer.features.params.tab import MAIN_PARAMETERS
from app.viewer.session.jobs import Lane
from app.viewer.session.state import ViewState, open_dataset, with_params
from gpgrad_core.detection import PairResult, PipelineParams
from gpgrad_core.params import parameters_of, with_path
from gpgrad_core.run import Progress
from tests.support.synthetic import NUMBERS, FakePipeline, make_dataset, make_result
from tests.support.waiting import until

FIELDS = {field.path: field for field in parameters_of(PipelineParams)}
START = with_path(with_path(NUMBERS, "map.length_scale", 0.3), "map.noise_std", 0.02)
STATE = open_dataset(make_dataset(), START)


def judge(state: ViewState) -> PairResult:
    """More inliers for a longer length-scale."""
    return make_result(state, num_inliers=int(20 * (state.params.map.length_scale or 0)))


@pytest.fixture
def pipeline(monkeypatch: pytest.MonkeyPatch) -> FakePipeline:
    fake = FakePipeline(judge)
    monkeypatch.setattr(module, "register_pair", fake)
    return fake


@pytest.fixture
def tool(desk: Desk, pipeline: FakePipeline) -> SensitivityTool:
    del pipeline
    return desk.join(SensitivityTool(desk, MAIN_PARAMETERS, lambda path: path))


@pytest.fixture
def background(monkeypatch: pytest.MonkeyPatch) -> None:
    """A page is there, and a hand has rested for long enough at once."""
    monkeypatch.setattr(module, "pages", lambda _: {0: None})  # type: ignore[reportUnknownLambdaType]
    monkeypatch.setattr(module, "IDLE_S", 0.02)


def resolve(desk: Desk) -> None:
    """Take the numbers that there are for what is automatic."""
    desk.resolve(desk.state, desk.state.params)


def in_background(tool: SensitivityTool) -> Lane[ViewState, None]:
    return vars(tool)["_background"]


@pytest.mark.parametrize("path", tuple(MAIN_PARAMETERS)[:4])
def test_values_span_the_slider_and_hold_the_present_one(path: str) -> None:
    bounds = FIELDS[path].bounds
    assert bounds is not None
    current = 0.1234
    values = values_of(FIELDS[path], current)
    assert values == tuple(sorted(set(values)))
    assert current in values
    assert 10 <= len(values) <= 16
    assert values[0] == pytest.approx(bounds.slider_range[0], abs=bounds.step)
    assert values[-1] == pytest.approx(bounds.slider_range[1], abs=bounds.step)
    for value in values:
        bounds.check(path, value)
    assert values_of(FIELDS[path], None)


def test_over_decades_the_values_are_spaced_in_their_logarithm() -> None:
    values = values_of(FIELDS["map.length_scale"], 0.3)
    assert values[1] - values[0] < 0.05 < values[-1] - values[-2]


def test_words_say_where_it_is_a_closure_and_what_was_tried() -> None:
    field = FIELDS["map.noise_std"]
    tried = [Tried(v, s, 5, s > 3) for v, s in ((0.1, 1.0), (0.2, 4.0), (0.3, 5.0), (0.4, 2.0))]
    lead, *each = in_words(field, tried).splitlines()
    assert lead.startswith(
        "It is a loop closure from 0.2 to 0.3 m. The highest score is 5.00, at 0.3 m."
    )
    assert each[0] == "0.1 m: score 1.00, 5 inliers, no loop closure"
    assert each[1] == "0.2 m: score 4.00, 5 inliers"
    assert in_words(field, tried[:1]).startswith("No value makes it a loop closure.")
    assert in_words(field, tried[1:3]).startswith("It is a loop closure at every value.")


def test_more_values_are_tried_where_the_verdict_changes() -> None:
    field = FIELDS["map.length_scale"]
    tried = {value: Tried(value, 4.0, 5, 0.21 < value < 1.4) for value in values_of(field, 0.3)}
    while (value := finer(field, tried.values())) is not None:
        tried[value] = Tried(value, 4.0, 5, 0.21 < value < 1.4)
    strip = strip_of(field, [tried[value] for value in sorted(tried)])
    assert strip.accepted == (False, True, False)
    assert strip.edges == pytest.approx((0.05, 0.21, 1.4, 2.0), rel=0.04)
    assert strip.hint.startswith("It is a loop closure from 0.2")
    assert len(tried) < 25


@pytest.mark.usefixtures("background")
def test_strips_agree_with_the_verdict(tool: SensitivityTool, desk: Desk) -> None:
    desk.change(params=with_path(START, "closure.min_inliers", 8))
    resolve(desk)
    assert in_background(tool).wait_idle(60)
    strip = desk.numbers.strips["map.length_scale"]
    assert not strip.stale
    for value in (0.1, 0.5, 1.9):
        state = with_params(STATE, with_path(desk.state.params, "map.length_scale", value))
        within = bisect(strip.edges, value) - 1
        assert strip.accepted[within] == judge(state).closure.accepted
    assert desk.numbers.strips["closure.min_inliers"].accepted == (True, False)
    assert desk.numbers.strips["closure.min_score"].hint.startswith("No value makes")
    desk.change(params=with_path(desk.state.params, "map.length_scale", 0.6))
    strips = desk.numbers.strips
    assert not strips["map.length_scale"].stale  # its own value says nothing about the others
    assert strips["closure.min_inliers"].stale


@pytest.mark.usefixtures("background")
def test_no_strip_is_made_while_a_hand_moves_or_others_work(
    tool: SensitivityTool, desk: Desk, pipeline: FakePipeline
) -> None:
    for inliers in (5, 6, 7):
        desk.change(params=with_path(START, "closure.min_inliers", inliers), moving=True)
        assert not in_background(tool).is_busy
    work = threading.Event()
    other: Lane[None, bool] = Lane(
        desk.jobs,
        lambda _job, _progress: work.wait(60),
        lambda _job, _result, _seconds: None,
        lambda _job, _error: None,
    )
    other.submit(None)
    lane, begun = in_background(tool), list[ViewState]()
    make = lane.work

    def count_and_make(state: ViewState, progress: Progress) -> None:
        begun.append(state)
        make(state, progress)

    lane.work = count_and_make
    desk.release(desk.state.params)
    resolve(desk)
    until(lambda: len(begun) > 2, "strips that give way more than once")
    assert pipeline.calls == []
    work.set()
    assert desk.wait_idle(60)  # which does not wait for strips
    assert in_background(tool).wait_idle(60)
    assert pipeline.calls
