# ruff: noqa: T201 - tells where its pictures are
"""Pictures of datasets in every mode and size, to be looked at as a stranger would.

``python -m tests.long.pictures.make_looks FOLDER [DATASET …]`` writes them, with one sheet for each
size. Without datasets it takes the demo. The widest but one is taken in the light too.
"""

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from math import ceil
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser

from app.viewer.viewer import Viewer
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.simulation.demo import demo_path
from tests.browser.chromium import ViewerPage, find_chromium, launch

SIZES = ((1440, 900), (1280, 800), (1920, 1080), (1024, 768), (390, 844))
PATIENCE_S = 900.0
ACROSS = 2
"""Pictures side by side on a sheet."""


class Looks:
    """A page of a dataset, and what is written of it."""

    def __init__(self, page: ViewerPage, folder: Path, name: str) -> None:
        self._page, self._folder, self._name = page, folder, name
        self._patience = PATIENCE_S

    def take(self, state: str) -> None:
        """Take what is shown in all sizes, and once in the light; a talk never rests."""
        self._patience = 1.0 if "present" in state else PATIENCE_S
        for size in SIZES:
            self._page.resize(*size)
            self._rest()
            self._save(f"{size[0]}x{size[1]}", state)
            if size == SIZES[0]:
                self._choose("light")
                self._save("light", state)
                self._choose("dark")
        self._page.resize(*SIZES[0])
        self._rest()

    def _choose(self, theme: str) -> None:
        self._page.page.evaluate("theme => gpgradTheme.choose(theme)", theme)
        self._rest()

    def _rest(self) -> None:
        self._page.page.wait_for_timeout(800)
        self._page.viewer.wait_idle(self._patience)
        self._page.page.wait_for_timeout(1500)

    def _save(self, size: str, state: str) -> None:
        self._page.page.screenshot(path=str(self._folder / f"{self._name}-{size}-{state}.png"))


@contextmanager
def opened(browser: Browser, folder: Path) -> Generator[ViewerPage]:
    """Serve a dataset, and open a page on it."""
    viewer = Viewer(load_dataset(folder), port=0, source=str(folder))
    try:
        page = ViewerPage(browser, viewer.url, size=SIZES[0])
        page.viewer = viewer
        yield page
        page.close()
    finally:
        viewer.close()


def look_at(page: ViewerPage, looks: Looks) -> None:
    """Go through the modes."""
    acts: dict[str, Callable[[], object]] = {
        "1explore": lambda: page.press("Explore"),
        "2tune": lambda: page.press("Tune"),
        "3pairs": lambda: page.key("Shift+P"),
        "4present": lambda: (page.key("Shift+P"), page.press("Demo"), page.press("Present")),
    }
    for state, act in acts.items():
        act()
        looks.take(state)
    page.key("Escape")


def write_sheets(folder: Path, name: str) -> None:
    """Put the pictures of each size onto one sheet."""
    for size in ("light", *(f"{width}x{height}" for width, height in SIZES)):
        pictures = [Image.open(path) for path in sorted(folder.glob(f"{name}-{size}-*.png"))]
        width, height = pictures[0].size
        sheet = Image.new("RGB", (ACROSS * width, ceil(len(pictures) / ACROSS) * height))
        for k, picture in enumerate(pictures):
            sheet.paste(picture, (k % ACROSS * width, k // ACROSS * height))
        sheet.save(folder / f"sheet-{name}-{size}.png")


def main() -> int:
    """Take the pictures of all datasets that are named."""
    executable = find_chromium()
    if executable is None or len(sys.argv) < 2:
        print(__doc__ if executable else "no Chromium found; name one in GPGRAD_CHROMIUM")
        return 2
    folder, *sources = map(Path, sys.argv[1:])
    folder.mkdir(parents=True, exist_ok=True)
    with launch(executable) as browser:
        for source in sources or [demo_path()]:
            with opened(browser, source) as page:
                look_at(page, Looks(page, folder, source.name))
            write_sheets(folder, source.name)
            print(f"{folder}/sheet-{source.name}-*.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
