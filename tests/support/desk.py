"""A desk without a session, which records what a feature asks for."""

import viser

from app.viewer.features.desk import Desk, Feature
from app.viewer.server.limits import READ_ALL, Permissions
from app.viewer.session.runner import Capacity
from app.viewer.session.session_file import Opened
from app.viewer.session.state import ViewState
from gpgrad_core.run.memo import Memo


class Recorder(Feature):
    """Records every state, and what was opened."""

    def __init__(self) -> None:
        self.states: list[ViewState] = []
        self.datasets: list[Opened] = []

    def follow(self, state: ViewState) -> None:
        self.states.append(state)

    def opened(self, opened: Opened) -> None:
        self.datasets.append(opened)


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
