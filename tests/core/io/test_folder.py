"""Dataset folders: what belongs together is found, what contradicts itself is refused."""

import gc
import random
import tempfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from gpgrad_core.io.clouds import load_cloud
from gpgrad_core.io.clouds.ply import write_ply
from gpgrad_core.io.folder import (
    SubmapFile,
    index_of,
    load_dataset,
    open_dataset,
    outline_dataset,
    write_dataset,
)
from gpgrad_core.run import Cancelled
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import Dataset, Submap
from tests.core.io.test_formats import COLORS, NOISE, RANGES
from tests.support.laws import examples
from tests.support.refusal import assert_refused


def cloud(seed: int = 0) -> np.ndarray:
    rows = np.random.default_rng(seed).uniform(-5, 5, (30, 3))
    return rows.astype(np.float32).astype(np.float64)


def pose(seed: int) -> Pose:
    return Pose.from_planar(SE2(seed, 2.0, seed), 3.0)


OF_POINTS: list[dict[str, Any]] = [
    {"noise_std": NOISE[:30], "ranges": RANGES[:30]},
    {"colors": COLORS[:30]},
    {},
]
"""What is known of each point of the submaps."""


def dataset() -> Dataset:
    return Dataset(
        name="a crater",
        submaps=tuple(
            Submap.from_points(
                cloud(k), f"{k:03d}", pose_true=pose(k), pose_odometry=pose(k + 10), **known
            )
            for k, known in enumerate(OF_POINTS)
        ),
        description="three times\nthe same crater",
        licence="CC0",
        preferred={"query": "002", "database": "000", "map": {"length_scale": 0.2}},
        sensor_noise={"constant": 0.01, "quadratic": 0.002},
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_dataset(dataset(), tmp_path / "set")
    return tmp_path / "set"


def test_what_is_written_comes_back_and_progress_is_told(tmp_path: Path) -> None:
    written, heard = dataset(), list[float]()
    write_dataset(written, tmp_path / "set", heard.append)
    for name in ("001/b.png", "001/a.jpg", "001/notes.txt", "005/a.png"):
        file = tmp_path / "set" / "images" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"")
    back = load_dataset(tmp_path / "set", heard.append)
    assert heard == pytest.approx(2 * [1 / 3, 2 / 3, 1.0])
    for name in ("name", "description", "licence", "preferred", "sensor_noise", "notes"):
        assert getattr(back, name) == getattr(written, name)
    for k, (a, b) in enumerate(zip(written.submaps, back.submaps, strict=True)):
        assert a.id == b.id
        np.testing.assert_array_equal(b.points, a.points)
        for name in ("pose_true", "pose_odometry"):
            before, after = getattr(a, name), getattr(b, name)
            np.testing.assert_allclose(after.translation, before.translation, atol=1e-6)
            np.testing.assert_allclose(after.rotation, before.rotation, atol=1e-8)
        for name in ("noise_std", "ranges", "colors"):
            before, after = getattr(a, name), getattr(b, name)
            assert (after is None) == (name not in OF_POINTS[k])
            if after is not None:
                np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-9)
        alone = load_cloud(tmp_path / "set" / "submaps" / f"{a.id}.ply")
        assert alone.fingerprint == b.fingerprint
    assert a.fingerprint == b.fingerprint  # of points alone
    assert [[file.name for file in b.images] for b in back.submaps] == [[], ["a.jpg", "b.png"], []]


def test_a_single_cloud_and_a_bare_folder_are_datasets(folder: Path) -> None:
    single = load_dataset(folder / "submaps" / "001.ply")
    assert [submap.id for submap in single.submaps] == ["001"]
    assert single.name == "001"
    bare = load_dataset(str(folder / "submaps"))
    assert [submap.id for submap in bare.submaps] == ["000", "001", "002"]
    assert bare.name == "submaps"
    assert all(submap.pose_true is None for submap in bare.submaps)


def test_gaps_missing_poses_and_strangers_are_fine(folder: Path) -> None:
    (folder / "submaps" / "001.ply").unlink()
    (folder / "poses_gt.txt").write_text("2 0 0 0 0 0 0 1\n")
    (folder / "poses_odom.txt").unlink()
    (folder / "submaps" / "thumbnail.jpg").touch()
    (folder / "submaps" / "old").mkdir()
    (folder / "submaps" / ".DS_Store").touch()
    (folder / "images" / "000").mkdir(parents=True)
    (folder / "pairs_iou.csv").write_text("i,j\n0,2\n")
    loaded = load_dataset(folder)
    assert [submap.id for submap in loaded.submaps] == ["000", "002"]
    assert [submap.pose_true is None for submap in loaded.submaps] == [True, False]
    assert all(submap.pose_odometry is None for submap in loaded.submaps)
    assert loaded.notes == (
        "submaps/old: is not a cloud and was ignored",
        "submaps/thumbnail.jpg: is not a cloud and was ignored",
    )


def test_poses_txt_stands_in_for_odometry(folder: Path) -> None:
    (folder / "poses.txt").write_text("0 7 7 7 0 0 0 1\n")
    ignored = "poses.txt: was ignored, because there is also poses_odom.txt"
    assert load_dataset(folder).notes == (ignored,)
    (folder / "poses_odom.txt").unlink()
    first = load_dataset(folder).submaps[0]
    np.testing.assert_array_equal(first.pose_odometry.translation, [7, 7, 7])


@examples(20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    numbers=st.lists(st.integers(0, 10**6), min_size=1, max_size=8, unique=True),
    seed=st.integers(0, 1000),
)
def test_order_is_by_number_whatever_the_order_of_files_and_others_are_last(
    numbers: list[int], seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("bare")
    names = {number: f"run2_map-{number}.npy" for number in numbers}
    np.save(folder / "crater.npy", cloud(0))
    for number in random.Random(seed).sample(numbers, len(numbers)):
        np.save(folder / names[number], cloud(number))
    np.save(folder / "dune.npy", cloud(0))
    loaded = load_dataset(folder)
    found = [index_of(submap.id) for submap in loaded.submaps]
    assert found == [*sorted(numbers), None, None]


def test_the_number_that_differs_is_the_submaps(tmp_path: Path) -> None:
    for k in (2, 10):
        np.save(tmp_path / f"submap_{k:03d}_voxel0.05.npy", cloud(k))
    (tmp_path / "poses.txt").write_text("# index x y z qw qx qy qz\n10 1 2 3 0.6 0 0 0.8\n")
    loaded = load_dataset(tmp_path)
    assert [submap.id for submap in loaded.submaps] == ["submap_002", "submap_010"]
    second = load_cloud(next(tmp_path.glob("*10_*")))
    np.testing.assert_array_equal(loaded.submaps[1].points, second.points)
    pose = loaded.submaps[1].pose_odometry
    np.testing.assert_array_equal(pose.quaternion, [0, 0, 0.8, 0.6])
    assert "submap_002_voxel0.05.npy: is submap submap_002, by the number that" in loaded.notes[0]


@pytest.mark.parametrize(
    ("names", "ids"),
    [
        (["1700000000.9", "1700000001.1", "1700000000.25"], [2, 0, 1]),
        (["1700000000.900000000", "1700000001.50000000", "1700000001.400000000"], [0, 1, 2]),
        (["1700000000_900000000", "1700000001_50000000", "1700000001_400000000"], [0, 1, 2]),
        (["1700000000-900000000", "1700000001-050000000", "1700000001-400000000"], [0, 1, 2]),
        (["2021-03-04-10-59-59", "2021-03-04-11-00-00", "2021-03-04-11-00-01"], [0, 1, 2]),
        (["20210304_105959_v2", "20210304_110000_v1", "20210304_110001_v2"], [0, 1, 2]),
        (["1700000001_50000000", "1700000000_90000000", "1700000001_60000000"], [1, 0, 2]),
        (["1700000000_900000000_v2", "1700000001_9_v1", "1700000001_40000000_v2"], [0, 1, 2]),
        (["1700000000.900000000_v1", "1700000001.50000000_v1", "1700000001.4_v1"], [0, 2, 1]),
        (["1700000000_900000000_0", "1700000001_900000000_0", "1700000001_0_0"], [0, 2, 1]),
    ],
)
def test_times_in_names_sort_as_times(names: list[str], ids: list[int], tmp_path: Path) -> None:
    for k, name in enumerate(names):
        np.save(tmp_path / f"{name}.npy", cloud(k))
    found = [submap.fingerprint for submap in load_dataset(tmp_path).submaps]
    assert found == [load_cloud(tmp_path / f"{names[k]}.npy").fingerprint for k in ids]
    np.save(tmp_path / "1700000002.123456789.npy", cloud())
    if names[0].endswith(".9"):  # a decimal, or nine nanoseconds
        assert_refused(lambda: load_dataset(tmp_path), "may be decimals of a second or nanosec")


@pytest.mark.parametrize("ending", [".npy", ".ply", ".laz", ".bin"])
def test_a_cloud_that_cannot_be_a_map_is_left_out_of_a_folder(ending: str, tmp_path: Path) -> None:
    line = np.linspace([0, 0, 0], [5, 5, 1], 30)
    for k, points in enumerate((cloud(), np.full((9, 3), np.nan), line, np.zeros((0, 3)), cloud())):
        np.save(tmp_path / f"{k}.npy", points)
    (tmp_path / "3.npy").rename(tmp_path / f"3{ending}")
    if ending != ".npy":
        (tmp_path / f"3{ending}").write_bytes(b"")
    (tmp_path / "dataset.toml").write_text('[preferred]\nquery = "4"\ndatabase = "2"\n')
    opened, sources = open_dataset(tmp_path)
    loaded = load_dataset(tmp_path)
    for dataset in (opened, loaded):
        assert [submap.id for submap in dataset.submaps] == ["0", "4"]
        assert dataset.preferred == {"query": "4"}
        for note, said in zip(
            dataset.notes, ("found 0 of 9", "all 30 points lie on one line", "empty"), strict=True
        ):
            assert said in note
            assert note.endswith(": it was left out")
    assert [source.load().num_points for source in sources] == [30, 30]
    assert [s.id for s in outline_dataset(tmp_path).terrains(range(5))] == ["0", "4"]
    assert_refused(lambda: load_dataset(tmp_path / f"3{ending}"), f"3{ending}: is ", "empty")
    assert_refused(lambda: load_dataset(tmp_path / "2.npy"), "2.npy: all 30 points lie on one line")
    for k in (0, 4):
        (tmp_path / f"{k}.npy").unlink()
    for read in (load_dataset, open_dataset):
        (tmp_path / "dataset.toml").unlink(missing_ok=True)
        assert_refused(lambda read=read: read(tmp_path), "1.npy: a terrain needs 3 or more")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count"), [("marsyard2021", 29), ("sthelens", 24), ("apollo15", 25)]
)
def test_the_real_sets_load(name: str, count: int, real_data: Path) -> None:
    loaded = load_dataset(real_data / name)
    assert len(loaded.submaps) == count
    assert loaded.notes == ()
    for submap in loaded.submaps:
        assert 3 < len(submap.points) <= 30_000
        assert submap.pose_true is not None
        assert submap.pose_odometry is not None


def test_clouds_that_wait_in_a_file_are_used_like_any_others(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, some = load_dataset(folder), load_dataset(folder, most_bytes=1500)
    assert some.notes == whole.notes
    for waiting, loaded in zip(some.submaps, whole.submaps, strict=True):
        np.testing.assert_array_equal(waiting.points, loaded.points)
        assert (waiting.id, waiting.fingerprint) == (loaded.id, loaded.fingerprint)
        assert not waiting.points.flags.writeable

    def cancel(_fraction: float) -> None:
        raise Cancelled

    # A file that is left to the garbage collector is a warning, and so a failure.
    with pytest.raises(Cancelled):
        load_dataset(folder, cancel, most_bytes=0)
    gc.collect()
    nowhere = str(tmp_path / "nowhere")
    monkeypatch.setattr(tempfile, "tempdir", nowhere)
    refusal = f"{nowhere}: the points cannot wait there"
    assert_refused(lambda: load_dataset(folder, most_bytes=0), refusal)


@pytest.mark.parametrize("case", [(0, 0, 2), (1500, 1, 0), (10**9, 3, 2)])
def test_a_dataset_is_opened_without_its_points(case: tuple[int, int, int], folder: Path) -> None:
    most_bytes, held, threads = case
    whole, checked, told = load_dataset(folder), list[str](), list[float]()
    with ThreadPoolExecutor(threads) if threads else nullcontext() as executor:
        opened, sources = open_dataset(
            folder,
            told.append,
            check=lambda submap: checked.append(submap.id),
            most_bytes=most_bytes,
            executor=executor,
        )
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert checked == [source.id for source in sources] == [submap.id for submap in whole.submaps]
    assert opened.notes == whole.notes
    assert sum(not isinstance(source, SubmapFile) for source in sources) == held
    for source, outlined, submap in zip(sources, opened.submaps, whole.submaps, strict=True):
        loaded = source.load()
        assert len(outlined.points) == 0
        assert source.num_points == loaded.num_points == 30
        assert source.fingerprint == loaded.fingerprint == submap.fingerprint
        np.testing.assert_equal(vars(loaded.pose_true), vars(submap.pose_true))
        np.testing.assert_array_equal(loaded.points, submap.points)


def test_a_cloud_is_read_again_without_outliers_and_refused_if_it_changes(tmp_path: Path) -> None:
    ground = np.random.default_rng(0).uniform(-5, 5, (400, 3)) * (1, 1, 0.01)
    submap = Submap.from_points(ground, "000")
    spoiled = replace(submap, points=np.vstack([ground, [[0.0, 0.0, 50.0]]]))
    write_dataset(Dataset("spoiled", (spoiled,)), tmp_path / "set")
    _, (source,) = open_dataset(tmp_path / "set", most_bytes=0)
    again = source.load()
    assert (again.num_wild, again.num_points) == (1, 400)
    assert again.fingerprint == source.fingerprint
    write_ply(tmp_path / "set" / "submaps" / "000.ply", cloud(9))
    assert_refused(source.load, "000.ply: has changed since the run began")


@pytest.mark.parametrize(
    ("names", "text", "rule"),
    [
        ("submaps/1.npy", "", "001.ply and 1.npy both have the number 1; rename"),
        ("submaps/dune.npy submaps/dune.npz", "", "dune.npy and dune.npz both have the name dune"),
        ("submaps/001.ply", "ply\n", "submaps/001.ply: is cut short"),
        ("poses_odom.txt", "#\n9 0 0 0 0 0 0 1\n", "poses_odom.txt, line 2: names submap 9"),
        ("dataset.toml", "[preferred]\nquery = '9'", "dataset.toml: preferred.query names submap"),
    ],
)
def test_what_contradicts_itself_is_refused(names: str, text: str, rule: str, folder: Path) -> None:
    for name in names.split():
        (folder / name).write_text(text)
    for read in (load_dataset, partial(open_dataset, most_bytes=0)):
        assert_refused(lambda read=read: read(folder), str(folder), rule)


def test_places_that_hold_nothing(tmp_path: Path, folder: Path) -> None:
    assert_refused(lambda: load_dataset(tmp_path / "none"), "none: no such file or folder")
    (tmp_path / "empty").mkdir()
    assert_refused(lambda: load_dataset(tmp_path / "empty"), "empty: holds no clouds (.bin .csv")
    assert_refused(lambda: load_dataset(tmp_path), "it holds the datasets set; give one of them")
    for path in (folder / "submaps").iterdir():
        path.unlink()
    assert_refused(lambda: load_dataset(folder), "submaps: holds no clouds")


def test_where_a_dataset_may_be_written(tmp_path: Path) -> None:
    target = tmp_path / "set"
    target.mkdir()
    (target / "diary.txt").write_text("mine")
    assert_refused(lambda: write_dataset(dataset(), target), f"{target}: is not empty")
    assert_refused(lambda: write_dataset(dataset(), target / "diary.txt"), "is a file")
    inside = target / "diary.txt" / "set"
    assert_refused(lambda: write_dataset(dataset(), inside), "cannot be written")
    assert [path.name for path in tmp_path.rglob("*")] == ["set", "diary.txt"]
    (target / "diary.txt").unlink()

    def stop(fraction: float) -> None:
        if fraction > 0.5:
            raise Cancelled

    with pytest.raises(Cancelled):
        write_dataset(dataset(), tmp_path / "stopped", stop)
    assert list(tmp_path.rglob("*")) == [target]
    write_dataset(dataset(), target)
    write_dataset(dataset(), str(tmp_path / "deep" / "down" / "set"))
    for path in (target, tmp_path / "deep" / "down" / "set"):
        assert len(load_dataset(path).submaps) == 3


@pytest.mark.parametrize(
    ("ids", "rule"),
    [
        (["a/000", "001"], "'a/000' cannot be a file name"),
        (["../000", "001"], "cannot be a file name"),
        (["1", "001"], "'1' and '001' both have the number 1"),
        (["dune"], "'dune' has a pose"),
    ],
)
def test_ids_that_cannot_be_files_are_refused(ids: list[str], rule: str, tmp_path: Path) -> None:
    submaps = (
        Submap.from_points(cloud(k), name, pose_true=pose(1) if name == "dune" else None)
        for k, name in enumerate(ids)
    )
    assert_refused(lambda: write_dataset(Dataset("bad", tuple(submaps)), tmp_path / "set"), rule)
