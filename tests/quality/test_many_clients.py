"""Eight pages on one session, one dragging 200 events in 2 s. By hand, with -s.

    GPGRAD_SHAPE_CHECKS=0 pytest tests/quality/test_many_clients.py -n 0 -s

Pages speak the viewer's protocol without a browser, so that what is measured is the server.
"""

import resource
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

import pytest

from app.viewer.features.params.tab import MAIN_PARAMETERS
from app.viewer.viewer import Sharing, Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.params.fields import get_path
from gpgrad_core.simulation.demo import demo_path
from tests.support.page import ProtocolPage

PAGES = 8
EVENTS = 200
SECONDS = 2.0
PARAMS = PipelineParams(map=MapParams(max_points=5000, resolution=0.06))

SURFACE = ("/pair/query/surface.points", "/query/surface.points")

Serve = Callable[[Sharing], Viewer]
Visit = Callable[[Viewer], ProtocolPage]


@pytest.fixture
def serve() -> Iterator[Serve]:
    viewers: list[Viewer] = []

    def start(sessions: Sharing) -> Viewer:
        dataset = load_dataset(demo_path())
        viewers.append(Viewer(dataset, PARAMS, port=0, source=str(demo_path()), sessions=sessions))
        return viewers[-1]

    yield start
    for viewer in viewers:
        viewer.close()


@pytest.fixture
def visit() -> Iterator[Visit]:
    pages: list[ProtocolPage] = []

    def enter(viewer: Viewer) -> ProtocolPage:
        pages.append(ProtocolPage(viewer.url))
        pages[-1].wait(lambda: "Up to date" in pages[-1].html(), "a picture", timeout=60)
        return pages[-1]

    yield enter
    for page in pages:
        with suppress(OSError):
            page.close()


def drag(viewer: Viewer, page: ProtocolPage, label: str, values: list[float]) -> None:
    """Send one event after the other, in `SECONDS` together, and wait until all were taken."""
    start = time.monotonic()
    for number, value in enumerate(values):
        page.set(label, value)
        time.sleep(max(0.0, start + SECONDS * (number + 1) / len(values) - time.monotonic()))
    (session, *_) = viewer.sessions
    path = next(path for path, name in MAIN_PARAMETERS.items() if name == label)
    page.wait(lambda: get_path(session.state.params, path) == values[-1], "the last value")


def settle(viewer: Viewer, pages: list[ProtocolPage]) -> None:
    """Wait until all that was sent has been computed, and has arrived."""
    time.sleep(1.0)  # the undo's step is told when the slider has rested
    assert viewer.wait_idle(120)
    counts: list[int] = []
    while counts != (counts := [len(page.received) for page in pages]):
        time.sleep(0.3)


def pictures(page: ProtocolPage, since: float) -> list[float]:
    """Say when the page was told of another surface of the query."""
    return [when for when, what in page.received if what in SURFACE and when > since]


def resident_megabytes() -> float:
    """Peak memory of this process [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def test_eight_pages_end_in_the_same_state(serve: Serve, visit: Visit) -> None:
    viewer = serve("shared")
    before = resident_megabytes()
    pages = [visit(viewer) for _ in range(PAGES)]
    entered = resident_megabytes()
    values = [round(0.2 + 0.2 * number / EVENTS, 2) for number in range(EVENTS)]
    start = time.monotonic()
    drag(viewer, pages[0], "Length-scale", values)
    settle(viewer, pages)
    (session,) = viewer.sessions
    assert session.state.params.map.length_scale == values[-1]
    first = pages[0].seen()
    for number, page in enumerate(pages[1:], start=1):
        other = page.seen()
        assert set(other) == set(first)
        different = [name for name in first if first[name] != other[name]]
        assert not different, f"page {number} sees another {different[0]}"
    shown = [pictures(page, start) for page in pages]
    assert all(len(times) >= 5 for times in shown)
    # The pages' delay behind the first: how far the eighth lags.
    lag = [abs(a - b) for times in shown[1:] for a, b in zip(shown[0], times, strict=False)]
    late = visit(viewer)
    settle(viewer, [*pages, late])
    told = late.seen()
    assert all(told[name] == value for name, value in pages[0].seen().items())
    for page in pages[1:5]:
        page.close()  # in the middle of the next drag, as far as they know
    drag(viewer, pages[0], "Minimum score", [float(number % 10) for number in range(50)])
    settle(viewer, [pages[0], pages[7]])
    assert pages[0].seen() == pages[7].seen()
    print(
        f"\n{PAGES} pages, {EVENTS} events in {SECONDS:.0f} s: {len(shown[0])} pictures; pages "
        f"see one within {1000 * statistics.median(lag):.0f} ms of each other (median), "
        f"{1000 * max(lag):.0f} ms (most). Server's peak memory {before:.0f} MB before, "
        f"{entered:.0f} MB with all pages, {resident_megabytes():.0f} MB after."
    )
