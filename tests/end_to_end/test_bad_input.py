"""Input that cannot be used ends in one line that says what and where, and exit code 2."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.end_to_end.process import Run, run_here

PLY = """ply
format binary_little_endian 1.0
element vertex {count}
property float x
property float y
property float z
end_header
"""


def write_ply(path: Path, points: np.ndarray, *, announced: int | None = None) -> None:
    header = PLY.format(count=len(points) if announced is None else announced)
    path.write_bytes(header.encode() + points.astype("<f4").tobytes())


def empty(path: Path) -> None:
    write_ply(path, np.zeros((0, 3)))


def nothing_finite(path: Path) -> None:
    write_ply(path, np.full((50, 3), np.nan))


def one_point(path: Path) -> None:
    write_ply(path, np.ones((1, 3)))


def collinear(path: Path) -> None:
    write_ply(path, np.linspace(0, 1, 100)[:, None] * [1.0, 2.0, 0.5])


def truncated(path: Path) -> None:
    write_ply(path, np.random.default_rng(0).normal(size=(60, 3)), announced=100)


def headless(path: Path) -> None:
    path.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 3\n")


def ten_kilometres(path: Path) -> None:
    write_ply(path, np.random.default_rng(0).uniform(-5000, 5000, (5000, 3)) * [1, 1, 0.001])


BROKEN = {
    empty: "empty",
    nothing_finite: "finite",
    one_point: "found 1 of 1",
    collinear: "one line",
    truncated: "60",
    headless: "header",
    ten_kilometres: "more than the 12,000,000 allowed; raise the resolution",
}


@pytest.mark.parametrize("make", BROKEN, ids=lambda make: make.__name__)
def test_a_cloud_that_cannot_be_used(tmp_path: Path, make: Callable[[Path], None]) -> None:
    cloud = tmp_path / "broken.ply"
    make(cloud)
    line = run_here("map", cloud, "--out", tmp_path / "map.npz").refusal
    assert "broken" in line
    assert BROKEN[make] in line
    assert not (tmp_path / "map.npz").exists()


@pytest.mark.parametrize("make", [truncated, ten_kilometres], ids=lambda make: make.__name__)
def test_one_broken_cloud_of_a_dataset_is_named(
    gpgrad: Run, traverse: Path, tmp_path: Path, make: Callable[[Path], None]
) -> None:
    dataset = tmp_path / "data"
    shutil.copytree(traverse, dataset)
    (dataset / "submaps" / "002.xyz").unlink()
    make(dataset / "submaps" / "002.ply")
    out = tmp_path / "closures.json"
    line = gpgrad("detect", dataset, "--out", out).refusal
    assert "002" in line
    assert not out.exists()


@pytest.mark.slow
def test_broken_rows_are_dropped_and_counted_aloud(
    gpgrad: Run, traverse: Path, tmp_path: Path
) -> None:
    dataset = tmp_path / "data"
    shutil.copytree(traverse, dataset)
    for index in (1, 2):  # two submaps make one pair: enough here
        (dataset / "submaps" / f"00{index}.xyz").unlink()
    (dataset / "poses_odom.txt").unlink()
    cloud = dataset / "submaps" / "000.xyz"
    lines = cloud.read_text().splitlines()
    lines[3] = lines[9] = "nan 0 0"
    cloud.write_text("\n".join(lines))
    finished = gpgrad("detect", dataset, "--out", tmp_path / "closures.json")
    assert finished.code == 0, finished.err
    (note,) = finished.err.splitlines()
    assert note.startswith("gpgrad: ")
    assert "000.xyz" in note
    assert "2 of 5,000" in note


def test_a_missing_folder(gpgrad: Run, tmp_path: Path) -> None:
    line = gpgrad("detect", tmp_path / "nowhere", "--out", tmp_path / "a.json").refusal
    assert str(tmp_path / "nowhere") in line


def test_a_folder_without_clouds(gpgrad: Run, tmp_path: Path) -> None:
    line = gpgrad("detect", tmp_path, "--out", tmp_path / "a.json").refusal
    assert str(tmp_path) in line


def test_a_folder_where_a_cloud_is_wanted(gpgrad: Run, tmp_path: Path) -> None:
    assert "is a folder" in gpgrad("map", tmp_path, "--out", tmp_path / "a.npz").refusal


def test_a_pose_of_an_unknown_submap(gpgrad: Run, traverse: Path, tmp_path: Path) -> None:
    dataset = tmp_path / "data"
    shutil.copytree(traverse, dataset)
    with (dataset / "poses_odom.txt").open("a") as poses:
        poses.write("99 0 0 0 0 0 0 1\n")
    line = gpgrad("detect", dataset, "--out", tmp_path / "a.json").refusal
    assert "poses_odom.txt" in line
    assert "5" in line  # the line of the file
    assert "99" in line


def test_a_graph_without_odometry(gpgrad: Run, traverse: Path, tmp_path: Path) -> None:
    dataset = tmp_path / "data"
    shutil.copytree(traverse, dataset)
    (dataset / "poses_odom.txt").unlink()
    out, graph = tmp_path / "a.json", tmp_path / "a.g2o"
    line = gpgrad("detect", dataset, "--out", out, "--g2o", graph).refusal
    assert "needs odometry" in line
    assert not out.exists()


def test_parameters_that_there_are_not(gpgrad: Run, traverse: Path, tmp_path: Path) -> None:
    toml = tmp_path / "mine.toml"
    toml.write_text("[map]\nlenght_scale = 0.3\n")
    line = gpgrad("detect", traverse, "--out", tmp_path / "a.json", "--params", toml).refusal
    assert f"{toml}: unknown parameter map.lenght_scale" in line
    gone = tmp_path / "gone.toml"
    line = gpgrad("detect", traverse, "--out", tmp_path / "a.json", "--params", gone).refusal
    assert line == f"{gone}: No such file or directory"


def test_a_dataset_that_prefers_what_there_is_not(
    gpgrad: Run, traverse: Path, tmp_path: Path
) -> None:
    dataset = tmp_path / "data"
    shutil.copytree(traverse, dataset)
    (dataset / "dataset.toml").write_text("[preferred.map]\nlength_scale = -1\n")
    line = gpgrad("detect", dataset, "--out", tmp_path / "a.json").refusal
    assert "dataset.toml" in line
    assert "map.length_scale must be from 0.01 to 100 m, got -1" in line


@pytest.mark.parametrize(
    ("verb", "flag"),
    [("detect", "--registration.seed"), ("evaluate", "--seed"), ("fit", "--seed")],
)
@pytest.mark.parametrize("seed", ["-1", "4294967296", "99999999999999999999", "1.5", "nan"])
def test_a_seed_has_bounds(traverse: Path, tmp_path: Path, verb: str, flag: str, seed: str) -> None:
    out = [] if verb == "fit" else ["--out", str(tmp_path / "out")]
    refused = run_here(verb, traverse, *out, flag, seed).refusal
    assert "from 0 to 4294967295" in refused or "a whole number" in refused
    assert "seed" in refused


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--allow-origin", "*"), "--allow-origin *: must be http://HOST"),
        (("--allow-origin", "null"), "--allow-origin null: must be http://HOST"),
        (("--token", "short"), "--token must have 8 to 200"),
        (("--token", "long-enough", "--no-token"), "--no-token and --token exclude each other"),
    ],
)
def test_who_may_come_in_is_said_in_the_right_words(arguments: tuple[str, ...], words: str) -> None:
    assert words in run_here("view", "--no-open", *arguments).refusal
