"""The container file, as a linter sees it; where a builder runs, it should also be built."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CONTAINER = ROOT / "assets" / "container" / "Containerfile"


def test_the_linter_finds_nothing() -> None:
    path = f"{Path(sys.executable).parent}:/usr/bin"
    hadolint = shutil.which("hadolint", path=path)
    if hadolint is None:
        pytest.skip("hadolint is not installed")
    finished = subprocess.run([hadolint, CONTAINER], capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stdout + finished.stderr


def test_it_installs_what_the_readme_names() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    _, _, rest = readme.partition("`apt-get install ")
    packages = rest.partition("`")[0].split()
    assert len(packages) >= 4
    words = CONTAINER.read_text(encoding="utf-8").split()
    assert set(packages) <= set(words)
