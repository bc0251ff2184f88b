"""`gpgrad build`, as a process: killed, interrupted, gone on with, and what comes next."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from app.cli import run
from gpgrad_core.datasets import SimulationParams
from gpgrad_core.scans import BuildParams, build_dataset, simulate_recording
from tests.core.scans.test_build import contents
from tests.end_to_end.process import ROOT, environment

PARAMS = SimulationParams(
    num_submaps=6, spacing=3.0, extent=24.0, max_range=4.0, route="winding", lateral_offset=0.0
)
FLAGS = ("--max-length", "3", "--max-range", "4")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive out and back over a field of rocks."""
    folder = tmp_path_factory.mktemp("recording") / "drive"
    simulate_recording(folder, 36, PARAMS, points_a_scan=4000)
    return folder


def stop(how: signal.Signals, after: int, recording: Path, out: Path) -> tuple[int, str]:
    """Build, and end the process by a signal once so many submaps are noted down.

    Returns:
        Its exit code, and what it said on standard error.
    """
    journal = out.with_name(f"{out.name}.partial") / "build.jsonl"
    for _ in range(5):
        process = subprocess.Popen(
            [sys.executable, "-m", "app", "build", str(recording), "--out", str(out), *FLAGS],
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
            env=environment(),
            cwd=ROOT,
        )
        try:
            while process.poll() is None and count_lines(journal) <= after:
                time.sleep(0.002)
            process.send_signal(how)
            _, said = process.communicate(timeout=60)
        finally:
            process.kill()
        if not out.exists():
            return process.returncode, said
        shutil.rmtree(out)  # it was quicker than the signal
    raise AssertionError("the build was never caught at work")


def count_lines(journal: Path) -> int:
    return len(journal.read_text().splitlines()) if journal.exists() else 0


def test_killed_and_gone_on_with(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    params = BuildParams(max_length=3.0, max_range=4.0)
    build_dataset(recording, tmp_path / "whole" / "data", params)
    out = tmp_path / "data"
    code, _ = stop(signal.SIGKILL, 1, recording, out)
    assert code == -signal.SIGKILL
    code, said = stop(signal.SIGINT, 3, recording, out)
    assert (code, said) == (130, "gpgrad: interrupted; the same command goes on from here\n")
    assert run(["build", str(recording), "--out", str(out), *FLAGS]) == 0
    said = capsys.readouterr().out
    assert "submaps of 36 scans, " in said
    assert "of them from before: " in said
    assert contents(out) == contents(tmp_path / "whole" / "data")
    assert {entry.name for entry in tmp_path.iterdir()} == {"data", "whole"}

    # What comes next: the way back is recognised.
    closures = tmp_path / "closures.json"
    assert run(["detect", str(out), "--out", str(closures), "--map.resolution", "0.05"]) == 0
    pairs = json.loads(closures.read_text())["pairs"]
    accepted = {(int(p["query"]), int(p["database"])) for p in pairs if p["accepted"]}
    assert any(query - database > 2 for query, database in accepted), accepted


def test_a_refusal_leaves_nothing(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "data"
    flags = ("--max-uncertainty", "1", "--up=-y")
    assert run(["build", str(recording), "--out", str(out), *flags]) == 2
    assert "needs poses with covariances" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
