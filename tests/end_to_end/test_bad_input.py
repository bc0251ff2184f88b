"""Input that cannot be used ends in one line that says what and where, and exit code 2.

What cannot be used is told apart where it is read, in tests/core; here the commands say so.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.end_to_end.process import gpgrad

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


def truncated(path: Path) -> None:
    write_ply(path, np.random.default_rng(0).normal(size=(60, 3)), announced=100)


def ten_kilometres(path: Path) -> None:
    write_ply(path, np.random.default_rng(0).uniform(-5000, 5000, (5000, 3)) * [1, 1, 0.001])


BROKEN = {
    truncated: "60",
    ten_kilometres: "more than the 12,000,000 allowed; raise the resolution",
}


@pytest.mark.parametrize("make", BROKEN, ids=lambda make: make.__name__)
def test_a_cloud_that_cannot_be_used(tmp_path: Path, make: Callable[[Path], None]) -> None:
    cloud = tmp_path / "broken.ply"
    make(cloud)
    line = gpgrad("map", cloud, "--out", tmp_path / "map.npz").refusal
    assert "broken" in line
    assert BROKEN[make] in line
    assert not (tmp_path / "map.npz").exists()


@pytest.mark.parametrize("make", BROKEN, ids=lambda make: make.__name__)
def test_one_broken_cloud_of_a_dataset_is_named(
    data: Path, tmp_path: Path, make: Callable[[Path], None]
) -> None:
    (data / "submaps" / "002.xyz").unlink()
    make(data / "submaps" / "002.ply")
    out = tmp_path / "closures.json"
    line = gpgrad("detect", data, "--out", out).refusal
    assert "002" in line
    assert not out.exists()


def test_broken_rows_are_dropped_and_counted_aloud(data: Path, tmp_path: Path) -> None:
    for index in (1, 2):  # two submaps make one pair: enough here
        (data / "submaps" / f"00{index}.xyz").unlink()
    (data / "poses_odom.txt").unlink()
    cloud = data / "submaps" / "000.xyz"
    lines = cloud.read_text().splitlines()
    lines[3] = lines[9] = "nan 0 0"
    cloud.write_text("\n".join(lines))
    finished = gpgrad("detect", data, "--out", tmp_path / "closures.json")
    assert finished.code == 0, finished.err
    (note,) = finished.err.splitlines()
    assert note.startswith("gpgrad: ")
    assert "000.xyz" in note
    assert "2 of 5,000" in note


@pytest.fixture
def data(traverse: Path, tmp_path: Path) -> Path:
    """A traverse that may be spoilt."""
    return shutil.copytree(traverse, tmp_path / "data")


def with_an_empty_folder(data: Path) -> None:
    (data / "images").mkdir()


def without_odometry(data: Path) -> None:
    (data / "poses_odom.txt").unlink()


def with_a_stray_pose(data: Path) -> None:
    with (data / "poses_odom.txt").open("a") as poses:
        poses.write("99 0 0 0 0 0 0 1\n")


def with_a_wrong_preference(data: Path) -> None:
    (data / "dataset.toml").write_text("[preferred.map]\nlength_scale = -1\n")


def with_unknown_parameters(data: Path) -> None:
    (data / "mine.toml").write_text("[map]\nlenght_scale = 0.3\n")


@pytest.mark.parametrize(
    ("arguments", "said", "spoil"),
    [
        ("detect {data}/nowhere --out {out}", "{data}/nowhere", None),
        (
            "detect {data}/images --out {out}",
            "{data}/images",
            with_an_empty_folder,
        ),
        ("map {data} --out {out}.npz", "is a folder", None),
        ("slam {data} {data} --out {out}", "{data}: is named twice", None),
        ("view {data}/nowhere --no-open", "nowhere", None),
        ("evaluate {data} --out {out}", "add poses_gt.txt", None),
        ("detect {data} --out {out} --pair 003 003", "003 beside itself", None),
        ("detect {data} --out {out} --candidates some", "a whole number, all or automatic", None),
        ("detect {data} --out {out} --g2o {out}.g2o", "needs odometry", without_odometry),
        ("detect {data} --out {out}", "poses_odom.txt, line 5", with_a_stray_pose),
        (
            "detect {data} --out {out} --params {data}/mine.toml",
            "{data}/mine.toml: unknown parameter map.lenght_scale",
            with_unknown_parameters,
        ),
        (
            "detect {data} --out {out} --params {data}/gone.toml",
            "{data}/gone.toml: No such file or directory",
            None,
        ),
        (
            "detect {data} --out {out}",
            "dataset.toml, [preferred]: map.length_scale must be from 0.01 to 100 m, got -1",
            with_a_wrong_preference,
        ),
    ],
)
def test_an_input_that_cannot_be_used(
    arguments: str, said: str, spoil: Callable[[Path], None] | None, data: Path, tmp_path: Path
) -> None:
    if spoil is not None:
        spoil(data)
    places = {"data": data, "out": tmp_path / "a.json"}
    assert said.format(**places) in gpgrad(*arguments.format(**places).split()).refusal
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


@pytest.mark.parametrize(
    ("verb", "flag"),
    [("detect", "--registration.seed"), ("evaluate", "--seed"), ("fit", "--seed")],
)
@pytest.mark.parametrize("seed", ["-1", "4294967296", "99999999999999999999", "1.5", "nan"])
def test_a_seed_has_bounds(traverse: Path, tmp_path: Path, verb: str, flag: str, seed: str) -> None:
    out = [] if verb == "fit" else ["--out", str(tmp_path / "out")]
    refused = gpgrad(verb, traverse, *out, flag, seed).refusal
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
    assert words in gpgrad("view", "--no-open", *arguments).refusal
