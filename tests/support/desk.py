"""A desk without a session, which records what a feature asks for."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import viser

from app.viewer.features.desk import Desk, Feature
from app.viewer.server.limits import READ_ALL, Permissions
from app.viewer.session.decisions import Decisions
from app.viewer.session.jobs import Capacity
from app.viewer.session.news import SessionState, Verdicts
from app.viewer.session.session_file import Opened
from app.viewer.session.state import ViewState
from gpgrad_core.detection import DetectionResult
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import LoopClosure, PairOfIds


class Recorder(Feature):
    """Records every state, what was opened, and what was decided."""

    def __init__(self) -> None:
        self.states: list[ViewState] = []
        self.datasets: list[Opened] = []
        self.decisions: list[Decisions] = []

    def on_state(self, before: SessionState, state: SessionState) -> None:
        self.states.append(state.view)
        if opened := state.opened_since(before):
            self.datasets.append(opened)
        if state.decisions is not before.decisions:
            self.decisions.append(state.decisions)


def make_desk(
    server: viser.ViserServer,
    state: ViewState,
    recorder: Recorder | None = None,
    permissions: Permissions = READ_ALL,
) -> Desk:
    """Make a desk; the recorder receives everything."""
    desk = Desk(server, state, Memo(), Capacity(), permissions)
    desk.join(recorder or Recorder())
    return desk


def rests(feature: Feature) -> bool:
    """Wait until the session of a feature does nothing."""
    desk: Desk = vars(feature)["_desk"]
    return desk.wait_idle(120)


def go_to(desk: Desk, view: ViewState) -> None:
    """Have a desk show another state."""
    desk.update(lambda now: replace(now, view=view))


def judge(
    desk: Desk, closures: Iterable[LoopClosure], outcomes: Mapping[PairOfIds, str] | None = None
) -> None:
    """Tell of verdicts on all pairs."""
    found = DetectionResult(tuple(closures), {})
    verdicts = Verdicts(desk.state, desk.state.params, found, outcomes or {})
    desk.update_pairs(lambda pairs: pairs._replace(verdicts=verdicts))
