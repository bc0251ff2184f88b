"""The guide's recipe for a new detector, carried out to the letter on a copy of the packages."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The packages and their tests, with the one line that the guide adds to the registry."""
    folder = tmp_path_factory.mktemp("copy")
    ignore = shutil.ignore_patterns("__pycache__")
    for package in ("app", "gpgrad_core", "tests"):
        shutil.copytree(ROOT / package, folder / package, ignore=ignore)
    shutil.copy(ROOT / "pyproject.toml", folder)
    guide = (ROOT / "assets" / "guide" / "architecture.md").read_text(encoding="utf-8")
    section = guide.split("## How to add a detector of keypoints")[1].split("\n## ")[0]
    entry = re.findall(r"```python\n(.*?)\n```", section, re.DOTALL)[0]
    registry = folder / "gpgrad_core" / "features" / "registry.py"
    text = registry.read_text(encoding="utf-8")
    added = text.replace("    )\n}\n", f"        {entry},\n    )\n}}\n")
    registry.write_text(added, encoding="utf-8")
    return folder


def run(folder: Path, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_command_line_offers_it(copy: Path) -> None:
    assert "brisk" in re.sub(r"\s+", " ", run(copy, "-m", "app", "detect", "--help"))


@pytest.mark.slow
def test_it_passes_the_tests_of_all_detectors(copy: Path) -> None:
    tests = "tests/core/features/test_extraction.py"
    said = run(
        copy, "-m", "pytest", tests, "-k", "brisk", "-n", "0", "-q", "-p", "no:cacheprovider"
    )
    assert re.search(r"[1-9]\d* passed", said)
