import threading
from dataclasses import replace
from functools import partial

import pytest
import viser

from app.viewer.features.desk import Feature
from app.viewer.session.decisions import with_verdict
from app.viewer.session.news import SessionState
from app.viewer.session.session_file import Opened
from app.viewer.session.state import Probe, open_dataset, registered
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from tests.support.desk import Recorder, make_desk
from tests.support.synthetic import make_dataset, needing
from tests.support.waiting import PATIENCE, until

STATE = open_dataset(make_dataset(num_points=100), PipelineParams())


def test_each_change_reaches_every_feature_once_and_in_order(server: viser.ViserServer) -> None:
    first, second = Recorder(), Recorder()
    desk = make_desk(server, STATE, first)
    assert desk.join(second) is second
    desk.change(pair=("002", "001"))
    desk.change(params=needing(7))
    desk.change(match=3, probe=Probe("query", 0.0, 0.0))
    desk.change(probe=None)
    desk.change(options=registered(STATE.options))
    assert first.states == second.states
    assert [state.query_id for state in first.states] == ["002"] * 5
    assert [state.asked == needing(7) for state in first.states] == [False] + [True] * 4
    assert [state.match for state in first.states] == [0, 0, 3, 3, 3]
    assert [state.probe is None for state in first.states] == [True, True, False, True, True]
    assert desk.state is first.states[-1]
    assert desk.state.options.layout == "registered"


def test_two_decisions_at_once_end_in_one_order_for_all(server: viser.ViserServer) -> None:
    begun, go = threading.Event(), threading.Event()

    class Slow(Recorder):
        def on_state(self, before: SessionState, state: SessionState) -> None:
            super().on_state(before, state)
            begun.set()
            assert go.wait(PATIENCE)

    first, second = Slow(), Recorder()
    desk = make_desk(server, STATE, first)
    desk.join(second)
    accept, refuse = (
        partial(desk.decide, partial(with_verdict, pair=("002", "001"), accepted=accepted))
        for accepted in (True, False)
    )
    older = threading.Thread(target=accept)
    older.start()
    assert begun.wait(PATIENCE)
    newer = threading.Thread(target=refuse)  # while the first feature takes the older one
    newer.start()
    until(lambda: desk.now.decisions.verdicts == {("002", "001"): False}, "the newer")
    assert newer.is_alive()  # it returns once all know
    go.set()
    newer.join(PATIENCE)
    assert len(first.decisions) == len(second.decisions) == 2
    older.join(PATIENCE)
    for recorder in (first, second):
        decided = [accepted for one in recorder.decisions for accepted in one.verdicts.values()]
        assert decided == [True, False]


def test_what_a_feature_changes_is_told_after_what_it_was_told(
    server: viser.ViserServer, caplog: pytest.LogCaptureFixture
) -> None:
    class Rash(Feature):
        def on_state(self, before: SessionState, state: SessionState) -> None:
            if state is before:
                desk.change(match=1)
                raise RuntimeError("no such node")

    recorder = Recorder()
    desk = make_desk(server, STATE)
    desk.join(Rash())
    desk.join(recorder)
    desk.tell_again()
    assert [state.match for state in recorder.states] == [0, 1]
    assert "Rash could not take the news" in caplog.text  # the others were told nevertheless


def test_a_refused_change_changes_nothing(server: viser.ViserServer) -> None:
    recorder = Recorder()
    desk = make_desk(server, STATE, recorder)
    with pytest.raises(InputError, match="no submap"):
        desk.change(pair=("999", "000"))
    assert desk.state is STATE
    assert recorder.states == []


def test_a_pair_that_has_gone_changes_nothing_and_is_told(server: viser.ViserServer) -> None:
    recorder = Recorder()
    desk = make_desk(server, STATE, recorder)
    desk.choose("999", "000")
    assert desk.state is STATE
    desk.choose("000", "999")
    assert recorder.states == [STATE, STATE]
    desk.choose("002", "001")
    assert (desk.state.query_id, desk.state.database_id) == ("002", "001")


def test_another_dataset_keeps_the_view(server: viser.ViserServer) -> None:
    recorder = Recorder()
    desk = make_desk(server, STATE, recorder)
    desk.change(options=replace(STATE.options, dark=True))
    opened = Opened(make_dataset(num_points=100, name="other"), needing(3), "/data/other")
    desk.open(opened)
    assert recorder.datasets == [opened]
    assert (desk.state.dataset.name, desk.state.asked) == ("other", needing(3))
    assert desk.state.options.dark
