import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import viser

from app.viewer.features.pair import status
from app.viewer.features.pairs.best_pair import BestPair
from app.viewer.features.pairs.matrix import OPEN_PAIR
from app.viewer.features.session import Session
from app.viewer.features.work import message_of
from app.viewer.scene.layers import OVERLAP
from app.viewer.session import methods
from app.viewer.session.session_file import Opened, session_text
from app.viewer.session.state import NEEDS_TWO, Probe, ViewOptions, ViewState
from app.viewer.widgets.bridge import Act, Bridge
from app.viewer.widgets.html import GOOD_GROUND
from gpgrad_core.detection import PairResult, PipelineParams, is_resolved, resolve_parameters
from gpgrad_core.detection.pipeline import COARSER
from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import write_dataset
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run import Progress
from gpgrad_core.run.memo import Memo
from tests.support.desk import changes, uses
from tests.support.synthetic import FakePipeline, make_dataset, make_result, needing
from tests.support.waiting import PATIENCE, until
from tests.support.widgets import find, node, said, user_presses, user_sets

START = needing(8)
OPENED = Opened(make_dataset(num_points=400), START, "", None, START)


def test_it_opens_at_a_revisit_with_a_verdict(session: Session, gui: viser.ViserServer) -> None:
    assert (session.state.query_id, session.state.database_id) == ("003", "000")
    assert "Loop closure" in said(gui, "verdict")
    assert "Up to date" in said(gui, "status")
    assert "Gradient" in said(gui, "legend")
    until(lambda: not any(one.name == "job" for one in threading.enumerate()), "rest")
    # Of new pages, before a motion is known: both submaps are in view.
    own = replace(session.state, options=replace(session.state.options, raw_frames=True))
    camera = session.pair.scene.camera(own)
    assert gui.initial_camera.position == pytest.approx(camera.position)
    assert gui.initial_camera.look_at == pytest.approx(camera.look_at)


def test_each_message_of_a_page_has_one_listener(
    open_session: Callable[..., Session],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    names, hear = list[str](), Bridge.hear

    def listen(bridge: Bridge, name: str, act: Act) -> None:
        names.append(name)
        hear(bridge, name, act)

    monkeypatch.setattr(Bridge, "hear", listen)
    open_session(OPENED.dataset)
    assert OPEN_PAIR in names
    assert len(names) == len(set(names))


def test_minimum_inliers_turns_the_verdict_and_reset_turns_it_back(
    session: Session, gui: viser.ViserServer, pipeline: FakePipeline
) -> None:
    uses(session, "Minimum inliers", 20)
    assert "No loop closure" in said(gui, "verdict")
    uses(session, "Reset parameters")
    assert "No loop closure" not in said(gui, "verdict")
    assert find(gui, "Minimum inliers").value == START.closure.min_inliers
    assert pipeline.calls[-1] == START


@pytest.mark.parametrize(("late", "faded"), [(0.0, True), (60.0, False)])
def test_a_gp_slider_shows_coarse_surfaces_first(
    session: Session,
    gui: viser.ViserServer,
    pipeline: FakePipeline,
    monkeypatch: pytest.MonkeyPatch,
    late: float,
    faded: bool,
) -> None:
    monkeypatch.setattr(status, "LATE", late)
    monkeypatch.setattr(status, "LONG", 600.0)
    before: list[tuple[str, str, float]] = []

    def make(state: ViewState) -> PairResult:
        surface: Any = node(gui, "/pair/query/surface")
        line, card = said(gui, "status"), said(gui, "verdict")
        before.append((line, card, surface.point_size))
        return make_result(state)

    pipeline.make = make
    uses(session, "Length-scale", 0.5)
    line, card, size = before[0]  # then automatic numbers are fitted anew
    assert "Coarse picture" in line
    assert ("opacity:.4" in card) == faded  # the last verdict fades if it would stand too long
    assert size == pytest.approx(OVERLAP * COARSER * START.map.resolution)
    assert "Up to date" in said(gui, "status")
    assert "opacity:.4" not in said(gui, "verdict")


def test_sliders_of_later_stages_need_no_coarse_surfaces(
    session: Session,
    gui: viser.ViserServer,
    pipeline: FakePipeline,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("NOTICED", "LATE", "LONG"):  # on a busy machine all may take long
        monkeypatch.setattr(status, name, 600.0)
    before: list[str] = []

    def make(state: ViewState) -> PairResult:
        before.append(said(gui, "status"))
        return make_result(state)

    pipeline.make = make
    for name, value in (("Inlier radius", 0.6), ("Minimum inliers", 20), ("Minimum score", 9.0)):
        uses(session, name, value)
    assert len(before) == 3
    assert not any("shown" in line or "Coarse" in line for line in before)


def test_what_takes_long_is_announced_though_it_reports_nothing(
    session: Session, gui: viser.ViserServer, pipeline: FakePipeline
) -> None:
    announced: list[bool] = []

    def make(state: ViewState) -> PairResult:
        until(lambda: "Computing" in said(gui, "status"), "the announcement")
        announced.append(True)
        return make_result(state)

    pipeline.make = make
    uses(session, "Minimum inliers", 20)
    assert announced == [True]
    assert "Up to date" in said(gui, "status")


def test_an_error_is_told_and_the_next_slider_works(
    session: Session, gui: viser.ViserServer, pipeline: FakePipeline
) -> None:
    pipeline.error = InputError("003 spans 10,000 m x 10,000 m: raise the resolution")
    uses(session, "Length-scale", 0.5)
    assert "raise the resolution" in said(gui, "status")
    assert "out of date" in said(gui, "status")
    assert "Loop closure" in said(gui, "verdict")  # the last good one stays
    pipeline.error = None
    uses(session, "Length-scale", 0.6)
    assert "Up to date" in said(gui, "status")


def test_an_unexpected_error_is_told_and_logged(
    session: Session,
    gui: viser.ViserServer,
    pipeline: FakePipeline,
    caplog: pytest.LogCaptureFixture,
) -> None:
    pipeline.error = ZeroDivisionError("division by zero")
    uses(session, "Noise [m]", 0.1)
    assert "Unexpected ZeroDivisionError: division by zero" in said(gui, "status")
    assert "unexpected error" in caplog.text
    assert message_of(InputError("plain words")) == "plain words"


def test_a_dataset_is_opened(session: Session, gui: viser.ViserServer, tmp_path: Path) -> None:
    other = replace(make_dataset(num_points=300, name="other hills"), description="Smaller.")
    other = replace(other, submaps=other.submaps[:3])
    write_dataset(other, tmp_path / "other")
    user_sets(find(gui, "Minimum inliers"), 30)
    user_sets(find(gui, "Folder"), str(tmp_path / "other"))
    uses(session, "Open", "Load")
    assert len(session.state.dataset.submaps) == 3
    assert [submap.id for submap in session.state.dataset.submaps] == ["000", "001", "002"]
    default = PipelineParams().closure.min_inliers  # the other dataset prefers none
    assert find(gui, "Minimum inliers").value == default
    assert "Up to date" in said(gui, "status")


def test_one_submap_is_no_pair(session: Session, gui: viser.ViserServer, tmp_path: Path) -> None:
    hills = make_dataset(num_points=300)
    write_dataset(replace(hills, submaps=hills.submaps[:1]), tmp_path / "one")
    user_sets(find(gui, "Folder"), str(tmp_path / "one"))
    uses(session, "Open", "Load")
    assert NEEDS_TWO in said(gui, "verdict")
    assert "Up to date" in said(gui, "status")
    assert len(node(gui, "/pair/query/surface").points) > 0
    assert node(gui, "/pair/query").visible
    assert not node(gui, "/pair/database").visible
    desk = session.desk
    for options in ({"layout": "registered"}, {"layer": "difference"}, {"compare": "blink"}):
        desk.change(options=replace(desk.state.options, **options))  # type: ignore[arg-type]
        assert session.wait_idle(20)
        assert "Up to date" in said(gui, "status")
        assert not node(gui, "/pair/database").visible
    desk.choose("000", "000")
    changes(session, probe=Probe("query", 0.2, 0.1))
    assert "submap 000" in said(gui, "reading")
    user_presses(find(gui, "Run all pairs"))
    user_sets(find(gui, "Move the query"), True)
    user_sets(find(gui, "Note"), "here")
    (best_pair,) = (feature for feature in desk.features if isinstance(feature, BestPair))
    best_pair.show_best()
    assert session.wait_idle(20)
    assert desk.now.decisions.pairs == ()
    for name in ("all-pairs-error", "nudge-message", "triage-message", "best-pair"):
        assert NEEDS_TWO in said(gui, name), name
    # Another cloud makes a pair of it.
    desk.change(options=ViewOptions())
    write_dataset(replace(hills, submaps=hills.submaps[:2]), tmp_path / "two")
    user_sets(find(gui, "Folder"), str(tmp_path / "two"))
    uses(session, "Open", "Load")
    assert node(gui, "/pair/database").visible
    assert NEEDS_TWO not in said(gui, "verdict")


def test_hiding_the_surfaces_hides_the_legend(session: Session, gui: viser.ViserServer) -> None:
    uses(session, "Surfaces", False)
    assert "Elevation" not in said(gui, "legend")


def test_a_fit_moves_the_sliders_and_the_picture(
    session: Session, gui: viser.ViserServer, pipeline: FakePipeline
) -> None:
    fitted: dict[str, Any] = {"length_scale": 0.62, "noise_std": 0.02, "signal_std": 0.4}
    params = session.state.params
    changes(session, params=replace(params, map=replace(params.map, **fitted)))
    assert find(gui, "Length-scale").value == 0.62
    assert find(gui, "Noise [m]").value == 0.02
    assert not find(gui, "Auto relief").value
    assert pipeline.calls[-1].map.signal_std == 0.4
    assert session.state.params.map.resolution == START.map.resolution


@pytest.fixture
def automatic(open_session: Callable[..., Session]) -> Callable[[], Session]:
    return lambda: open_session(make_dataset(num_points=150), PipelineParams())


@pytest.fixture
def held_fit(monkeypatch: pytest.MonkeyPatch) -> tuple[threading.Event, threading.Event]:
    """Hold each fit until the first event; the second tells that it has begun."""
    go, begun = threading.Event(), threading.Event()

    def fit(submaps: Any, params: PipelineParams, memo: Memo, progress: Progress) -> PipelineParams:
        begun.set()
        while not go.wait(0.005):
            progress(0.5)
        return resolve_parameters(submaps, params, memo, progress)

    monkeypatch.setattr(methods, "resolve_parameters", fit)
    return go, begun


def test_automatic_is_the_fitted_number_in_box_and_picture(
    automatic: Callable[[], Session], server: viser.ViserServer, pipeline: FakePipeline
) -> None:
    session = automatic()
    assert session.wait_idle(60)
    fitted = resolve_parameters(session.state.dataset.submaps, PipelineParams())
    box, slider = find(server, "Auto length-scale"), find(server, "Length-scale")

    def shown() -> tuple[bool, float, PipelineParams, str]:
        assert session.wait_idle(60)
        assert "Up to date" in said(server, "status")
        return box.value, slider.value, pipeline.calls[-1], find(server, "Preset").value

    at_first = shown()
    assert at_first == (True, fitted.map.length_scale, fitted, "default")
    user_sets(box, False)
    ticked, number, used, preset = shown()
    assert (ticked, number, preset) == (False, fitted.map.length_scale, "custom")
    assert used.map.length_scale == number
    user_sets(box, True)
    assert shown() == at_first
    user_sets(slider, 0.9)
    ticked, number, used, _ = shown()
    assert (ticked, number) == (False, 0.9)
    asked = PipelineParams(map=MapParams(length_scale=0.9))
    assert session.state.asked == asked
    assert used == resolve_parameters(session.state.dataset.submaps, asked)
    user_sets(find(server, "Noise factor"), 1.5)  # a part of the noise, set by hand
    shown()
    assert pipeline.calls[-1].map.noise_factor == 1.5
    assert not find(server, "Auto noise").value
    user_presses(find(server, "Reset parameters"))
    assert shown() == at_first
    assert 'length_scale = "automatic"' in session_text(session.state, None)


def test_it_is_not_up_to_date_before_the_fit_is_done(
    automatic: Callable[[], Session],
    server: viser.ViserServer,
    pipeline: FakePipeline,
    held_fit: tuple[threading.Event, threading.Event],
) -> None:
    go, begun = held_fit
    session = automatic()
    assert begun.wait(20)
    assert pipeline.calls == []
    assert "Up to date" not in said(server, "status")
    go.set()
    assert session.wait_idle(60)
    assert "Up to date" in said(server, "status")
    assert all(is_resolved(params) for params in pipeline.calls)
    # Once there are fitted numbers, they stand in for those that another value gives.
    go.clear()
    begun.clear()
    fitted = pipeline.calls[-1]
    user_sets(find(server, "Length-scale"), 0.9)
    assert begun.wait(20)
    assert pipeline.calls[-1].map == replace(fitted.map, length_scale=0.9)
    assert "Loop closure" in said(server, "verdict")
    assert "Fitting automatic numbers" in said(server, "status")
    go.set()
    assert session.wait_idle(60)
    asked = PipelineParams(map=MapParams(length_scale=0.9))
    assert pipeline.calls[-1] == resolve_parameters(session.state.dataset.submaps, asked)
    assert "Up to date" in said(server, "status")


def test_the_card_has_a_colour_only_while_it_tells_of_what_is_set(
    automatic: Callable[[], Session],
    server: viser.ViserServer,
    pipeline: FakePipeline,
    held_fit: tuple[threading.Event, threading.Event],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    go, begun = held_fit
    go.set()

    def is_coloured() -> bool:
        card, figures = said(server, "card"), said(server, "figures")
        parts = {GOOD_GROUND in card, "grayscale" not in card, "grayscale" not in figures}
        assert len(parts) == 1  # they are of one result
        return parts.pop()

    monkeypatch.setattr(status, "LATE", 0.0)
    session = automatic()
    assert session.wait_idle(PATIENCE)
    assert is_coloured()
    go.clear()
    begun.clear()
    user_sets(find(server, "Length-scale"), 0.9)
    assert begun.wait(PATIENCE)
    assert "fitting …" in said(server, "card")
    assert "Loop closure" in said(server, "card")
    assert not is_coloured()
    seen: list[str] = []

    def make(state: ViewState) -> PairResult:
        seen.append(said(server, "card"))
        return make_result(state)

    pipeline.make = make
    registered = replace(session.state.options, layout="registered")  # it has no preview
    session.desk.change(pair=("002", "000"), options=registered)
    until(lambda: seen and "fitting …" in said(server, "card"), "the other pair")
    assert "Loop closure" not in seen[0]  # of another pair
    user_presses(find(server, "Undo"))
    until(lambda: not session.state.asked.map.length_scale, "the undone value")
    go.set()
    assert session.wait_idle(PATIENCE)
    assert is_coloured()


def test_a_fit_that_fails_is_told(
    automatic: Callable[[], Session],
    server: viser.ViserServer,
    pipeline: FakePipeline,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fit(*_: object) -> PipelineParams:
        raise InputError("submap 000 gives no noise_std")

    monkeypatch.setattr(methods, "resolve_parameters", fit)
    session = automatic()
    assert session.wait_idle(20)
    assert "gives no noise_std" in said(server, "status")
    assert pipeline.calls == []
