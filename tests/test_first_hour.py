"""The guide's first hour, followed to the letter on a copy of the demo."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.end_to_end.process import ROOT, environment
from tests.test_readme import GUIDE, blocks

INSTALL = ("python3 -m venv", "source .venv")
"""What the checks of an installation run: see ``.ci``."""
MAKES = ("pair.json", "smooth.json", "closures.json", "map/page.html", "map/map.tif")
MAKES_TOO = ("map/poses_corrected.txt", "report/report.md", "traverse/dataset.toml")


def commands() -> list[str]:
    """The lines of the page that a reader types, in their order."""
    lines = "\n".join(blocks(GUIDE / "first_hour.md", "sh")).splitlines()
    return [line for line in lines if not line.startswith(INSTALL)]


def with_gpgrad(folder: Path) -> dict[str, str]:
    """An environment in which ``gpgrad`` is this checkout's."""
    program = folder / "gpgrad"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m app "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    return environment() | {"PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}


def view(command: str, folder: Path, env: dict[str, str]) -> None:
    """Open the viewer, wait for its address, and end it."""
    line = [*command.split(), "--no-open", "--port", "0"]
    with subprocess.Popen(line, cwd=folder, env=env, stdout=subprocess.PIPE, text=True) as viewer:
        assert viewer.stdout is not None
        try:
            assert any("http://" in printed for printed in viewer.stdout)
        finally:
            viewer.terminate()


def test_the_path_is_whole() -> None:
    verbs = [line.split()[1] for line in commands() if line.startswith("gpgrad")]
    assert verbs == ["detect", "detect", "simulate", "build", "view", "detect", "slam", "evaluate"]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="the page is for a POSIX shell")
def test_it_can_be_followed_literally(tmp_path: Path) -> None:
    pytest.importorskip("gtsam", reason="GTSAM has no wheels for this system")
    copy, programs = tmp_path / "checkout", tmp_path / "bin"
    programs.mkdir()
    shutil.copytree(ROOT / "assets" / "demo", copy / "assets" / "demo")
    env = with_gpgrad(programs)
    for command in commands():
        if command.startswith("gpgrad view"):
            view(command, copy, env)
            continue
        finished = subprocess.run(
            ["sh", "-c", command], cwd=copy, env=env, capture_output=True, text=True, check=False
        )
        assert finished.returncode == 0, f"{command}\n{finished.stderr}"
    for name in (*MAKES, *MAKES_TOO):
        assert (copy / "hour" / name).stat().st_size > 0, name
