import itertools
import time

import pytest

from app.viewer.features.pair.status import STAGE_OF, TimedMemo
from app.viewer.session.state import open_dataset
from gpgrad_core.detection import PipelineParams, register_pair
from gpgrad_core.detection.pipeline import infer_quick_map
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run.memo import Memo
from tests.support.synthetic import make_dataset


def test_the_time_goes_to_known_stages_and_a_second_time_takes_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ticks = itertools.count()
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(ticks)))
    params = PipelineParams(map=MapParams(length_scale=0.3, noise_std=0.05, resolution=0.1))
    state = open_dataset(make_dataset(num_points=400), params)
    memo = Memo()
    first, second = TimedMemo(memo), TimedMemo(memo)
    start = time.perf_counter()
    infer_quick_map(state.query, params.map, first)
    once = register_pair(state.query, state.database, params, first)
    took = time.perf_counter() - start
    assert set(first.seconds) == {"map", "features", "matching", "registration"}
    assert set(first.seconds) <= set(STAGE_OF.values())  # every function is known by its name
    assert min(first.seconds.values()) > 0
    assert sum(first.seconds.values()) <= took  # nothing counts twice
    again = register_pair(state.query, state.database, params, second)
    assert again.registration is once.registration
    assert sum(second.seconds.values()) < sum(first.seconds.values())
    second.add("drawing", 0.25)
    assert second.seconds["drawing"] == 0.25
