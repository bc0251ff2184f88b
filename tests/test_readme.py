"""The README tells the truth: its Python runs, its commands and files exist."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.end_to_end.process import environment, run_gpgrad

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)
    return [text for name, text in fenced if name == language]


def test_the_python_example_runs(tmp_path: Path) -> None:
    (example,) = blocks("python")
    finished = subprocess.run(
        [sys.executable, "-W", "error", "-c", example],
        capture_output=True,
        text=True,
        env=environment(),
        cwd=tmp_path,
        check=False,
    )
    assert finished.returncode == 0, finished.stderr
    assert re.match(r"\d+ inliers, score [\d.]+: True\n", finished.stdout)
    assert "closes a loop with" in finished.stdout


def test_the_two_commands_are_one_line_each() -> None:
    start, test = [line for line in README.splitlines() if line.startswith("python3 -m venv")]
    assert start.endswith(".venv/bin/gpgrad view")
    assert test.endswith(".venv/bin/python -m pytest")
    # What continuous integration runs is this very line.
    assert "grep -m1 -E '^python3 -m venv .*pytest' README.md" in (ROOT / ".ci/run").read_text()


def test_links_lead_somewhere() -> None:
    anchors = {
        re.sub(r"[^\w -]", "", title).strip().lower().replace(" ", "-")
        for title in re.findall(r"^#+ (.*)$", README, flags=re.MULTILINE)
    }
    links = re.findall(r"\]\(([^)]+)\)", README) + re.findall(r'src="([^"]+)"', README)
    assert links
    for link in links:
        if link.startswith("#"):
            assert link[1:] in anchors, link
        elif not link.startswith("http"):
            assert (ROOT / link).exists(), link


def test_files_named_in_the_listing_exist() -> None:
    (listing,) = [block for block in blocks("") if block.startswith("gpgrad_core/")]
    folder = ROOT
    named = 0
    for line in listing.splitlines():
        names = re.findall(
            r"[\w.]+(?:/|\.py)(?=\s|$)", line.split("   ")[0] if line[0] != " " else line
        )
        if not line.startswith(" "):
            folder = ROOT / names[0]
            assert folder.is_dir()
            continue
        for name in names:
            assert (folder / name).exists(), name
            named += 1
    assert named > 10


@pytest.mark.parametrize(
    "verb", ["view", "detect", "evaluate", "map", "fit", "build", "slam", "simulate"]
)
def test_flags_of_the_commands_exist(verb: str) -> None:
    row = next(line for line in README.splitlines() if line.startswith(f"| `gpgrad {verb}"))
    said = run_gpgrad(verb, "--help").out
    for flag in re.findall(r"--[\w.-]+", row):
        assert flag in said


def test_flags_in_the_text_exist() -> None:
    said = run_gpgrad("detect", "--help").out
    for flag in set(re.findall(r"`(--(?:map|closure|features|matching)\.[\w.-]+)", README)):
        assert flag in said
