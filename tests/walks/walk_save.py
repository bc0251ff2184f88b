"""A walk through what the viewer keeps, takes and gives: real events, real files, pictures.

    GPGRAD_PICTURES=/tmp/walk pytest tests/walks/walk_save.py -n 0 -s

It fails on a blank picture, a value that is missing, an error of the page, or a request to
anywhere else.
"""

import io
import json
import os
import shlex
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
import trimesh

from app.viewer.host import pages
from app.viewer.permissions import Permissions
from app.viewer.server import Viewer
from gpgrad_core.datasets import demo_path, load_dataset
from gpgrad_core.outputs import read_closures
from gpgrad_core.params.files import read_parameters
from gpgrad_core.pipeline import PipelineParams
from tests.browser.chromium import BETWEEN_INPUTS_MS, ViewerPage, find_chromium, launch
from tests.browser.conftest import QUICK
from tests.end_to_end.process import ROOT, environment

pytestmark = pytest.mark.browser
SIZE = (1280, 900)
EVIL = "<img src=x onerror=window.evil=1>"


class Tour:
    """A page, the folder of its pictures, and what a tourist does."""

    def __init__(self, page: ViewerPage, pictures: Path) -> None:
        self.view = page
        self.page: Any = page.page
        self.pictures = pictures
        self.page.context.grant_permissions(["clipboard-read", "clipboard-write"])

    def snap(self, name: str, page: ViewerPage | None = None) -> None:
        """Take a picture of the whole window; the scene in it must not be blank."""
        shown = page or self.view
        shown.page.mouse.move(SIZE[0] / 2, SIZE[1] - 5)  # no tooltip in the way
        shown.page.wait_for_timeout(400)
        shown.page.screenshot(path=str(self.pictures / f"{name}.png"))
        assert not shown.is_blank(), name

    def tab(self, name: str) -> None:
        """Go to a tab."""
        self.page.get_by_role("tab", name=name, exact=True).click()
        self.page.wait_for_timeout(200)

    def unfold(self, name: str) -> None:
        """Unfold a folder."""
        self.page.get_by_text(name, exact=True).first.click()
        self.page.wait_for_timeout(400)

    def download(self, button: str) -> tuple[str, Path]:
        """Press a button and take the file that comes of it."""
        with self.page.expect_download(timeout=180_000) as coming:
            self.view.press(button)
        return coming.value.suggested_filename, Path(coming.value.path())

    def upload(self, button: str, name: str, content: bytes) -> None:
        """Press a button and give it a file."""
        with self.page.expect_file_chooser() as asking:
            self.view.press(button)
        asking.value.set_files(
            [{"name": name, "mimeType": "application/octet-stream", "buffer": content}]
        )

    def text(self, test_id: str) -> str:
        """Read a part of a panel."""
        return self.page.get_by_test_id(test_id).inner_text()

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        """Wait until a condition comes true."""
        self.view.wait(condition, what)


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    folder = Path(os.environ.get("GPGRAD_PICTURES", tmp_path / "pictures"))
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A root with the demo, a dataset that takes long to load, and one with an evil name."""
    root = tmp_path / "data"
    shutil.copytree(demo_path(), root / "demo")
    (root / "long" / "submaps").mkdir(parents=True)
    points = load_dataset(demo_path()).submaps[0].points
    np.savetxt(root / "long" / "submaps" / "000.xyz", np.tile(points, (6, 1)), fmt="%.4f")
    for number in range(1, 60):
        os.link(
            root / "long" / "submaps" / "000.xyz", root / "long" / "submaps" / f"{number:03d}.xyz"
        )
    return root


@pytest.fixture
def browser() -> Iterator[Any]:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    with launch(executable) as launched:
        yield launched


@pytest.fixture
def viewer(data: Path, tmp_path: Path) -> Iterator[Viewer]:
    source = data / "demo"
    made = Viewer(
        load_dataset(source),
        QUICK,
        port=0,
        source=str(source),
        permissions=Permissions(config=tmp_path / "config", root=data, max_upload=20_000_000),
    )
    yield made
    made.close()


@pytest.fixture
def tour(browser: Any, viewer: Viewer, pictures: Path) -> Iterator[Tour]:
    page = ViewerPage(browser, viewer.url, size=SIZE)
    yield Tour(page, pictures)
    page.close()
    assert page.errors == []
    assert page.outside == []


def test_parameters_are_undone_set_by_presets_and_kept(tour: Tour, tmp_path: Path) -> None:
    view, page = tour.view, tour.page
    assert "map " in tour.text("stages")
    assert "drawing" in tour.text("stages")
    assert "cells" in view.status()
    tour.snap("01_start")

    card = view.verdict()
    view.type_value("Noise", "0.12")
    view.settle()
    page.wait_for_timeout(900)  # the slider rests: a step for undo
    view.type_value("Minimum inliers", "35")
    page.wait_for_timeout(900)
    view.settle()
    assert view.verdict() != card
    tour.snap("02_two_changes")
    page.mouse.click(SIZE[0] / 2, 60)  # the picture: else the keys would go to the number box
    undone: list[tuple[float, float]] = []
    while not undone or undone[-1] != (0.05, 0.0):  # on a slow machine a key may be a step
        page.keyboard.press("Control+z")
        page.wait_for_timeout(500)
        undone.append((view.value("Noise"), view.value("Minimum inliers")))
        assert len(undone) < 12
    assert (0.12, 0.0) in undone  # what was changed last comes back first
    view.settle()
    assert view.verdict() == card
    page.keyboard.press("Control+Shift+z")
    tour.wait(lambda: view.value("Noise") != 0.05, "a redo")
    view.press("Undo")
    tour.wait(lambda: view.value("Noise") == 0.05, "an undo by its button")

    tour.unfold("More parameters")
    view.type_value("resolution", "0.12")
    view.settle()
    tour.snap("03_more_parameters")
    view.press("Map defaults")
    tour.wait(lambda: view.value("resolution") == QUICK.map.resolution, "the folder's defaults")
    tour.unfold("More parameters")

    view.choose("Preset", "smooth ground")
    tour.wait(lambda: view.value("Length-scale") == 0.45, "the preset's length-scale")
    tour.wait(lambda: page.get_by_text("swells of half a metre").count() == 1, "its purpose")
    view.settle()
    tour.snap("04_preset")
    view.type_value("Noise", "0.08")
    tour.wait(lambda: page.get_by_text("swells of half a metre").count() == 0, "custom")
    tour.unfold("Save as preset")
    view.type_text("Name", "my ground")
    view.press("Save preset")
    tour.wait(lambda: "my ground.toml" in tour.text("preset-message"), "the preset's file")
    kept = read_parameters(tmp_path / "config" / "presets" / "my ground.toml", PipelineParams())
    assert (kept.map.length_scale, kept.map.noise_std) == (0.45, 0.08)
    name, path = tour.download("Download parameters")
    assert name == "my_ground.toml"
    assert read_parameters(path, PipelineParams()) == kept
    tour.snap("05_own_preset")
    view.choose("Preset", "default")
    tour.wait(lambda: view.value("Noise") == 0.05, "the default")
    tour.upload("Upload parameters", "theirs.toml", b"[map]\nnoise_std = 0.11\nresolution = 0.1\n")
    tour.wait(lambda: view.value("Noise") == 0.11, "the file's noise")
    view.settle()


def test_a_session_goes_out_as_a_command_and_a_file_and_comes_back(
    tour: Tour, viewer: Viewer, tmp_path: Path
) -> None:
    view, page = tour.view, tour.page
    view.choose("Query", "008")
    view.type_value("Inlier radius", "0.22")
    view.choose("Layer", "gradient")
    view.settle()
    tour.tab("Save")
    view.press("Copy command")
    page.get_by_role("button", name="Copied").wait_for(timeout=5000)
    command = page.evaluate("navigator.clipboard.readText()")
    program, *words = shlex.split(command)
    assert program == "gpgrad"
    tour.snap("10_copied")
    words[words.index("closures.json")] = str(tmp_path / "closures.json")
    subprocess.run(
        [sys.executable, "-m", "app", *words], check=True, env=environment(), cwd=ROOT, timeout=120
    )
    (found,) = read_closures(tmp_path / "closures.json").pairs
    card = view.verdict()
    motion = found.T_database_query
    assert motion is not None
    for number in (
        f"inliers\t{found.num_inliers}",
        f"score {found.score:.1f}",
        f"motion\t{motion.x:+.2f} m, {motion.y:+.2f} m, {np.degrees(motion.yaw):+.1f}°",
        f"overlap\t{found.overlap_area:.1f} m²",
    ):
        assert number in card

    page.mouse.move(SIZE[0] / 2, SIZE[1] / 2)
    page.mouse.wheel(0, 400)  # another camera
    page.wait_for_timeout(800)
    name, path = tour.download("Save session")
    assert name == "demo.gpgrad.toml"
    saved = path.read_bytes()
    (client,) = pages(viewer.sessions[0].desk.host).values()
    position = np.array(client.camera.position)
    tour.tab("View")
    view.choose("Query", "004")
    view.choose("Layer", "elevation")
    view.press("Reset parameters")
    view.settle()
    assert view.verdict() != card
    tour.tab("Save")
    tour.upload("Restore session", "demo.gpgrad.toml", saved)
    page.page.get_by_role("button", name="Replace it").click()
    tour.wait(lambda: view.verdict() == card, "the same verdict")
    view.settle()
    assert view.value("Inlier radius") == 0.22
    page.wait_for_timeout(500)
    np.testing.assert_allclose(client.camera.position, position, atol=1e-3)
    tour.tab("View")
    assert view.legend().startswith("Gradient")
    tour.snap("11_restored")
    tour.tab("Save")
    tour.upload("Restore session", "broken.gpgrad.toml", b"what = 'is this'")
    tour.wait(lambda: "unknown key what" in tour.text("saving-message"), "a refusal")


def test_files_are_taken_away(tour: Tour) -> None:
    view, page = tour.view, tour.page
    tour.tab("Save")
    files: dict[str, Path] = {}
    for kind in ("JSON", "CSV", "g2o", "TUM, corrected poses"):
        view.choose("Closures as", kind)
        name, path = tour.download("Export closures")
        files[name] = path
    report = read_closures(files["closures.json"])
    assert len(report.pairs) == 45
    assert len(report.accepted) >= 3
    rows = files["closures.csv"].read_text().splitlines()
    assert len(rows) == 46
    edges = [line for line in files["graph.g2o"].read_text().splitlines() if "EDGE" in line]
    assert len(edges) == 9 + len(report.accepted)
    poses = files["poses_corrected.txt"].read_text().splitlines()
    assert len(poses) == 11  # a comment and a row a submap
    tour.snap("20_closures")
    for kind in ("NPZ", "GeoTIFF", "PLY mesh", "PNG"):
        view.choose("Map as", kind)
        name, path = tour.download("Export map")
        files[name] = path
    with np.load(files["map_007.npz"]) as arrays:
        shape = arrays["elevation"].shape
    assert tifffile.imread(files["map_007.tif"]).shape == (5, *shape)
    mesh = trimesh.load(io.BytesIO(files["map_007.ply"].read_bytes()), file_type="ply")
    assert len(mesh.faces) > 1000
    assert cv2.imread(str(files["map_007.png"])) is not None
    name, path = tour.download("Export picture")
    drawn = cv2.imread(str(path))
    assert name == "view.png"
    assert drawn is not None
    assert drawn.std() > 5
    shutil.copy(path, tour.pictures / "21_exported_view.png")
    assert "view.png" in tour.text("export-message")
    tour.snap("22_exported")
    assert page.get_by_role("button", name="Cancel export").count() == 0


def test_datasets_come_from_the_browser(tour: Tour, data: Path) -> None:
    view, page = tour.view, tour.page
    tour.tab("Data")
    tour.snap("30_data")
    view.choose("Browse", "long/")
    tour.wait(lambda: tour.text("place").endswith("long"), "the folder")
    view.press("Use this folder")
    loading = page.get_by_role("button", name="Cancel loading")
    loading.wait_for(timeout=20_000)
    page.screenshot(path=str(tour.pictures / "31_loading.png"))
    loading.click()
    page.get_by_text("Cancelled.").wait_for(timeout=20_000)
    assert page.get_by_text("demo · 10 submaps").count() <= 1
    view.type_text("Folder", "/etc")
    view.press("Load")
    error = page.get_by_test_id("dataset-error")
    error.wait_for(timeout=20_000)
    assert "outside of" in error.inner_text()
    tour.snap("32_outside")

    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("set/dataset.toml", f'name = "{EVIL}"\ndescription = "{EVIL}"\n')
        for name in ("000", "001", "007"):
            archive.write(data / "demo" / "submaps" / f"{name}.ply", f"set/submaps/{name}.ply")
    tour.upload("Upload clouds or a .zip", "my set.zip", packed.getvalue())
    tour.wait(lambda: "Loop closure" in view.verdict() and "query 007" in view.verdict(), "a pair")
    view.settle()
    tour.tab("View")
    assert page.get_by_text(f"{EVIL} · 3 submaps").count() == 1
    assert page.evaluate("window.evil") is None
    tour.snap("33_uploaded")
    tour.tab("Data")
    cloud = (data / "demo" / "submaps" / "004.ply").read_bytes()
    tour.upload("Upload clouds or a .zip", "004.ply", cloud)
    tour.wait(lambda: "query 004 → database 004" in view.verdict(), "the cloud")
    view.settle()
    tour.upload("Upload clouds or a .zip", "evil.zip", b"PK\x03\x04not really")
    error.wait_for(timeout=20_000)
    assert "evil.zip: is not a complete zip archive" in error.inner_text()
    tour.snap("34_refused")
    view.type_text("Folder", "demo")
    view.press("Load")
    tour.wait(lambda: "query 007 → database 001" in view.verdict(), "the demo again")
    view.settle()
    view.choose("Recent", str(data / "demo"))
    view.settle()
    tour.snap("35_recent")


def test_the_status_can_be_trusted(tour: Tour) -> None:
    view, page = tour.view, tour.page
    tour.unfold("More parameters")
    card = view.verdict()
    view.type_value("resolution", "0.01")
    page.get_by_role("button", name="Cancel computing").click(timeout=60_000)
    tour.wait(lambda: "Cancelled" in view.status(), "the end")
    assert "out of date" in view.status()
    assert tour.text("stale") == "out of date"
    tour.snap("40_cancelled")
    view.type_value("resolution", "0.08")
    view.settle()
    assert page.get_by_test_id("stale").count() == 0
    assert view.verdict() == card
    view.choose("noise model", "file")
    tour.wait(lambda: "noise_std" in view.status(), "an error")
    assert "out of date" in view.status()
    assert tour.text("stale") == "out of date"
    assert "query 007" in view.verdict()  # the last good one
    tour.snap("41_error")
    view.choose("noise model", "constant")
    view.settle()
    assert page.get_by_test_id("stale").count() == 0


def test_several_people_and_the_dark(tour: Tour, browser: Any, viewer: Viewer) -> None:
    view = tour.view
    view.type_value("Minimum inliers", "33")
    view.settle()
    late = ViewerPage(browser, viewer.url, size=SIZE)
    try:
        assert late.value("Minimum inliers") == 33
        assert late.verdict() == view.verdict()
        tour.wait(lambda: "2 pages" in tour.text("presence"), "the count")
        late.type_value("Minimum inliers", "12")
        tour.wait(lambda: view.value("Minimum inliers") == 12, "the other's slider")
        view.settle()
        tour.snap("50_two_pages", late)
    finally:
        late.close()
    tour.wait(lambda: tour.page.get_by_test_id("presence").count() == 0, "to be alone")
    assert late.errors == []
    tour.unfold("More view options")
    view.tick("Dark")
    tour.page.wait_for_timeout(1000)
    tour.snap("51_dark")
    assert json.loads(tour.page.evaluate("JSON.stringify(window.evil || null)")) is None
    tour.page.wait_for_timeout(BETWEEN_INPUTS_MS)
