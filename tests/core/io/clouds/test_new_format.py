"""The guide's recipe for a reader of clouds, carried out to the letter on a copy."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[4]
USED = """
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


def follow_the_guide(copy: Path) -> Path:
    """Copy the project, and write the one file that the recipe gives."""
    guide = (ROOT / "assets" / "guide" / "architecture.md").read_text(encoding="utf-8")
    section = guide.split("## How to add a reader of clouds", 1)[1].split("\n## ", 1)[0]
    name = re.search(r"`(gpgrad_core/\S+/foo\.py)`", section)
    code = re.search(r"```python\n(.*?)```", section, re.DOTALL)
    assert name is not None
    assert code is not None
    for package in ("gpgrad_core", "app", "tests"):
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, copy / package, ignore=ignore)
    shutil.copy(ROOT / "pyproject.toml", copy)
    (copy / name[1]).write_text(code[1], encoding="utf-8")
    return copy / name[1]


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
def test_one_file_is_enough(tmp_path: Path) -> None:
    follow_the_guide(tmp_path)
    run(tmp_path, "-c", USED)


@pytest.mark.slow
def test_all_checks_pass_then(tmp_path: Path) -> None:
    file = str(follow_the_guide(tmp_path))
    run(tmp_path, "-m", "ruff", "format", "--check", file)
    run(tmp_path, "-m", "ruff", "check", file)
    run(tmp_path, "-m", "pyright", file)
    run(tmp_path, "-c", "from importlinter.cli import lint_imports_command as l; l()")
    fuzz = run(tmp_path, "-m", "pytest", "tests/fuzz", "-n", "0", "-m", "", "-k", "foo")
    assert "2 passed" in fuzz
