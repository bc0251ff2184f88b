"""How smoothly the map of Explore moves, and what 1,000 submaps take.

Run by hand: ``GPGRAD_DATA=... pytest tests/quality/test_map.py -n 0 -s``; some minutes. The browser
draws in software, so that its times are an upper bound for one with a graphics card.
"""

import resource
import time
from pathlib import Path

import numpy as np
import pytest

from app.viewer.features.session import Session
from app.viewer.viewer import Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset, LoopClosure, Registration
from tests.browser.chromium import ViewerPage, find_chromium, launch
from tests.support.synthetic import make_submap
from tests.support.widgets import find, user_presses

pytestmark = pytest.mark.browser

LEAST_RATE, MOST_MEMORY, LONGEST_FREEZE = 20.0, 1.5e9, 0.5  # [1/s], [bytes], [s]
SETTLED = PipelineParams(
    map=MapParams(length_scale=0.4, noise_std=0.02, signal_std=0.5, max_points=2000)
)
FREEZES = """
window.freezes = [];
new PerformanceObserver(list => {
    for (const task of list.getEntries()) window.freezes.push(task.duration);
}).observe({entryTypes: ['longtask']});
"""
"""Notes how long the page's thread was busy at a stretch [ms]."""
PICTURES = """() => {
    window.moves = 0;
    for (const name of ['drawArrays', 'drawElements', 'drawArraysInstanced',
                        'drawElementsInstanced']) {
        WebGL2RenderingContext.prototype[name] = () => {};
    }
    const beat = () => { window.moves += 1; requestAnimationFrame(beat); };
    requestAnimationFrame(beat);
}"""
"""Counts pictures, without drawing in software: in place of a machine with a graphics card."""


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
    session.desk.tell(lambda feature: feature.judged(dataset, closures, session.state.params))
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
            print(
                f"{count} submaps, {session.world.scene.num_cells:,} cells: {served:.0f} moves a "
                f"second served, {shown:.0f} pictures a second in the page"
            )
            assert served >= LEAST_RATE
            assert shown >= LEAST_RATE
    finally:
        viewer.close()


def thousand() -> Dataset:
    """Submaps along forty rounds of a circle, with odometry that drifts."""
    submaps = []
    for k in range(1000):
        angle = 2 * np.pi * k / 25
        radius = 20.0 + 0.05 * k
        pose = SE2(radius * np.cos(angle), radius * np.sin(angle), angle + np.pi / 2)
        submaps.append(make_submap(f"{k:04d}", pose, 3000, side=8.0))
    return Dataset("thousand", tuple(submaps))


def test_a_thousand_submaps_are_a_map() -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    viewer = Viewer(thousand(), SETTLED, port=0, source="")
    try:
        with launch(executable) as browser:
            page = ViewerPage(browser, viewer.url, size=(1440, 900), script=FREEZES)
            page.page.evaluate("window.freezes = []")
            start = time.monotonic()
            page.press("Explore")
            figures = page.page.get_by_test_id("world-figures")
            page.wait(lambda: "1,000" in figures.inner_text(), "the map", timeout=120)
            first = time.monotonic() - start
            session = viewer.sessions[0]
            assert session.wait_idle(600)
            done = time.monotonic() - start
            page.page.wait_for_timeout(3000)
            freeze = max(page.page.evaluate("window.freezes"), default=0.0) / 1000
            heap = page.page.evaluate("performance.memory.usedJSHeapSize")
            peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            print(
                f"1,000 submaps: map after {first:.1f} s, all maps inferred after {done:.0f} s; "
                f"longest freeze of the page {freeze:.2f} s; memory of the viewer {peak / 1e9:.2f} "
                f"GB at most, of the page's scripts {heap / 1e9:.2f} GB"
            )
            assert peak + heap < MOST_MEMORY
            assert freeze < LONGEST_FREEZE
    finally:
        viewer.close()
