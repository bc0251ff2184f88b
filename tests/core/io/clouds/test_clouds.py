"""Every format keeps what was written; every broken file is refused in one line."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gpgrad_core.io.clouds import load_cloud, load_cloud_with_notes
from gpgrad_core.io.clouds.ply import write_ply
from tests.core.io.test_formats import WORLD, by_laspy
from tests.support.laws import examples
from tests.support.refusal import assert_refused


@pytest.fixture
def world_points() -> np.ndarray:
    """Terrain in map coordinates, where float32 has steps of half a metre."""
    return WORLD + np.random.default_rng(3).uniform(-5, 5, (40, 3))


def test_a_cut_las(tmp_path: Path, world_points: np.ndarray) -> None:
    for ending, rule in ((".las", "is cut short"), (".laz", "not a complete LAS file")):
        path = tmp_path / f"a{ending}"
        by_laspy(path, world_points)
        path.write_bytes(path.read_bytes()[:300])
        assert_refused(lambda path=path: load_cloud(path), str(path), rule)


def test_las_without_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "lazrs", None)
    path = tmp_path / "a.laz"
    path.write_bytes(b"LASF")
    assert_refused(lambda: load_cloud(path), str(path), "pip install 'gpgrad[las]'")


@examples(50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    offsets=hnp.arrays(np.float64, (20, 3), elements=st.floats(-300, 300, width=32)),
)
def test_written_points_come_back_within_float32(offsets: np.ndarray, tmp_path: Path) -> None:
    # A square under the drawn points, because points on one line are no terrain.
    points = np.vstack([offsets, [[0, 0, 0], [9, 0, 0], [0, 9, 0]]])
    write_ply(tmp_path / "a.ply", points)
    np.testing.assert_array_equal(
        load_cloud(tmp_path / "a.ply").points, points.astype(np.float32).astype(np.float64)
    )


def test_rows_that_are_not_finite_are_dropped_and_counted(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(size=(30_000, 3))
    points[:7, 2] = np.nan
    points[7:12, 0] = np.inf
    np.save(tmp_path / "003.npy", points)
    submap, notes = load_cloud_with_notes(tmp_path / "003.npy")
    assert submap.num_dropped == 12
    assert len(submap.points) == 29_988
    assert notes == ("003.npy: 12 of 30,000 rows are not finite and were dropped",)
    points[1:12] = 0.0
    np.save(tmp_path / "003.npy", points)
    _, notes = load_cloud_with_notes(tmp_path / "003.npy")
    assert notes == ("003.npy: 1 of 30,000 rows is not finite and was dropped",)


def test_wild_points_are_left_out_counted_and_told(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(size=(3000, 3))
    np.save(tmp_path / "clean.npy", points)
    np.save(tmp_path / "one.npy", np.vstack([points, [[0.5, 0.5, 1e3]]]))
    np.save(tmp_path / "two.npy", np.vstack([[[0.5, 0.5, -40.0], [900.0, 0.0, 0.5]], points]))
    clean = load_cloud(tmp_path / "clean.npy")
    one, notes = load_cloud_with_notes(tmp_path / "one.npy")
    assert (one.fingerprint, one.num_wild) == (clean.fingerprint, 1)
    assert notes == ("one.npy: 1 of 3,001 points was left out: no ground explains it",)
    two, notes = load_cloud_with_notes(tmp_path / "two.npy")
    assert (two.fingerprint, two.num_wild) == (clean.fingerprint, 2)
    assert notes == ("two.npy: 2 of 3,002 points were left out: no ground explains them",)


def test_world_coordinates_in_float32_are_told(tmp_path: Path, world_points: np.ndarray) -> None:
    np.save(tmp_path / "a.npy", world_points.astype(np.float32))
    _, notes = load_cloud_with_notes(tmp_path / "a.npy")
    assert len(notes) == 1
    assert "5,123,46" in notes[0]
    assert "steps of 0.5 m" in notes[0]


def test_whole_numbers_are_points_too(tmp_path: Path) -> None:
    points = np.array([[0, 0, 1], [10, 0, 2], [0, 10, 3]])
    np.save(tmp_path / "a.npy", points)
    np.testing.assert_array_equal(load_cloud(tmp_path / "a.npy").points, points)


def test_a_range_below_nothing(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(size=(9, 3))
    write_ply(tmp_path / "a.ply", points, extras={"range": -np.ones(9)})
    assert_refused(lambda: load_cloud(tmp_path / "a.ply"), "a.ply: range must be 0 m or more")


def test_a_cut_kitti_scan(tmp_path: Path) -> None:
    (tmp_path / "cut.bin").write_bytes(bytes(43))
    assert_refused(lambda: load_cloud(tmp_path / "cut.bin"), "not a complete KITTI scan")


def test_npz_takes_the_only_array_of_points(tmp_path: Path) -> None:
    points = np.random.default_rng(1).normal(size=(9, 3))
    np.savez(tmp_path / "a.npz", cloud=points, stamp=np.arange(3))
    np.testing.assert_array_equal(load_cloud(tmp_path / "a.npz").points, points)
    np.savez(tmp_path / "b.npz", first=points, second=points)
    assert_refused(
        lambda: load_cloud(tmp_path / "b.npz"), "b.npz", "'points'", "first (9, 3), second (9, 3)"
    )
    np.savez(tmp_path / "c.npz", points=points[:, :2])
    assert_refused(lambda: load_cloud(tmp_path / "c.npz"), "array 'points'", "(9, 2)")


def test_a_missing_file_and_an_unknown_ending(tmp_path: Path) -> None:
    assert_refused(lambda: load_cloud(tmp_path / "none.ply"), "none.ply: no such file")
    (tmp_path / "a.e57").touch()
    assert_refused(
        lambda: load_cloud(tmp_path / "a.e57"),
        "a.e57: unknown ending '.e57'",
        ".bin .csv .las .laz .npy .npz .pcd .ply .xyz",
    )
    (tmp_path / "folder.ply").mkdir()
    assert_refused(lambda: load_cloud(tmp_path / "folder.ply"), "folder.ply: cannot be read")


@pytest.mark.parametrize(
    ("points", "rule"),
    [
        (np.zeros((0, 3)), "empty cloud"),
        (np.full((5, 3), np.nan), "found 0 of 5"),
        (np.zeros((4, 2)), "shape (n, 3), got float64 (4, 2)"),
        (np.array([["a", "b", "c"]]), "must be numbers"),
    ],
)
def test_clouds_that_are_no_terrain(points: np.ndarray, rule: str, tmp_path: Path) -> None:
    path = tmp_path / "000.npy"
    np.save(path, points)
    assert_refused(lambda: load_cloud(path), f"{path}: ", rule)


def test_broken_archives(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(1000, 3))
    for name, save in {"a.npy": np.save, "a.npz": np.savez}.items():
        path = tmp_path / name
        save(path, points)
        whole = path.read_bytes()
        for broken in (whole[: len(whole) // 2], whole[:9], b"", b"no archive\n" * 9):
            path.write_bytes(broken)
            assert_refused(lambda path=path: load_cloud(path), f"{path}: is not a complete")
    np.save(tmp_path / "b.npy", np.array([{"pickled": 1}], dtype=object), allow_pickle=True)
    assert_refused(lambda: load_cloud(tmp_path / "b.npy"), "b.npy: is not a complete NPY")
    with (tmp_path / "c.npy").open("wb") as file:
        np.savez(file, points=points)
    assert_refused(lambda: load_cloud(tmp_path / "c.npy"), "rename it to .npz")
    with (tmp_path / "d.npz").open("wb") as file:
        np.save(file, points)
    assert_refused(lambda: load_cloud(tmp_path / "d.npz"), "rename it to .npy")
    # Compressed, and damaged in the middle.
    np.savez_compressed(tmp_path / "e.npz", points=points)
    damaged = bytearray((tmp_path / "e.npz").read_bytes())
    damaged[5000:5050] = bytes(50)
    (tmp_path / "e.npz").write_bytes(damaged)
    assert_refused(lambda: load_cloud(tmp_path / "e.npz"), "e.npz: is not a complete NPZ")


def test_a_damaged_shape_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((1000, 3)))
    data = (tmp_path / "a.npy").read_bytes()
    for shape in (b"(9999999, 3)", b"(9" + b"9" * 14 + b", 3)"):
        damaged = data[:128].replace(b"(1000, 3), }", shape + b", }")[:128] + data[128:]
        (tmp_path / "a.npy").write_bytes(damaged[:127] + b"\n" + damaged[128:])
        assert_refused(lambda: load_cloud(tmp_path / "a.npy"), "a.npy: is not a complete NPY")
