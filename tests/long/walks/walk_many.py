# ruff: noqa: T201 - prints a table
"""A walk over hundreds of submaps: every job of the viewer, and how long it froze.

``GPGRAD_MANY`` is the number of submaps (300), or a dataset. The browser draws in software on the
same processors, so the times are upper bounds. *Page* is the longest task of the page's own thread,
and *server* the longest time in which a thread of the server's process did not get its turn.
"""

import os
import tempfile
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

import pytest

from app.viewer.viewer import Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import MOST_LOADED, load_dataset
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import num_workers
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.simulate import simulate_into
from tests.browser.chromium import ViewerPage, find_chromium, launch

pytestmark = pytest.mark.browser
LONGEST = 1.0
"""[s]"""
SIZE = (1280, 900)
POINTS = 2000
TASKS = """
window.longest = 0;
new PerformanceObserver(list => {
  for (const one of list.getEntries()) window.longest = Math.max(window.longest, one.duration);
}).observe({type: "longtask"});
"""


class Pulse:
    """A thread that wakes a hundred times a second, and notes when it was late."""

    def __init__(self) -> None:
        self.longest = 0.0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)

    def _beat(self) -> None:
        last = time.monotonic()
        while not self._ended.wait(0.01):
            now = time.monotonic()
            self.longest, last = max(self.longest, now - last - 0.01), now

    @contextmanager
    def beating(self) -> Generator[None]:
        self._thread.start()
        try:
            yield
        finally:
            self._ended.set()
            self._thread.join()


class Walk:
    """A page, and how long each job took and froze."""

    def __init__(self, page: ViewerPage, viewer: Viewer, pulse: Pulse, folder: Path) -> None:
        self.page, self.viewer, self.pulse, self.folder = page, viewer, pulse, folder
        self.rows: list[tuple[str, float, float, float]] = []

    def do(self, job: str, act: Callable[[], object], done: Callable[[], bool]) -> None:
        """Do a job, wait until it is done, and take a picture."""
        self.pulse.longest = 0.0
        self.page.page.evaluate("window.longest = 0")
        start = time.monotonic()
        act()
        self.page.wait(done, job, timeout=1800.0)
        spent = time.monotonic() - start
        self.page.page.wait_for_timeout(300)
        frozen = float(self.page.page.evaluate("window.longest")) / 1000
        self.rows.append((job, spent, frozen, self.pulse.longest))
        print(f"| {job} | {spent:.1f} | {frozen:.2f} | {self.pulse.longest:.2f} |", flush=True)
        name = f"{len(self.rows):02d}_{job.replace(' ', '_')}.png"
        self.page.page.screenshot(path=str(self.folder / name))

    def idle(self) -> bool:
        """Whether the viewer has nothing to do."""
        return self.viewer.wait_idle(0.01)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    asked = os.environ.get("GPGRAD_MANY", "300")
    if not asked.isdigit():
        return Path(asked)
    folder = tmp_path_factory.mktemp("many") / "roaming"
    params = SimulationParams(num_submaps=int(asked), max_points=POINTS, route="roaming")
    with workers(num_workers(), int(asked)) as executor:
        simulate_into(folder, params, executor=executor)
    return folder


def test_every_job(dataset: Path) -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    folder = Path(tempfile.mkdtemp(prefix="walk-many-"))
    loaded = load_dataset(dataset, most_bytes=MOST_LOADED)
    kept = Store(folder / "kept")  # empty, as for a user's first look
    viewer = Viewer(loaded, PipelineParams(), port=0, source=str(dataset), store=kept)
    pulse = Pulse()
    print(f"\n{len(loaded.submaps)} submaps; pictures in {folder}")
    print("| job | seconds | page [s] | server [s] |\n|---|---|---|---|")
    try:
        with pulse.beating(), launch(executable) as browser:
            start = time.monotonic()
            page = ViewerPage(browser, viewer.url, size=SIZE, script=TASKS)
            print(f"| first picture and verdict | {time.monotonic() - start:.1f} | | |")
            _walk(Walk(page, viewer, pulse, folder))
            assert page.errors == []
    finally:
        viewer.close()


def _walk(walk: Walk) -> None:
    page = walk.page
    walk.page.wait(walk.idle, "the best pair", timeout=600)
    walk.do("length-scale", lambda: page.drag("Length-scale", 25), walk.idle)
    walk.do("variance mask", lambda: page.drag("Variance mask", -15), walk.idle)
    walk.do("layer gradient", lambda: page.choose("Layer", "gradient"), walk.idle)
    walk.do("next query", lambda: page.key("j"), walk.idle)
    walk.do(
        "Explore", lambda: page.press("Explore"), lambda: "submaps" in page.say("world-summary")
    )
    walk.page.wait(walk.idle, "the world", timeout=600)
    walk.do("colour by gradient", lambda: page.choose("Colour by", "gradient"), walk.idle)
    walk.do("back to Tune", lambda: page.press("Tune"), walk.idle)
    page.tab("All pairs")
    matrix = page.page.locator("[data-testid^=affinity-]")
    page.choose("Compare with", "the 10 best")
    walk.do(
        "run all pairs",
        lambda: page.press("Run all pairs"),
        lambda: walk.idle() and matrix.count() > 0,
    )
    walk.do("a cell of the matrix", matrix.first.click, walk.idle)
    page.tab("Triage")
    walk.do("accept by key", lambda: page.key("a"), walk.idle)
    page.press("Explore")
    page.tab("Pose graph")
    walk.do("find closures", lambda: page.press("Find closures"),
            lambda: walk.idle() and "closures accepted" in page.say("graph-summary"))  # fmt: skip
    walk.do("optimise", lambda: page.press("Optimise"),
            lambda: walk.idle() and bool(page.say("graph-result")))  # fmt: skip
    late = [row for row in walk.rows if max(row[2:]) > LONGEST]
    assert not late, late
