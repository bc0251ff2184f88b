"""Eight pages on one session, one dragging; and fifty, all dragging.

Pages speak the viewer's protocol without a browser, so that what is measured is the server.
"""

import asyncio
import random
import resource
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from urllib.request import urlopen

import msgspec
import pytest
import viser
from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from app.viewer.features.params.tab import MAIN_PARAMETERS
from app.viewer.viewer import Sharing, Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.params import get_path
from gpgrad_core.simulation.demo import demo_path
from tests.long.soak.pages import MAIN, MORE, SoakPage, any_value
from tests.long.soak.watch import Served
from tests.support.page import CAMERA, ProtocolPage

PAGES = 8
EVENTS = 200
SECONDS = 2.0
PARAMS = PipelineParams(map=MapParams(max_points=5000, resolution=0.06))

CROWD = 50
DRAGGING = 120.0
"""Seconds."""
LAST_DRAGGING = 5.0
"""Seconds that the pages drag on whose last values are compared."""
THROTTLE = 0.05
"""Seconds between two values of a page: what viser's page keeps to."""
NEWCOMERS_EVERY = 3.0
"""Seconds."""
MOST_WAIT = 2.0
"""Until a newcomer has all of its page [s]."""
LOST = 30.0
"""A last value that nobody has seen after so long is lost [s]."""
BUDGET = 800
"""Of the viewer, as ``--memory`` says it [MB]."""

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


class DraggingPage:
    """A page that drags, and reads what it is sent as fast as a browser would, but not into it."""

    def __init__(self, observer: SoakPage, label: str, number: int) -> None:
        self.label = label
        self.value = 0.0
        self.is_lost = False
        self._observer, self._rng = observer, random.Random(number)
        self._uuid = observer.find(label)["uuid"]

    async def enter(self, url: str) -> None:
        self._socket = await connect_to(url)
        await self._socket.send(msgspec.msgpack.encode(CAMERA))
        self._reading = asyncio.create_task(self._read())

    async def leave(self) -> None:
        self.is_lost = self._reading.done()
        await self._socket.close()
        await self._reading

    async def drag(self, until: float) -> None:
        await asyncio.sleep(self._rng.random() * THROTTLE)
        while time.monotonic() < until:
            self.value = any_value(self._observer, self.label, self._rng)
            updates = {"value": self.value}
            message = {"type": "GuiUpdateMessage", "uuid": self._uuid, "updates": updates}
            await self._socket.send(msgspec.msgpack.encode(message))
            await asyncio.sleep(THROTTLE)

    async def _read(self) -> None:
        async for _ in self._socket:
            pass


async def connect_to(url: str) -> ClientConnection:
    return await connect(
        url.replace("http", "ws"),
        origin=Origin(url),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        max_size=None,
        compression=None,
        open_timeout=300,
    )


def come_new(url: str) -> float:
    """Open a page; says how long it takes until all widgets and pictures are there [s]."""
    start = time.monotonic()
    with urlopen(url, timeout=300) as page:
        page.read()
    newcomer = ProtocolPage(url)
    newcomer.wait(lambda: "ReplayDoneMessage" in kinds(newcomer), "all of it", timeout=300)
    took = time.monotonic() - start
    newcomer.close()
    return took


def kinds(page: ProtocolPage) -> list[str]:
    return [kind for _, kind in page.received]


async def drag_together(
    served: Served, observer: SoakPage
) -> tuple[list[float], list[float], Sequence[DraggingPage]]:
    """Give how long newcomers waited, and how long last values took to be seen [s]."""
    labels = [label for label in (*MAIN, *MORE) if observer.can(label)]
    pages = [
        DraggingPage(observer, labels[number % len(labels)], number) for number in range(CROWD)
    ]
    for page in pages:
        await page.enter(served.url)
    waits: list[float] = []
    end = time.monotonic() + DRAGGING
    dragging = asyncio.gather(*(page.drag(end) for page in pages))
    while time.monotonic() < end:
        waits.append(await asyncio.to_thread(come_new, served.url))
        await asyncio.sleep(NEWCOMERS_EVERY)
    await dragging
    # Of pages that drag the same slider the last wins. So those that drag others rest together.
    lags: list[float] = []
    for first in range(0, CROWD, len(labels)):
        group = pages[first : first + len(labels)]
        end = time.monotonic() + LAST_DRAGGING
        await asyncio.gather(*(page.drag(end) for page in group))
        start = time.monotonic()
        for page in group:
            while observer.find(page.label)["value"] != page.value:
                lag = time.monotonic() - start
                assert lag < LOST, f"the last value of {page.label} was lost"
                await asyncio.sleep(0.01)
            lags.append(time.monotonic() - start)
    for page in pages:
        await page.leave()
    return waits, lags, pages


def test_fifty_pages_that_drag_hold_up_nobody(tmp_path: Path) -> None:
    served = Served("crowd", f"{BUDGET}MB", tmp_path)
    try:
        observer = SoakPage(served.url)
        observer.wait(lambda: "Up to date" in observer.html(), "a picture")
        waits, lags, pages = asyncio.run(drag_together(served, observer))
        served.stop_watching()
        most = max(sample.memory for sample in served.samples)
        print(
            f"\n{CROWD} pages drag for {DRAGGING:.0f} s: {len(waits)} new pages waited "
            f"{statistics.median(waits):.2f} s (median), {max(waits):.2f} s (most). {len(lags)} "
            f"last values were seen within {max(lags):.2f} s. {most:.0f} MB at most, of "
            f"{BUDGET} MB."
        )
        assert not any(page.is_lost for page in pages)
        assert max(waits) <= MOST_WAIT
        assert most <= 1.1 * BUDGET
        observer.close()
        served.end()
    finally:
        served.process.kill()
