"""A long recording: built in bounded memory, and to the same bytes however often it is killed."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from gpgrad_core.detection import infer_gradient_map
from gpgrad_core.evaluation.calibration import judge_errors
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.recordings.build import build_dataset
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.recording import simulate_recording
from gpgrad_core.types import Submap
from tests.core.recordings.test_build import contents
from tests.end_to_end.process import ROOT, environment
from tests.end_to_end.test_build import count_lines

NUM_SCANS = int(os.environ.get("GPGRAD_SCANS", "5000"))
PARAMS = SimulationParams(
    seed=5, num_submaps=24, spacing=5.0, route="loop", extent=60.0, field_of_view=1.2
)
KILLS = 5


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 120 m, 4 cm from scan to scan: kept, because it takes minutes to make."""
    kept = os.environ.get("GPGRAD_RECORDING")
    folder = Path(kept) if kept else tmp_path_factory.mktemp("recording") / "drive"
    if not folder.exists():
        simulate_recording(folder, NUM_SCANS, PARAMS, points_a_scan=5000)
    return folder


def start(recording: Path, out: Path) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(
        [sys.executable, "-m", "app", "build", str(recording), "--out", str(out)],
        env=environment(),
        cwd=ROOT,
    )


def test_five_thousand_scans(recording: Path, tmp_path: Path) -> None:
    begun = time.perf_counter()
    process = start(recording, tmp_path / "whole" / "data")
    _, process.returncode, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - begun
    assert process.returncode == 0
    peak = usage.ru_maxrss / 1024
    whole = contents(tmp_path / "whole" / "data")
    num_submaps = len(load_dataset(tmp_path / "whole" / "data").submaps)
    say(f"\n{NUM_SCANS:,} scans, {num_submaps} submaps: {seconds:.0f} s, {peak:.0f} MB at most")
    assert peak < 1000

    chance = random.Random(7)
    out, journal = tmp_path / "data", tmp_path / "data.partial" / "build.jsonl"
    for after in sorted(chance.sample(range(num_submaps), KILLS)):
        process = start(recording, out)
        while count_lines(journal) <= after:
            time.sleep(0.01)
            assert process.poll() is None
        time.sleep(chance.uniform(0.0, 0.8) * seconds / num_submaps)
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
        assert not out.exists()
        say(f"killed with {count_lines(journal) - 1} submaps noted down")
    process = start(recording, out)
    assert process.wait() == 0
    assert contents(out) == whole
    say("the result is the same to the byte")


def test_the_noise_of_a_mean_is_honest(recording: Path, tmp_path: Path) -> None:
    """Points held out lie where the map of the others expects them, with the noise of the file."""
    build_dataset(recording, tmp_path / "data")
    submaps = load_dataset(tmp_path / "data").submaps[::6]
    params = MapParams(noise_model="file", resolution=0.06)
    errors: list[np.ndarray] = []
    stds: list[np.ndarray] = []
    for submap in submaps:
        assert submap.noise_std is not None
        held_out = np.random.default_rng(0).random(len(submap.points)) < 0.1
        seen = Submap.from_points(
            submap.points[~held_out], submap.id, noise_std=submap.noise_std[~held_out]
        )
        made = infer_gradient_map(seen, params)
        points = submap.points[held_out]
        column, row = made.grid.to_pixel(points[:, :2]).T
        told, variance = (
            map_coordinates(image, [row, column], order=1, mode="nearest")
            for image in (made.elevation, made.variance)
        )
        errors.append(points[:, 2] - told)
        stds.append(np.sqrt(variance + submap.noise_std[held_out] ** 2))
    judged = judge_errors("file", np.concatenate(errors), np.concatenate(stds), params)
    say(f"{judged.within_68:.1%} within 68.3 %, {judged.within_95:.1%} within 95 %")
    assert 0.6 < judged.within_68 < 0.78
    assert judged.within_95 > 0.93


def say(line: str) -> None:
    print(line, flush=True)
