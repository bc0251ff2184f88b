"""`gpgrad fit`, as a process."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.end_to_end.process import gpgrad
from tests.support.ground import cloud


@pytest.fixture
def ground(tmp_path: Path) -> Path:
    np.save(tmp_path / "ground.npy", cloud(0, 1000, noise=0.02))
    return tmp_path / "ground.npy"


@pytest.mark.slow
def test_what_is_found_is_told_and_serves_other_verbs(ground: Path, tmp_path: Path) -> None:
    out = tmp_path / "fit.toml"
    finished = gpgrad("fit", ground, "--out", out)
    assert finished.code == 0, finished.err
    assert finished.err == ""
    length_scale, signal, noise, likelihood, file = finished.out.splitlines()
    assert length_scale.startswith("length_scale: 0.3 -> ")
    assert length_scale.endswith(" m")
    assert signal.startswith("signal_std: the points' own -> ")
    before, after = noise.removeprefix("noise_std: ").removesuffix(" m").split(" -> ")
    assert before == "0.05"
    assert float(after) == pytest.approx(0.02, rel=0.1)
    assert "1 submap, " in likelihood
    before, after = likelihood.split(": ")[1].split(" (")[0].split(" -> ")
    assert float(after) > float(before)
    assert file == str(out)
    read = gpgrad("fit", ground, "--params", out, "--map.noise-model", "measured")
    assert read.out.startswith(f"length_scale: {length_scale.split()[3]} -> ")
    assert "noise_factor: 1 -> " in read.out


@pytest.mark.slow
def test_every_submap_gets_the_numbers_that_the_paper_method_uses(tmp_path: Path) -> None:
    folder, out = tmp_path / "data", tmp_path / "fits.csv"
    folder.mkdir()
    for k in range(2):
        np.save(folder / f"{k:03d}.npy", cloud(k, 300, noise=0.02))
    finished = gpgrad("fit", folder, "--each", "--out", out)
    assert finished.code == 0, finished.err
    head, *rows, file = finished.out.splitlines()
    names = ("submap", "length_scale [m]", "signal_std [m]", "noise_std [m]")
    assert all(name in head for name in names)
    assert file == str(out)
    assert [line.split(",") for line in out.read_text().splitlines()[1:]] == [
        row.split() for row in rows
    ]
    closures = tmp_path / "closures.json"
    assert gpgrad("detect", folder, "--out", closures, "--method", "paper").code == 0
    for row, own in zip(rows, json.loads(closures.read_text())["submaps"], strict=True):
        numbers = (own[name] for name in ("length_scale", "signal_std", "noise_std"))
        assert row.split()[:4] == [own["id"], *(f"{number:.4g}" for number in numbers)]
    refused = gpgrad("fit", folder, "--each", "--out", tmp_path / "fits.toml")
    assert refused.refusal.endswith("the ending must be one of .csv")
