"""What a dataset opens on: a true loop closure within seconds of the first picture.

It measures time: run it on a quiet machine.
"""

import time
from pathlib import Path

import pytest
import viser

from app.viewer.features.desk import Feature
from app.viewer.features.session import Session
from app.viewer.session.jobs import Capacity
from app.viewer.session.news import PairNews, PairShown
from app.viewer.session.session_file import Opened
from app.viewer.session.state import ViewState
from gpgrad_core.detection import PairResult, PipelineParams, resolve_parameters
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.params import preferred_parameters
from gpgrad_core.run.helper import start_helper
from gpgrad_core.run.memo import Memo
from gpgrad_core.simulation.demo import demo_path

LATEST = 3.0
"""After the first picture [s]."""
OFF = 0.5
"""A motion that is further from the true one is wrong [m]."""


class Watch(Feature):
    """Notes when what was shown."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self.shown: list[tuple[float, ViewState, PairResult]] = []

    def on_pair_result(self, news: PairNews) -> None:
        """Note it."""
        if isinstance(news, PairShown):
            self.shown.append((time.monotonic(), news.state, news.result))


@pytest.mark.parametrize("name", ["demo", "marsyard2021", "sthelens", "apollo15"])
def test_it_opens_on_a_true_closure(name: str, real_data: Path, server: viser.ViserServer) -> None:
    dataset = load_dataset(demo_path() if name == "demo" else real_data / name)
    memo = Memo()
    params = resolve_parameters(
        dataset.submaps, preferred_parameters(dataset, PipelineParams()), memo
    )
    helper = start_helper()
    watch = Watch()
    session = Session(server, Opened(dataset, params, ""), memo, Capacity(helper=helper))
    session.desk.join(watch)
    try:
        assert session.wait_idle(60)
    finally:
        session.close()
        if helper is not None:
            helper.close()
    first = watch.shown[0][0]
    at, state, result = next(one for one in watch.shown if one[2].closure.accepted)
    motion, (query, database) = result.registration.T_database_query, (state.query, state.database)
    assert motion is not None
    assert query.pose_true is not None
    assert database.pose_true is not None
    true = database.pose_true.planar.inverse() @ query.pose_true.planar
    assert abs(true.x - motion.x) + abs(true.y - motion.y) < OFF
    assert at - first < LATEST, f"{at - first:.1f} s after the first picture"
    assert watch.shown[-1][2].closure.accepted
