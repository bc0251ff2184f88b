"""A desk without a session, which records what a feature asks for."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import viser

from app.viewer.features.desk import Desk, Feature
from app.viewer.features.session import Session
from app.viewer.server.limits import READ_ALL, Permissions
from app.viewer.session.decisions import Decisions
from app.viewer.session.jobs import Capacity
from app.viewer.session.news import SessionState, Verdicts
from app.viewer.session.session_file import Opened
from app.viewer.session.state import ViewState
from gpgrad_core.detection import DetectionResult
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import LoopClosure, PairOfIds
from tests.support.waiting import PATIENCE
from tests.support.widgets import find, user_sets


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


def desk_of(user: Any) -> Desk:
    """Find the desk of a session or a feature; a desk is its own."""
    return user if isinstance(user, Desk) else vars(user).get("desk") or vars(user)["_desk"]


def rests(user: Session | Feature) -> bool:
    """Wait until a session, or that of a feature, does nothing."""
    return desk_of(user).wait_idle(PATIENCE)


def uses(user: Session | Desk | Feature, label: str, value: object = True) -> None:
    """Use a widget as a person does, and wait for all that follows."""
    user_sets(find(desk_of(user).host, label), value)
    assert desk_of(user).wait_idle(PATIENCE)


def changes(user: Session | Desk | Feature, **what: Any) -> None:
    """Change what is shown, and wait for all that follows."""
    desk_of(user).change(**what)
    assert desk_of(user).wait_idle(PATIENCE)


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
    assert desk.wait_idle(PATIENCE)
