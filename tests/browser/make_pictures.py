"""Take the README's pictures from the viewer itself: ``python -m tests.browser.make_pictures``."""

import io
import sys
from pathlib import Path

from PIL import Image

from app.server import Viewer
from gpgrad_core.datasets import demo_path, load_dataset
from tests.browser.chromium import ViewerPage, find_chromium, launch

PICTURES = Path(__file__).resolve().parents[2] / "assets" / "pictures"
SIZE = (1360, 800)
MAX_BYTES = 300_000


def save(page: ViewerPage, name: str) -> None:
    """Take the window as it is, small, and with colours as true as the legend's.

    Raises:
        ValueError: If the picture is too large all the same.
    """
    page.page.mouse.move(SIZE[0] / 2, SIZE[1] - 5)  # no tooltip in the way
    page.settle()
    page.page.wait_for_timeout(500)
    picture = Image.open(io.BytesIO(page.page.screenshot())).convert("RGB")
    path = PICTURES / name
    picture.save(path, quality=90, subsampling=0, optimize=True)
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size:,} bytes, more than {MAX_BYTES:,}")


def main() -> int:
    """Take all pictures."""
    executable = find_chromium()
    if executable is None:
        print("no Chromium found; name one in GPGRAD_CHROMIUM")  # noqa: T201
        return 2
    PICTURES.mkdir(parents=True, exist_ok=True)
    viewer = Viewer(load_dataset(demo_path()), port=0, source=str(demo_path().name))
    with launch(executable) as browser:
        page = ViewerPage(browser, viewer.url, size=SIZE)
        save(page, "side_by_side.jpg")
        page.tick("Surfaces")
        page.tick("Point clouds")
        save(page, "point_clouds.jpg")
        page.tick("Surfaces")
        page.tick("Point clouds")
        page.choose("Layer", "gradient")
        save(page, "gradient.jpg")
        page.choose("Layout", "registered")
        page.choose("Layer", "elevation")
        save(page, "registered.jpg")
        page.choose("Layout", "side by side")
        page.type_value("Minimum inliers", "40")
        page.choose("Query", "004")
        page.tick("Outlier lines")
        page.choose("Layer", "standard deviation")
        save(page, "no_loop_closure.jpg")
        page.close()
    viewer.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
