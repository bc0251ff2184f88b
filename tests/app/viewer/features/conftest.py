"""What the tests of features share: a desk at the ``STATE`` of their module, and sessions."""

from collections.abc import Callable, Iterator

import pytest
import viser

from app.viewer.features.desk import Desk
from app.viewer.features.pair import tab as pair_module
from app.viewer.features.session import Session
from app.viewer.session.runner import Capacity
from app.viewer.session.session_file import Opened, SavedSession
from gpgrad_core.detection import PipelineParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Dataset
from tests.support.desk import Recorder, make_desk
from tests.support.synthetic import NUMBERS, FakePipeline


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


@pytest.fixture
def desk(server: viser.ViserServer, recorder: Recorder, request: pytest.FixtureRequest) -> Desk:
    return make_desk(server, request.module.STATE, recorder)


@pytest.fixture
def pipeline(monkeypatch: pytest.MonkeyPatch) -> FakePipeline:
    """Stand in for what registers the pair that is shown."""
    fake = FakePipeline()
    monkeypatch.setattr(pair_module, "register_pair", fake)
    return fake


@pytest.fixture
def open_session(server: viser.ViserServer) -> Iterator[Callable[..., Session]]:
    """Open sessions on the server, which end with the test."""
    sessions: list[Session] = []

    def start(
        dataset: Dataset, params: PipelineParams = NUMBERS, saved: SavedSession | None = None
    ) -> Session:
        opened = Opened(dataset, params, "", saved, None if params == PipelineParams() else params)
        sessions.append(Session(server, opened, Memo(), Capacity()))
        return sessions[-1]

    yield start
    for session in sessions:
        session.close()
