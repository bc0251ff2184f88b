"""The guide's recipes, carried out to the letter on a copy of the project.

One file is touched or added; a feature of the viewer touches the one that builds the session too.
What the recipes change still stands there: that is checked in every run; what they add works: slow.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SLIDER_IS_USED = """
from dataclasses import replace
import numpy as np
from app.viewer.session.session_file import address_of, read_address
from app.viewer.session.state import open_dataset
from app.viewer.widgets.panel import Panel
from gpgrad_core.matching import MatchParams, match_features
from gpgrad_core.detection import PipelineParams
from gpgrad_core.types import Features
from tests.support.server import started_server
from tests.support.synthetic import make_dataset
from tests.support.widgets import find, user_sets

told = []
with started_server() as server:
    Panel(server, PipelineParams(), told.append, widgets={}, default=PipelineParams())
    slider = find(server, "Max distance")
    assert (slider.min, slider.max, slider.value) == (0.0, 10.0, 10.0)
    assert slider.hint.startswith("Keypoints whose descriptors differ by more")
    user_sets(slider, 0.25)
(params,) = told
state = replace(open_dataset(make_dataset(), params), source="/data/hills")
assert "params.matching.max_distance=0.25" in address_of(state)
assert read_address(address_of(state)).params == params
ones = np.ones(40)
query, database = (
    Features(np.zeros((40, 2)), ones, ones, ones, rng.normal(size=(40, 8)).astype(np.float32))
    for rng in map(np.random.default_rng, (1, 2))
)
matches = match_features(query, database, MatchParams())
nearest = round(float(np.median(matches.distances)), 2)
assert 0 < len(match_features(query, database, MatchParams(max_distance=nearest))) < len(matches)
"""
READER_IS_USED = """
from pathlib import Path
from app.viewer.features.data.unpacking import check_cloud
from gpgrad_core import load_dataset
from gpgrad_core.io.clouds import CLOUD_FORMATS
from gpgrad_core.io.records.files import check_apart
folder = Path("clouds")
folder.mkdir()
(folder / "000.foo").write_bytes(CLOUD_FORMATS[".foo"].example)
(submap,) = load_dataset(folder).submaps
assert submap.points.max() == 0.9
check_cloud(folder / "000.foo", 1000)
try:
    check_apart([folder / "001.foo"], [folder])
except ValueError as error:
    assert "belongs to the input" in str(error)
else:
    raise AssertionError
"""

FEATURE_IS_USED = """
from app.viewer.features.session import Session
from app.viewer.session.jobs import Capacity
from app.viewer.session.session_file import Opened
from gpgrad_core.detection import PipelineParams
from gpgrad_core.run.memo import Memo
from tests.support.server import started_server
from tests.support.synthetic import make_dataset
from tests.support.widgets import said

with started_server() as server:
    opened = Opened(make_dataset(), PipelineParams(), "/data/hills")
    session = Session(server, opened, Memo(), Capacity())
    assert session.wait_idle()
    written = said(server)
    session.close()
print(written)
"""


LAYER_IS_USED = """
from dataclasses import replace
import numpy as np
from app.viewer.scene.layers import Paint, make_surfels
from app.viewer.session.session_file import address_of, read_address
from app.viewer.session.state import ViewOptions, open_dataset
from app.viewer.widgets.panel import Panel
from gpgrad_core.detection import PipelineParams
from tests.support.server import started_server
from tests.support.synthetic import make_dataset, make_map
from tests.support.widgets import find, user_sets

told = []
with started_server() as server:
    Panel(server, ViewOptions(), told.append)
    choice = find(server, "Layer")
    assert "The incline is the gradient in degrees." in choice.hint
    user_sets(choice, "incline")
(options,) = told
state = replace(open_dataset(make_dataset(), PipelineParams(), options), source="/data/hills")
assert "view.layer=incline" in address_of(state)
assert read_address(address_of(state)).options == options
made = make_map(state.query)
paint, gradient = (Paint((made,), layer, 1.0) for layer in ("incline", "gradient"))
assert (paint.scale.label, paint.scale.unit) == ("Incline of the ground", "°")
assert np.allclose(np.tan(np.radians(paint.fields[0])), gradient.fields[0])
assert len(make_surfels(paint).positions)
"""


def recipe(title: str) -> str:
    """The section of the guide that tells how to add something."""
    guide = (ROOT / "assets" / "guide" / "architecture.md").read_text(encoding="utf-8")
    return guide.split(f"## How to add a {title}\n", 1)[1].split("\n## ", 1)[0]


def part(section: str, pattern: str) -> str:
    match = re.search(pattern, section, re.DOTALL)
    assert match is not None, pattern
    return match[1]


def replace_once(file: Path, before: str, after: str) -> None:
    text = file.read_text(encoding="utf-8")
    assert text.count(before) == 1, before
    file.write_text(text.replace(before, after), encoding="utf-8")


def add_detector(copy: Path) -> Path:
    file = copy / "gpgrad_core" / "features" / "extraction.py"
    entry = part(recipe("detector of keypoints"), r"```python\n(.*?)\n```")
    replace_once(file, "    )\n}\n", f"        {entry},\n    )\n}}\n")
    return file


def add_reader(copy: Path) -> Path:
    section = recipe("reader of clouds")
    file = copy / part(section, r"`(gpgrad_core/\S+/foo\.py)`")
    file.write_text(part(section, r"```python\n(.*?)```"), encoding="utf-8")
    return file


def add_slider(copy: Path) -> Path:
    section = recipe("slider")
    file = copy / part(section, r"`(gpgrad_core/\S+\.py)`")
    patch(file, section)
    return file


def add_layer(copy: Path) -> Path:
    section = recipe("layer")
    file = copy / part(section, r"`(app/viewer/\S+\.py)`")
    entry = part(section, r"```python\n(.*?)\n```")
    replace_once(file, "    )\n}\n", f"        {entry},\n    )\n}}\n")
    return file


def add_feature(copy: Path) -> Path:
    section = recipe("feature to the viewer")
    file = copy / part(section, r"`(app/viewer/\S+/steepness\.py)`")
    file.write_text(part(section, r"```python\n(.*?)```"), encoding="utf-8")
    patch(copy / part(section, r"`(app/viewer/\S+/session\.py)`"), section)
    return file


def patch(file: Path, section: str) -> None:
    """Change a file as the section's diff says."""
    for hunk in re.split(r"^@@.*\n", part(section, r"```diff\n(.*?)```"), flags=re.MULTILINE):
        lines = hunk.splitlines(keepends=True)
        before, after = (
            "".join(line[1:] for line in lines if line[0] not in left_out) for left_out in "+-"
        )
        replace_once(file, before, after)


RECIPES = (add_detector, add_reader, add_slider, add_layer, add_feature)


@pytest.fixture(scope="module")
def carried_out(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """A copy of the project on which all recipes were carried out, and the files they touched."""
    copy = tmp_path_factory.mktemp("copy")
    for package in ("gpgrad_core", "app", "tests"):
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, copy / package, ignore=ignore)
    shutil.copy(ROOT / "pyproject.toml", copy)
    (copy / "assets").symlink_to(ROOT / "assets")
    return copy, [str(add(copy)) for add in RECIPES]


@pytest.fixture
def copy(carried_out: tuple[Path, list[str]]) -> Path:
    return carried_out[0]


def run(copy: Path, *arguments: str) -> str:
    finished = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        cwd=copy,
        check=False,
        env={**os.environ, "PYTHONPATH": str(copy)},
    )
    assert finished.returncode == 0, finished.stdout + finished.stderr
    return finished.stdout


def test_recipes_fit_the_code(carried_out: tuple[Path, list[str]]) -> None:
    _, touched = carried_out
    assert len(touched) == len(RECIPES)


@pytest.mark.slow
def test_all_checks_pass_then(carried_out: tuple[Path, list[str]]) -> None:
    copy, added = carried_out
    run(copy, "-m", "ruff", "format", *added)  # an entry of the guide is not indented
    run(copy, "-m", "ruff", "check", *added)
    run(copy, "-m", "pyright", "--pythonpath", sys.executable, *added)
    run(copy, "-c", "from importlinter.cli import lint_imports_command as l; l()")


def run_tests(copy: Path, folder: str, word: str) -> str:
    return run(
        copy,
        "-m",
        "pytest",
        folder,
        "-k",
        word,
        "-m",
        "",
        "-n",
        "0",
        "-q",
        "-p",
        "no:cacheprovider",
    )


@pytest.mark.slow
def test_a_detector_is_offered_and_passes_the_tests_of_all(copy: Path) -> None:
    assert "brisk" in re.sub(r"\s+", " ", run(copy, "-m", "app", "detect", "--help"))
    assert re.search(
        r"[1-9]\d* passed", run_tests(copy, "tests/core/features/test_extraction.py", "brisk")
    )


@pytest.mark.slow
def test_a_reader_is_used_everywhere_and_its_damaged_files_too(copy: Path) -> None:
    run(copy, "-c", READER_IS_USED)
    assert "2 passed" in run_tests(copy, "tests/test_damaged_files.py", "foo")


@pytest.mark.slow
def test_a_field_is_a_slider_a_flag_and_a_part_of_links(copy: Path) -> None:
    run(copy, "-c", SLIDER_IS_USED)
    assert "--matching.max-distance" in run(copy, "-m", "app", "detect", "--help")


@pytest.mark.slow
def test_a_layer_is_a_choice_a_legend_and_a_part_of_links(copy: Path) -> None:
    run(copy, "-c", LAYER_IS_USED)


@pytest.mark.slow
def test_a_feature_follows_the_pair(copy: Path) -> None:
    assert re.search(r"Median gradient \d\.\d\d m/m", run(copy, "-c", FEATURE_IS_USED))
