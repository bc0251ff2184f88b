"""Take the pictures of README and guide: ``python -m tests.long.pictures.make_pictures``.

Those of real ground need the folder of its datasets in ``GPGRAD_DATA``.
Names take some alone: ``panels``, ``closure``, ``sliders``, ``drive``, ``talk_apollo15`` …
"""

import io
import os
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import Browser

from app.cli import run
from app.cli.demo import Demo
from app.viewer.features.pair.scene import PairScene
from app.viewer.scene.cameras import ease, set_start
from app.viewer.server.guard import open_server
from app.viewer.session.following import begin_drive
from app.viewer.session.state import ViewOptions, open_dataset
from app.viewer.viewer import Viewer
from gpgrad_core.detection import PipelineParams, register_pair
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.pages import PAGE
from gpgrad_core.params import preferred_parameters
from gpgrad_core.run.memo import Memo
from gpgrad_core.simulation.demo import demo_path, loop_params
from gpgrad_core.types import Matches
from tests.browser.chromium import MapPage, ViewerPage, find_chromium, launch

PICTURES = Path(__file__).resolve().parents[3] / "assets" / "pictures"
SIZE = (1360, 800)
MAX_BYTES = 300_000
MAX_FILM_BYTES = 1_500_000
FILM_SIZE = (760, 480)
FILM_CLIP: Any = {"x": 0, "y": 0, "width": 760, "height": 480}
SLIDERS = {
    "Length-scale": ("0.8", "1.5"),
    "Noise": ("0.1", "0.2"),
    "Variance mask": ("0.15", "0.05"),
    "Minimum inliers": ("100", "400"),
}
SLIDERS_SIZE = (1088, 640)
TALK = ("demo", "apollo15", "marsyard2021", "hillside", "sthelens")
"""Datasets whose likeliest pair is shown with the panels put away, as for a talk."""
MOMENTS = 32
LINES = 40
STEPS = 5
"""Of a talk without a corrected map."""


def save(page: ViewerPage, name: str, *, canvas_only: bool = False) -> None:
    """Take the window as it is, or what is free of panels; small, with colours as the legend's.

    Raises:
        ValueError: If the picture is too large all the same.
    """
    page.page.mouse.move(SIZE[0] / 2, SIZE[1] - 5)  # no tooltip in the way
    if page.page.get_by_test_id("status").is_visible():
        page.settle()
    page.page.wait_for_timeout(2000)
    clip: Any = page.page.get_by_test_id("over-canvas").bounding_box() if canvas_only else None
    write(page.page.screenshot(clip=clip), name)


def write(png: bytes, name: str) -> None:
    """Write a picture that was taken.

    Raises:
        ValueError: If it is too large.
    """
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    path = PICTURES / name
    picture.save(path, quality=82, subsampling=0, optimize=True)
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size:,} bytes, more than {MAX_BYTES:,}")


def film(browser: Browser) -> None:
    """Take the animation of a closure, moment by moment, from the scene that Demo plays.

    Raises:
        ValueError: If it is too large.
    """
    dataset = load_dataset(demo_path())
    options = ViewOptions(layout="registered", keypoints=False)
    params = preferred_parameters(dataset, PipelineParams())
    state = open_dataset(dataset, params, options)
    result = register_pair(state.query, state.database, state.params, Memo())
    inliers = np.flatnonzero(result.registration.inliers)
    few = inliers[:: max(1, len(inliers) // LINES)]  # all of them would hide the ground
    matches = result.matches
    few_matches = Matches(
        matches.pairs[few], matches.distances[few], matches.query_xy[few], matches.database_xy[few]
    )
    registration = replace(result.registration, inliers=np.ones(len(few), dtype=np.bool_))
    result = replace(result, matches=few_matches, registration=registration)
    server, _ = open_server("127.0.0.1", 0)
    scene = PairScene(server)
    scene.show(state, result)
    draw = scene.gliding(state, result)
    assert draw is not None
    set_start(server, scene.camera(state))
    width, height = FILM_SIZE
    page = browser.new_page(viewport={"width": width, "height": height})
    page.goto(f"http://127.0.0.1:{server.get_port()}/?fixedDpr=1")
    page.wait_for_timeout(6000)
    page.add_style_tag(content="[class*=mantine-Paper-root], [data-testid] {opacity: 0}")
    pictures: list[Image.Image] = []
    for k in range(MOMENTS):
        draw(ease(k / (MOMENTS - 1)))
        page.wait_for_timeout(700 if k else 6000)  # the first moment waits for its letters
        picture = Image.open(io.BytesIO(page.screenshot(clip=FILM_CLIP))).convert("RGB")
        pictures.append(picture)
    page.close()
    server.stop()
    seconds = [70] * MOMENTS
    seconds[0] = seconds[-1] = 1400
    write_film(pictures, seconds, "closure.webp")


def write_film(pictures: list[Image.Image], milliseconds: list[int], name: str) -> None:
    """Write pictures that follow each other, each for some time.

    Raises:
        ValueError: If the film is too large.
    """
    path = PICTURES / name
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=milliseconds, loop=0, quality=72
    )
    if path.stat().st_size > MAX_FILM_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size:,} bytes, more than {MAX_FILM_BYTES:,}")


def drive(browser: Browser) -> None:
    """Take the drive of ``gpgrad demo``: the map as each submap has come."""
    viewer = Viewer(partial(begin_drive, Demo.seed), port=0, source="a simulated drive")
    page = MapPage(browser, viewer, size=SIZE)
    strip, time = (page.page.get_by_test_id(name) for name in ("timeline", "time"))
    last = loop_params().num_submaps - 1
    page.wait(lambda: strip.get_attribute("data-at") == str(last), "the end", 600)
    clip: Any = page.page.get_by_test_id("over-canvas").bounding_box()
    time.focus()
    pictures: list[Image.Image] = []
    for at in range(last + 1):
        page.page.keyboard.press("ArrowRight" if at else "Home")
        page.wait(lambda at=at: strip.get_attribute("data-at") == str(at), "the moment")
        page.settle()
        png = page.page.screenshot(clip=clip)
        pictures.append(Image.open(io.BytesIO(png)).convert("RGB"))
    page.close()
    viewer.close()
    write_film(pictures, [2000, *[450] * (last - 1), 4000], "drive.webp")


def sliders(browser: Browser) -> None:
    """Take each of the four sliders that matter most at some values, and back where it was."""
    viewer = Viewer(load_dataset(demo_path()), port=0, source=demo_path().name)
    page = ViewerPage(browser, viewer.url, size=SIZE)
    pictures: list[Image.Image] = []
    for slider, values in SLIDERS.items():
        for value in (None, *values):
            if value is not None:
                page.type_value(slider, value)
            page.page.mouse.move(SIZE[0] / 2, SIZE[1] - 5)  # no tooltip in the way
            page.settle()
            page.page.wait_for_timeout(2000)
            picture = Image.open(io.BytesIO(page.page.screenshot())).convert("RGB")
            pictures.append(picture.resize(SLIDERS_SIZE, Image.Resampling.LANCZOS))
        page.press("Reset parameters")
    page.close()
    viewer.close()
    write_film(pictures, [1600] * len(pictures), "sliders.webp")


def explore(page: ViewerPage) -> None:
    """Take the world with its pose graph, corrected, and with the matrix of all pairs beside it."""
    page.press("Explore")
    page.tab("Pose graph")
    page.press("Optimise")
    page.wait(lambda: bool(page.say("graph-result")), "the corrected map", 600)
    page.viewer.wait_idle(60)
    save(page, "world.jpg")
    page.key("Shift+P")
    save(page, "matrix.jpg")
    page.key("Shift+P")


def compare(page: ViewerPage) -> None:
    """Take the pair at two settings, A beside B."""
    page.press("Keep as A")
    page.type_value("Variance mask", "0.15")
    save(page, "a_and_b.jpg")
    page.key("Escape")
    page.press("Reset parameters")


def present(page: ViewerPage) -> None:
    """Take the end of a talk."""
    page.press("Demo")
    page.press("pair")
    page.press("Present")
    for _ in range(STEPS - 1):
        page.page.wait_for_timeout(1000)
        page.key("PageDown")
    page.page.wait_for_timeout(5000)
    save(page, "present.jpg")


def talk(browser: Browser) -> None:
    """Take the likeliest pair of each dataset, with the panels put away."""
    data = Path(os.environ.get("GPGRAD_DATA", ""))
    for name in TALK:
        folder = demo_path() if name == "demo" else data / name
        if not is_wanted(f"talk_{name}") or not (name == "demo" or (data.name and folder.exists())):
            continue
        viewer = Viewer(load_dataset(folder), port=0, source=name)
        page = ViewerPage(browser, viewer.url, size=SIZE)
        page.key("f")
        page.page.get_by_test_id("status").wait_for(state="hidden")
        save(page, f"talk_{name}.jpg", canvas_only=True)
        page.close()
        viewer.close()


def dataset_page(browser: Browser) -> None:
    """Take the page of a whole dataset, which is opened from disk."""
    source = Path(os.environ.get("GPGRAD_DATA", "")) / "marsyard2021"
    if not source.exists():
        return
    with TemporaryDirectory() as folder:
        if run(["evaluate", str(source), "--out", folder]):
            raise ValueError(f"{source} could not be evaluated")
        page = browser.new_page(viewport={"width": SIZE[0], "height": 1080})
        page.goto(Path(folder, PAGE).as_uri())
        page.wait_for_selector("#pair[data-faces]")
        page.wait_for_timeout(2000)
        write(page.screenshot(), "dataset_page.jpg")
        page.close()


def is_wanted(name: str) -> bool:
    """Say whether a picture is to be taken: all are, if none is named."""
    return not sys.argv[1:] or name in sys.argv[1:]


def panels(browser: Browser) -> None:
    """Take the page with its panels, as it stands, in several modes."""
    viewer = Viewer(load_dataset(demo_path()), port=0, source=str(demo_path().name))
    page = ViewerPage(browser, viewer.url, size=SIZE)
    page.viewer = viewer
    save(page, "side_by_side.jpg")
    compare(page)
    page.choose("Layout", "gradient from above")
    save(page, "gradient.jpg")
    page.choose("Layout", "registered")
    save(page, "registered.jpg")
    page.choose("Layout", "side by side")
    page.type_value("Minimum inliers", "40")
    page.choose_submap("query", "004")
    page.tick("Outlier lines")
    page.choose("Layer", "standard deviation")
    save(page, "no_loop_closure.jpg")
    page.type_value("Minimum inliers", "0")
    page.choose("Layer", "gradient")
    page.choose_submap("query", "007")
    present(page)
    page.key("Escape")
    explore(page)
    page.close()
    viewer.close()


def main() -> int:
    """Take all pictures, or those that are named."""
    executable = find_chromium()
    if executable is None:
        print("no Chromium found; name one in GPGRAD_CHROMIUM")  # noqa: T201
        return 2
    PICTURES.mkdir(parents=True, exist_ok=True)
    with launch(executable) as browser:
        talk(browser)
        if is_wanted("panels"):
            panels(browser)
        if is_wanted("closure"):
            film(browser)
        if is_wanted("sliders"):
            sliders(browser)
        if is_wanted("drive"):
            drive(browser)
        if is_wanted("dataset_page"):
            dataset_page(browser)
    return 0


if __name__ == "__main__":
    sys.exit(main())
