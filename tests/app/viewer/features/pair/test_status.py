import itertools
import time
from collections.abc import Iterator

import pytest
import viser

from app.viewer.features.pair import status as module
from app.viewer.features.pair.status import (
    CANCEL,
    HEIGHT,
    STAGE_OF,
    PictureStatus,
    TimedMemo,
    stages_text,
)
from app.viewer.session.jobs import Jobs
from app.viewer.session.state import open_dataset
from app.viewer.widgets.bridge import Bridge
from gpgrad_core.detection import PipelineParams, register_pair
from gpgrad_core.detection.pipeline import infer_quick_map
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run import silent
from gpgrad_core.run.memo import Memo
from tests.support.synthetic import make_dataset
from tests.support.widgets import html_says, said


def test_the_time_goes_to_stages_and_to_none_twice(monkeypatch: pytest.MonkeyPatch) -> None:
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


class Made:
    """A status, and what it asked for."""

    def __init__(self, server: viser.ViserServer) -> None:
        self.server, self.bridge = server, Bridge(server)
        self.asked: list[str] = []
        cancel, late = (lambda word=word: self.asked.append(word) for word in ("cancel", "late"))
        self.jobs = Jobs()
        self.status = PictureStatus(server, self.bridge, self.jobs, Memo(), cancel, late)

    @property
    def shown(self) -> str:
        assert f"height:{HEIGHT}em" in said(self.server, "status")  # whatever it says
        return said(self.server)


@pytest.fixture
def made(server: viser.ViserServer) -> Iterator[Made]:
    made = Made(server)
    yield made
    made.jobs.close()


def test_the_status_line_says_whether_the_picture_is_current(made: Made) -> None:
    made.status.preview(0.1, coarse=True)
    assert "Coarse picture · refining …" in made.shown
    made.status.finished(0.123, "5,000 cells", newer_waits=False)
    assert "Up to date · 5,000 cells" in made.shown
    assert 'title="123 ms"' in made.shown
    made.status.finished(0.2, "5 cells", newer_waits=True)
    assert "Computing … (shown: the picture before)" in made.shown
    made.status.failed("too wide " * 50)
    assert "The picture is out of date" in made.shown
    assert "too wide" in made.shown
    assert stages_text({"map": 0.12, "matching": 0.0001}) == "map 120 ms"
    assert stages_text({}) == ""


def test_long_work_has_a_bar_and_is_cancelled(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("NOTICED", "LONG", "LATE"):
        monkeypatch.setattr(module, name, 0.0)
    report = made.status.reported(silent)
    report(0.2)
    assert "Cancel computing" not in made.shown  # nothing is being computed
    made.status.begin()
    report(0.4)
    assert "Computing …" in made.shown
    assert "Cancel computing" in made.shown
    assert "width:40%" in made.shown
    html_says(made.bridge, CANCEL)
    assert made.asked == ["late", "cancel"]
    made.status.cancelled()
    assert "Cancel computing" not in made.shown
    assert "out of date" in made.shown


def test_a_refusal_outlives_the_next_picture(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    made.status.finished(0.1, "12 cells", newer_waits=False)
    made.status.refused("Folder: may not be <img src=x>")
    made.status.refused("Noise must be from 0.001 to <b>10")
    made.status.preview(0.1, coarse=False)
    made.status.finished(0.1, "12 cells", newer_waits=False)
    assert "Not taken" in made.shown
    assert "Noise must be from 0.001 to &lt;b&gt;10 · Up to date · 12 cells" in made.shown
    assert "Folder" not in made.shown
    monkeypatch.setattr(module, "READ_WITHIN", 0.0)
    made.status.fitting(0.1)
    made.status.finished(0.1, "14 cells", newer_waits=False)
    assert "Up to date · 14 cells" in made.shown
    assert "Not taken" not in made.shown
