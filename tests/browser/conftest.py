"""One browser for all cases, and viewers of the built-in demo."""

import os
from collections.abc import Callable, Generator, Iterator
from functools import partial
from typing import Any

import pytest

from app.viewer.viewer import Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run.store import Store
from gpgrad_core.simulation.demo import demo_path

QUICK = PipelineParams(map=MapParams(max_points=1500, resolution=0.2))
"""Few points and large cells: software rendering draws every one of them."""
FAILED = pytest.StashKey[bool]()
"""Whether a test has failed since the file's page was opened."""


def unavailable(why: str) -> None:
    """Skip, or fail where the browser was promised."""
    if os.environ.get("GPGRAD_REQUIRE_BROWSER") == "1":
        pytest.fail(f"{why}, and GPGRAD_REQUIRE_BROWSER is 1")
    pytest.skip(f"{why}: install Debian's chromium, or name one in GPGRAD_CHROMIUM")


@pytest.fixture(scope="session")
def start_browser() -> Iterator[Callable[..., object]]:
    """Start browsers with further flags, from one driver: a process can have no second one."""
    try:
        from playwright.sync_api import sync_playwright  # noqa: PLC0415

        from tests.browser.chromium import find_chromium, launch_in  # noqa: PLC0415
    except ModuleNotFoundError as error:
        unavailable(f"{error.name} is not installed")
        return
    executable = find_chromium()
    if executable is None:
        unavailable("no Chromium was found")
        return
    with sync_playwright() as playwright:
        yield partial(launch_in, playwright, executable)


@pytest.fixture(scope="session")
def browser(start_browser: Callable[..., object]) -> Iterator[object]:
    with start_browser() as launched:  # type: ignore[attr-defined]
        yield launched


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, Any]:
    """Note that a test has failed: nobody knows how it left the page."""
    report = yield
    if report.failed:
        item.config.stash[FAILED] = True
    return report


@pytest.fixture
def open_viewer(browser: object) -> Iterator[Callable[..., object]]:
    """Serve the demo and open a page on it; all end with the fixture, and must be clean."""
    yield from serve(browser)


def serve(browser: object) -> Iterator[Callable[..., object]]:
    """Do so for any scope."""
    from tests.browser.chromium import ViewerPage  # noqa: PLC0415

    viewers: list[Viewer] = []
    pages: list[ViewerPage] = []

    def start(params: PipelineParams = QUICK, **settings: object) -> ViewerPage:
        viewer = Viewer(
            load_dataset(demo_path()), params, port=0, source=str(demo_path()), store=Store()
        )
        viewers.append(viewer)
        settings = {"pixel_ratio": 0.5, **settings}
        pages.append(ViewerPage(browser, viewer.url, **settings))  # type: ignore[arg-type]
        pages[-1].viewer = viewer  # type: ignore[attr-defined]
        return pages[-1]

    yield start
    for page in pages:
        page.close()
    for viewer in viewers:
        viewer.close()
    for page in pages:
        page.check()


@pytest.fixture(scope="module")
def demo(browser: object) -> Iterator[object]:
    """One page of one viewer a file, because opening takes seconds; tests ask for `page`."""
    opening = serve(browser)
    yield next(opening)()
    assert next(opening, None) is None


@pytest.fixture
def page(demo: Any, request: pytest.FixtureRequest) -> Iterator[object]:
    """The file's page as a person finds it, who has pressed nothing yet but undo."""
    if request.config.stash.get(FAILED, False):
        request.config.stash[FAILED] = False
        demo.errors.clear()
        demo.open()
    demo.begin_again(QUICK)
    yield demo
    demo.check()
