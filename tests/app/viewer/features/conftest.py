"""What the tests of features share: a desk at the ``STATE`` of their module, and sessions."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest
import viser

from app.viewer.features.desk import Desk
from app.viewer.features.pair import tab as pair_module
from app.viewer.features.session import Session
from app.viewer.session.jobs import Capacity
from app.viewer.session.session_file import Opened
from app.viewer.session.state import ViewOptions
from gpgrad_core.detection import PipelineParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Dataset
from tests.support.desk import Recorder, changes, make_desk
from tests.support.server import started_server
from tests.support.synthetic import NUMBERS, FakePipeline
from tests.support.widgets import find, user_sets


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


@pytest.fixture
def desk(
    server: viser.ViserServer, recorder: Recorder, request: pytest.FixtureRequest
) -> Iterator[Desk]:
    made = make_desk(server, request.module.STATE, recorder)
    yield made
    made.close()


@pytest.fixture
def pipeline(monkeypatch: pytest.MonkeyPatch) -> FakePipeline:
    """Stand in for what registers the pair that is shown."""
    fake = FakePipeline()
    monkeypatch.setattr(pair_module, "register_pair", fake)
    return fake


@pytest.fixture(scope="module")
def shared(request: pytest.FixtureRequest) -> Iterator[tuple[viser.ViserServer, Session]]:
    """One session, on the ``OPENED`` of a module, for most of its tests: making one takes long."""
    with pytest.MonkeyPatch.context() as patch, started_server() as server:
        patch.setattr(pair_module, "register_pair", FakePipeline())
        session = Session(server, request.module.OPENED, Memo(), Capacity())
        yield server, session
        session.close()


@pytest.fixture
def gui(shared: tuple[viser.ViserServer, Session]) -> viser.ViserServer:
    """The server of the shared session."""
    return shared[0]


@pytest.fixture
def session(
    shared: tuple[viser.ViserServer, Session],
    pipeline: FakePipeline,  # noqa: ARG001
    request: pytest.FixtureRequest,
) -> Session:
    """The shared session as it was when it was opened."""
    server, session = shared
    user_sets(find(server, "Mode"), "Tune")
    opened = request.module.OPENED
    session.desk.open(replace(opened, dataset=replace(opened.dataset)))  # so it is another one
    changes(session, options=ViewOptions())
    return session


@pytest.fixture
def open_session(
    server: viser.ViserServer,
    pipeline: FakePipeline,  # noqa: ARG001
) -> Iterator[Callable[..., Session]]:
    """Open sessions on the server, which end with the test."""
    sessions: list[Session] = []

    def start(dataset: Dataset, params: PipelineParams = NUMBERS) -> Session:
        opened = Opened(dataset, params, "", None, None if params == PipelineParams() else params)
        sessions.append(Session(server, opened, Memo(), Capacity()))
        return sessions[-1]

    yield start
    for session in sessions:
        session.close()
