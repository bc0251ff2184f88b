import threading
import time
from bisect import bisect

import pytest
import viser

from app.viewer.features.desk import Desk
from app.viewer.features.params import sensitivity as module
from app.viewer.features.params.sensitivity import (
    SensitivityTool,
    Tried,
    finer,
    strip_of,
    summary,
    sweep_html,
    values_of,
)
from app.viewer.features.params.tab import MAIN_PARAMETERS, SWEPT
from app.viewer.session.jobs import Lane
from app.viewer.session.state import ViewState, open_dataset, with_params
from app.viewer.widgets.commands import Commands
from gpgrad_core.detection import PairResult, PipelineParams
from gpgrad_core.params import parameters_of, with_path
from tests.support.desk import rests
from tests.support.synthetic import NUMBERS, FakePipeline, make_dataset, make_result
from tests.support.widgets import find, html_says, user_presses, user_sets

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
    commands = Commands(desk.host)
    return desk.join(SensitivityTool(desk, commands, MAIN_PARAMETERS, SWEPT, lambda path: path))


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


@pytest.mark.parametrize("path", SWEPT)
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


def test_the_summary_says_where_it_is_a_closure() -> None:
    tried = [Tried(v, s, 5, s > 3) for v, s in ((0.1, 1.0), (0.2, 4.0), (0.3, 5.0), (0.4, 2.0))]
    assert summary(tried, "m") == (
        "It is a loop closure from 0.2 to 0.3 m. The highest score is 5.00, at 0.3 m."
    )
    assert summary(tried[:1], "").startswith("No value makes it a loop closure.")
    assert summary(tried[1:3], "m").startswith("It is a loop closure at every value.")


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
    assert desk.numbers.strips["closure.min_score"].hint == "No value makes it a loop closure."
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
    desk.release(desk.state.params)
    resolve(desk)
    time.sleep(0.2)
    assert in_background(tool).is_busy
    assert pipeline.calls == []
    work.set()
    assert desk.wait_idle(60)  # which does not wait for strips
    assert in_background(tool).wait_idle(60)
    assert pipeline.calls


def test_the_picture_says_each_value_in_words_and_escapes_names() -> None:
    tried = [Tried(0.1, 1.0, 3, False), Tried(0.2, 4.0, 9, True)]
    content = sweep_html(FIELDS["map.noise_std"], "<i>Noise", tried, current=0.15, threshold=3.0)
    assert "<i>Noise" not in content
    assert "0.1 m: score 1.0, 3 inliers, no loop closure. Click to set it." in content
    assert 'data-testid="sweep-now"' in content
    assert content.count("<circle") == 2


def test_no_verdict_on_all_values_before_all_were_tried() -> None:
    tried = [Tried(0.1, 4.0, 3, True), Tried(0.2, 4.0, 9, True)]
    field = FIELDS["map.noise_std"]
    content = sweep_html(field, "Noise", tried, current=None, threshold=3.0, num_left=13)
    assert "2 of 15 values so far." in content
    assert "at every value" not in content


def test_a_sweep_is_drawn_and_a_click_sets_the_value(
    tool: SensitivityTool, desk: Desk, server: viser.ViserServer, pipeline: FakePipeline
) -> None:
    user_presses(find(server, "Sweep"))
    assert rests(tool)
    picture = tool.picture
    assert "loop closure" in picture.content
    assert {params.map.noise_std for params in pipeline.calls} == {0.02}
    assert len({params.map.length_scale for params in pipeline.calls}) == len(pipeline.calls) >= 10
    value = pipeline.calls[-1].map.length_scale
    assert value is not None
    html_says(desk.bridge, "sweep-value", value=value)
    assert desk.state.params.map.length_scale == value
    assert "Sweep again" not in picture.content  # the others are as they were
    html_says(desk.bridge, "sweep-value", value=123.0)
    html_says(desk.bridge, "sweep-value", value="1")
    assert desk.state.params.map.length_scale == value


def test_what_changes_meanwhile_is_told(
    tool: SensitivityTool, desk: Desk, server: viser.ViserServer
) -> None:
    user_presses(find(server, "Sweep"))
    assert rests(tool)
    desk.change(params=with_path(desk.state.params, "map.noise_std", 0.05))
    assert "Sweep again" in tool.picture.content
    desk.change(pair=(STATE.database_id, STATE.query_id))
    assert tool.picture.content == ""


def test_another_parameter_begins_anew(tool: SensitivityTool, server: viser.ViserServer) -> None:
    user_presses(find(server, "Sweep"))
    assert rests(tool)
    user_sets(find(server, "Of"), "Noise")
    assert tool.picture.content == ""
