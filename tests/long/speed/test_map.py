"""How smoothly the map of Explore moves, and what 1,000 submaps take.

Ten minutes, most of them to simulate. A page's own work is measured: nothing is drawn, as if a
graphics card did.
"""

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest

from app.viewer.features.session import Session
from app.viewer.viewer import Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import MOST_LOADED, load_dataset
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.threads import num_workers
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.simulate import simulate_into
from gpgrad_core.types import Dataset, LoopClosure, Registration
from tests.browser.chromium import ViewerPage, find_chromium, launch
from tests.support.desk import judge
from tests.support.widgets import find, user_presses

pytestmark = pytest.mark.browser

LEAST_RATE, MOST_MEMORY, LONGEST_FREEZE = 20.0, 1.5e9, 0.5  # [1/s], [bytes], [s]
SETTLED = PipelineParams(
    map=MapParams(length_scale=0.4, noise_std=0.02, signal_std=0.5, max_points=2000)
)
UNDRAWN = """() => {
    for (const name of ['drawArrays', 'drawElements', 'drawArraysInstanced',
                        'drawElementsInstanced']) {
        WebGL2RenderingContext.prototype[name] = () => {};
    }
}"""
"""Draws nothing, in place of a machine with a graphics card."""
PICTURES = """() => {
    window.moves = 0;
    const beat = () => { window.moves += 1; requestAnimationFrame(beat); };
    requestAnimationFrame(beat);
}"""
"""Counts pictures."""
BUDGET = 1_400_000_000
"""Of the viewer's memory; a browser's scripts have the rest of `MOST_MEMORY` [bytes]."""


def true_closures(dataset: Dataset) -> tuple[LoopClosure, ...]:
    """Close loops between submaps whose true positions are near, by their true motions."""
    posed = [(submap.id, submap.pose_true) for submap in dataset.submaps]
    made: list[LoopClosure] = []
    for later, (query, b) in enumerate(posed):
        for database, a in posed[: max(0, later - 1)]:
            if a is None or b is None or np.linalg.norm((a.translation - b.translation)[:2]) > 3.0:
                continue
            found = Registration(
                a.planar.inverse() @ b.planar,
                np.ones(20, bool),
                0.5,
                15.0,
                0.9,
                5.0,
                covariance=np.diag([0.02, 0.02, 0.005]) ** 2,
            )
            made.append(LoopClosure(query, database, found, True, "true"))
    return tuple(made)


def optimised(session: Session) -> Dataset:
    """Show the map, and correct it by true closures."""
    dataset = session.state.dataset
    closures = true_closures(dataset)
    assert closures
    judge(session.desk, closures)
    user_presses(find(session.desk.host, "Optimise"))
    assert session.wait_idle(300)
    return dataset


def test_before_to_after_is_smooth(real_data: Path) -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    path = real_data / "marsyard2021"
    viewer = Viewer(load_dataset(path), SETTLED, port=0, source=str(path))
    try:
        with launch(executable) as browser:
            page = ViewerPage(browser, viewer.url, size=(1440, 900))
            page.press("Explore")
            session = viewer.sessions[0]
            assert session.wait_idle(300)
            optimised(session)
            graph = session.pose_graph.graph
            assert graph is not None
            move = session.world.scene.mover()
            page.page.evaluate(UNDRAWN)
            page.page.evaluate(PICTURES)
            page.page.wait_for_timeout(500)
            shares = np.linspace(0.0, 1.0, 100)
            before, start = page.page.evaluate("window.moves"), time.monotonic()
            for share in shares:
                move(graph.at(float(share)))
            served = len(shares) / (time.monotonic() - start)
            page.page.wait_for_timeout(100)
            pictures = page.page.evaluate("window.moves") - before
            shown = pictures / (time.monotonic() - start)
            count = len(session.state.dataset.submaps)
            terrain = session.world.scene.terrain
            assert terrain is not None
            print(
                f"{count} submaps, {len(terrain.positions):,} cells: {served:.0f} moves a "
                f"second served, {shown:.0f} pictures a second in the page"
            )
            assert served >= LEAST_RATE
            assert shown >= LEAST_RATE
    finally:
        viewer.close()


@pytest.fixture
def thousand(tmp_path: Path) -> Path:
    """Give the dataset in GPGRAD_MANY, or simulate 1,000 submaps, as `gpgrad simulate` does."""
    asked = os.environ.get("GPGRAD_MANY")
    if asked:
        return Path(asked)
    params = SimulationParams(num_submaps=1000, max_points=2000, route="roaming")
    with workers(num_workers(), params.num_submaps) as executor:
        simulate_into(tmp_path / "thousand", params, executor=executor)
    return tmp_path / "thousand"


def busiest(trace: Path) -> float:
    """Give the processor time of the longest task of a page's own thread [s]."""
    events = json.loads(trace.read_text())["traceEvents"]
    pages = {
        (event["pid"], event["tid"])
        for event in events
        if event["name"] == "thread_name" and event["args"]["name"] == "CrRendererMain"
    }
    times = [
        event["tdur"]
        for event in events
        if (event["pid"], event["tid"]) in pages and "RunTask" in event["name"] and "tdur" in event
    ]
    assert times
    return max(times) / 1e6


def test_a_thousand_submaps_are_a_map(thousand: Path, tmp_path: Path) -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    dataset = load_dataset(thousand, most_bytes=MOST_LOADED)
    viewer = Viewer(dataset, PipelineParams(), port=0, source=str(thousand), memory=BUDGET)
    session = viewer.sessions[0]
    held: list[int] = []
    try:
        with launch(executable) as browser:
            page = ViewerPage(browser, viewer.url, size=(1440, 900))
            page.page.evaluate(UNDRAWN)
            browser.start_tracing(page=page.page, path=tmp_path / "trace", categories=["toplevel"])
            start = time.monotonic()
            page.press("Explore")
            figures = page.page.get_by_test_id("world-figures")
            count = f"{len(dataset.submaps):,}"
            page.wait(lambda: count in figures.inner_text(), "the map", timeout=300)
            first = time.monotonic() - start
            while not session.wait_idle(0.2):
                held.append(viewer._memory.measure())  # pyright: ignore[reportPrivateUsage]
            done = time.monotonic() - start
            page.page.wait_for_timeout(3000)
            browser.stop_tracing()
            heap = page.page.evaluate("performance.memory.usedJSHeapSize")
            freeze = busiest(tmp_path / "trace")
    finally:
        viewer.close()
    print(
        f"{count} submaps: map after {first:.1f} s, all maps inferred after {done:.0f} s; longest "
        f"task of the page {freeze:.2f} s; memory of the viewer at most {max(held) / 1e9:.2f} GB, "
        f"of the page's scripts {heap / 1e9:.2f} GB"
    )
    assert max(held) + heap < MOST_MEMORY
    assert freeze < LONGEST_FREEZE
