"""Every example is a whole program: it runs as it stands, and finds what it says it finds."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import gpgrad_core as gg
from tests.end_to_end.process import ROOT, environment

EXAMPLES = ROOT / "assets" / "examples"
FINDS = {
    "01_one_map.py": (r"map: \d+ x \d+ cells of 0\.05 m", ["map.npz", "map.png"]),
    "02_two_submaps.py": (r"^loop closure: \d+ inliers", []),
    "03_whole_dataset.py": (r"\d+ of 28 pairs are loop closures", ["closures.json"]),
    "04_parameters.py": (r"fitted: length-scale 0\.\d+ m", []),
    "05_evaluate.py": (
        r"slope keypoints, rule surface .*: AP 1\.00",
        ["report/report.md", "report/report.json"],
    ),
    "06_pose_graph.py": (r"0\.\d+ m before, 0\.0\d+ m after", ["graph.g2o"]),
    "07_online_loop_closer.py": (r"0\.\d+ m before, 0\.0\d+ m after", []),
    "08_your_own_detector.py": (r"gradient: AP 1\.00", []),
}

NEED_SOLVER = ("06_pose_graph.py", "07_online_loop_closer.py")


def test_every_example_is_tried() -> None:
    assert sorted(path.name for path in EXAMPLES.glob("*.py")) == sorted(FINDS)


@pytest.mark.slow
@pytest.mark.parametrize("name", FINDS)
def test_example_runs(name: str, tmp_path: Path) -> None:
    if name in NEED_SOLVER:
        pytest.importorskip("gtsam", reason="GTSAM has no wheels for this system")
    finished = subprocess.run(
        [sys.executable, "-W", "error", EXAMPLES / name],
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=180,
        check=False,
        env=environment(),
        cwd=tmp_path,
    )
    assert finished.returncode == 0, finished.stderr
    said, files = FINDS[name]
    assert re.search(said, finished.stdout, flags=re.MULTILINE), finished.stdout
    for file in files:
        assert (tmp_path / file).stat().st_size > 0


@pytest.mark.parametrize("name", FINDS)
def test_example_is_short_and_uses_only_what_is_public(name: str) -> None:
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    assert 20 <= len(text.splitlines()) <= 60
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom):
            assert not (node.module or "").startswith(("gpgrad_core", "app"))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            assert node.value.id != "gg" or node.attr in gg.__all__, node.attr
