"""The guide's recipe for a slider, carried out to the letter on a copy."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[5]
USED = """
from dataclasses import replace
import numpy as np
from app.viewer.features.links.address import address_of, read_address
from app.viewer.features.params.panel import ParamsPanel
from app.viewer.session.state import open_dataset
from gpgrad_core.matching import MatchParams, match_features
from gpgrad_core.detection import PipelineParams
from gpgrad_core.types import Features
from tests.support.server import started_server
from tests.support.synthetic import make_dataset
from tests.support.widgets import find, user_sets

told = []
with started_server() as server:
    ParamsPanel(server, PipelineParams(), told.append, main={})
    slider = find(server, "max distance")
    assert (slider.min, slider.max, slider.value) == (0.0, 10.0, 10.0)
    assert slider.hint.startswith("Keypoints whose descriptors differ by more")
    user_sets(slider, 0.25)
(params,) = told
state = replace(open_dataset(make_dataset(), params), source="/data/hills")
assert "params.matching.max_distance=0.25" in address_of(state)
assert read_address(address_of(state)).saved.params == params
ones = np.ones(40)
query, database = (
    Features(np.zeros((40, 2)), ones, ones, ones, rng.normal(size=(40, 8)).astype(np.float32))
    for rng in map(np.random.default_rng, (1, 2))
)
matches = match_features(query, database, MatchParams())
nearest = round(float(np.median(matches.distances)), 2)
assert 0 < len(match_features(query, database, MatchParams(max_distance=nearest))) < len(matches)
"""


def follow_the_guide(copy: Path) -> None:
    """Copy the project, and change the one file that the recipe names."""
    guide = (ROOT / "assets" / "guide" / "architecture.md").read_text(encoding="utf-8")
    section = guide.split("## How to add a slider", 1)[1].split("\n## ", 1)[0]
    name = re.search(r"`(gpgrad_core/\S+\.py)`", section)
    change = re.search(r"```diff\n(.*?)```", section, re.DOTALL)
    assert name is not None
    assert change is not None
    for package in ("gpgrad_core", "app", "tests"):
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, copy / package, ignore=ignore)
    (copy / "assets").symlink_to(ROOT / "assets")
    file = copy / name[1]
    text = file.read_text(encoding="utf-8")
    for hunk in re.split(r"^@@.*\n", change[1], flags=re.MULTILINE):
        lines = hunk.splitlines(keepends=True)
        before, after = (
            "".join(line[1:] for line in lines if line[0] not in left_out) for left_out in "+-"
        )
        assert text.count(before) == 1, before
        text = text.replace(before, after)
    file.write_text(text, encoding="utf-8")


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


@pytest.mark.slow
def test_one_field_is_a_slider_a_flag_and_a_part_of_links(tmp_path: Path) -> None:
    follow_the_guide(tmp_path)
    run(tmp_path, "-c", USED)
    assert "--matching.max-distance" in run(tmp_path, "-m", "app", "detect", "--help")
