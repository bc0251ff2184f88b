"""What fails by chance is told, although it passed the second time."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CONFTEST = (
    "from tests.conftest import pytest_collection_modifyitems, pytest_terminal_summary\n"
    "def pytest_configure(config):\n"
    "    config.addinivalue_line('markers', 'browser: drives a browser')\n"
)
TESTS = """
import pathlib, pytest

def first_time(name):
    path = pathlib.Path(__file__).with_name(name)
    try:
        return not path.exists()
    finally:
        path.touch()

@pytest.mark.browser
def test_of_a_browser():
    assert not first_time("browser"), "the page was late"

def test_of_numbers():
    assert not first_time("numbers")
"""


@pytest.mark.slow
def test_only_what_drives_a_browser_is_run_once_more_and_told(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text(CONFTEST, encoding="utf-8")
    (tmp_path / "test_twice.py").write_text(TESTS, encoding="utf-8")
    (tmp_path / "pytest.ini").write_text(f"[pytest]\npythonpath = {ROOT}\n", encoding="utf-8")
    said = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:dash", tmp_path],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    ).stdout
    assert "1 failed, 1 passed, 1 rerun" in said
    (told,) = [line for line in said.splitlines() if line.startswith("TO BE MENDED")]
    assert "test_of_a_browser failed, and was run once more" in told
    assert "the page was late" in told
