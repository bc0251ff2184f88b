"""The core's import contracts notice a wrong import, also deep in a folder of a stage."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("file", "line", "broken"),
    [
        ("features/surf.py", "import gpgrad_core.matching", "core layers"),
        ("datasets/clouds/pcd.py", "import gpgrad_core.features.surf", "core layers"),
        ("scans/voxels.py", "import gpgrad_core.scans.build", "scans layers"),
        ("types.py", "import viser", "the core knows neither the app nor its libraries"),
    ],
)
def test_a_wrong_import_breaks_a_contract(
    file: str, line: str, broken: str, tmp_path: Path
) -> None:
    for package in ("gpgrad_core", "app"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=lambda *_: ["__pycache__"])
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    planted = tmp_path / "gpgrad_core" / file
    planted.write_text(f"{planted.read_text(encoding='utf-8')}\n{line}\n", encoding="utf-8")
    finished = subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as l; l()"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert finished.returncode == 1
    lines = finished.stdout.splitlines()
    assert any(said.startswith(broken) and said.endswith("BROKEN") for said in lines)
