"""`gpgrad build`, as a process: killed, interrupted, gone on with, and what comes next."""

import json
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from app.cli import run
from tests.core.recordings.test_build import contents
from tests.end_to_end.conftest import patch
from tests.end_to_end.process import gpgrad, start
from tests.support.drive import make_drive, write_drive

LONG = make_drive(num_scans=120, points_a_scan=1500)
FLAGS = ("--max-length", "3", "--max-range", "4")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 60 m."""
    return write_drive(tmp_path_factory.mktemp("recording") / "drive", LONG)


def kill(after: int, recording: Path, out: Path) -> None:
    """Build, and kill the process once so many submaps are noted down."""
    journal = out.with_name(f"{out.name}.partial") / "build.jsonl"
    for _ in range(5):
        process = start("build", recording, "--out", out, *FLAGS)
        while process.poll() is None and count_lines(journal) <= after:
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
        if process.wait() == -signal.SIGKILL:
            return
        shutil.rmtree(out)  # it was quicker than the signal
    raise AssertionError("the build was never caught at work")


def count_lines(journal: Path) -> int:
    return len(journal.read_text().splitlines()) if journal.exists() else 0


@pytest.mark.slow
def test_killed_and_gone_on_with(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, out = tmp_path / "whole" / "data", tmp_path / "data"
    assert run(["build", str(recording), "--out", str(whole), *FLAGS]) == 0
    kill(2, recording, out)
    assert not out.exists()
    assert run(["build", str(recording), "--out", str(out), *FLAGS]) == 0
    assert "of them resumed: " in capsys.readouterr().out
    assert contents(out) == contents(whole)
    assert {entry.name for entry in tmp_path.iterdir()} == {"data", "whole"}


def test_interrupted(
    recording: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Ctrl-C comes as an exception, at any place: here while the first submap is written."""

    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "data"
    with monkeypatch.context() as patched:
        patched.setattr("gpgrad_core.recordings.build.write_ply", interrupt)
        assert run(["build", str(recording), "--out", str(out)]) == 130
    said = capsys.readouterr().err
    assert said == "gpgrad: interrupted; run the same command to resume\n"
    assert {entry.name for entry in tmp_path.iterdir()} == {"data.partial"}


def test_a_refusal_leaves_nothing(recording: Path, tmp_path: Path) -> None:
    flags = ("--out", tmp_path / "data", "--max-uncertainty", "1", "--up=-y")
    assert "needs poses with covariances" in gpgrad("build", recording, *flags).refusal
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_what_was_built_closes_its_loop(tmp_path: Path) -> None:
    """Out, and back the other way over the same ground; the sensor is level and sees all around."""
    stops = [(0.0, 0.0), (4.0, 0.0), (8.0, 0.2), (4.3, 0.4)]
    scans = tmp_path / "drive"
    scans.mkdir()
    rows: list[str] = []
    for k, (x, y) in enumerate(stops):
        yaw = 0.0 if k < 3 else 3.0
        np.save(scans / f"{k}.npy", patch(x, y, yaw, seed=k))
        rows.append(f"{k} {x} {y} 0 0 0 {np.sin(yaw / 2):.9f} {np.cos(yaw / 2):.9f}")
    (scans / "poses.txt").write_text("\n".join(rows))
    out, closures = tmp_path / "data", tmp_path / "closures.json"
    flags = ("--max-length", "3.5", "--map.resolution", "0.06")
    assert run(["build", str(scans), "--out", str(out), *flags[:2]]) == 0
    assert run(["detect", str(out), "--out", str(closures), *flags[2:]]) == 0
    pairs = json.loads(closures.read_text())["pairs"]
    accepted = {(int(p["query"]), int(p["database"])) for p in pairs if p["accepted"]}
    assert (3, 1) in accepted
