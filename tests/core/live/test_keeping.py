"""Kept submaps are what was given, and a record that was stopped anywhere is gone on with."""

import contextlib
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.io.records.files import replacing
from gpgrad_core.live.keeping import Keeper
from gpgrad_core.slam.run_file import RunSettings, read_run
from gpgrad_core.types import Submap
from tests.core.live.submaps import assert_same_submap, row
from tests.support.refusal import assert_refused

FEW = row(3)


@pytest.mark.parametrize("named", [True, False])
def test_a_kept_submap_is_the_same(tmp_path: Path, named: bool) -> None:
    keeper = Keeper(tmp_path / "run.gpgrad" if named else None)
    full = Submap.from_points(
        np.vstack([FEW[0].points, [[0.0, 0.0, 50.0]]]),
        "full_9",
        pose_odometry=FEW[0].pose_odometry,
        noise_std=np.full(61, 0.1),
        ranges=np.full(61, 3.0),
        colors=np.full((61, 3), 0.5),
    )
    for submap in (*FEW, full):
        assert keeper.keep(submap)
    assert keeper.names == ("000", "001", "002", "full_9")
    for submap in (*FEW, full):
        assert_same_submap(keeper.submap(submap.id), submap)
    given = keeper.submap("001")
    with pytest.raises(ValueError, match="read-only"):
        given.points[0, 0] = 1.0
    keeper.close()
    assert_same_submap(given, FEW[1])  # what was given back outlives the file


def test_an_id_comes_once(tmp_path: Path) -> None:
    keeper = Keeper(tmp_path / "run.gpgrad")
    assert keeper.keep(FEW[0])
    assert not keeper.keep(FEW[0])
    other = replace(FEW[1], id="000")
    assert_refused(lambda: keeper.keep(other), "000", "another content")
    assert_refused(lambda: keeper.keep(replace(FEW[1], pose_odometry=None)), "no odometry pose")
    keeper.close()


def test_wherever_it_was_stopped_the_promised_ones_stay(tmp_path: Path) -> None:
    path = tmp_path / "run.gpgrad"
    ends: list[int] = []
    for count in range(1, 4):
        keeper = Keeper(path, lambda _: RunSettings("mine"))
        for submap in FEW[:count]:
            keeper.keep(submap)
        keeper.close()
        ends.append(path.stat().st_size)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for end in [*ends, *rng.integers(ends[0], len(whole), 20).tolist()]:
        path.write_bytes(whole[:end])
        keeper = Keeper(path)
        assert keeper.settings.name == "mine"
        promised = [submap.id for submap, after in zip(FEW, ends, strict=True) if after <= end]
        assert list(keeper.names) == promised
        for submap in FEW:  # and it goes on from there
            assert keeper.keep(submap) == (submap.id not in promised)
            assert_same_submap(keeper.submap(submap.id), submap)
        keeper.close()
        assert path.read_bytes() == whole
    assert [submap.id for submap in read_run(path).submaps] == ["000", "001", "002"]


@pytest.mark.skipif(sys.platform == "win32", reason="files have no limit there")
def test_a_record_that_could_not_be_begun_is_begun_later(tmp_path: Path) -> None:
    import resource  # noqa: PLC0415 - Windows has none

    path, before = tmp_path / "run.gpgrad", resource.getrlimit(resource.RLIMIT_FSIZE)
    settings = RunSettings("x" * 9_000)  # so that the arrays fit where the record does not
    keeper = Keeper(path, lambda _: settings)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5_000, before[1]))
    try:
        assert_refused(lambda: keeper.keep(FEW[0]), "run.gpgrad: cannot be written")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert keeper.settings is None
    for submap in FEW[1:]:
        assert keeper.keep(submap)
    keeper.close()
    assert [submap.id for submap in read_run(path).submaps] == ["001", "002"]
    assert [file.name for file in tmp_path.iterdir()] == ["run.gpgrad"]


def test_a_record_has_one_writer_before_it_is_begun(tmp_path: Path) -> None:
    path = tmp_path / "run.gpgrad"
    with contextlib.closing(Keeper(path)) as keeper:
        for _ in range(2):
            for other in (Keeper, lambda path: replacing(path).__enter__()):
                assert_refused(lambda: other(path), "run.gpgrad", "another process")  # noqa: B023
            keeper.keep(FEW[0])
    with replacing(path) as unfinished:
        unfinished.write_bytes(path.read_bytes())
        assert_refused(lambda: Keeper(path), "run.gpgrad", "another process")
    Keeper(path).close()
    assert [file.name for file in tmp_path.iterdir()] == ["run.gpgrad"]


@pytest.mark.parametrize("again", [Path.unlink, lambda path: path.replace(path.with_name("old"))])
def test_what_lost_its_name_keeps_nothing(tmp_path: Path, again: Callable[[Path], object]) -> None:
    path = tmp_path / "run.gpgrad"
    with contextlib.closing(Keeper(path)) as keeper:
        keeper.keep(FEW[0])
        again(path)
        path.with_name("other").touch()
        assert_refused(lambda: keeper.keep(FEW[1]), "run.gpgrad", "removed or replaced")
        path.with_name("other").replace(path)
        assert_refused(lambda: keeper.keep(FEW[1]), "run.gpgrad", "removed or replaced")
        assert keeper.names == ("000",)


def test_another_file_stays_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    with contextlib.closing(Keeper(path)) as keeper:
        path.write_text("my notes, which nobody wants to lose")
        assert_refused(lambda: keeper.keep(FEW[0]), "notes.txt", "has appeared")
    assert_refused(lambda: Keeper(path), "notes.txt", "no record")
    assert path.read_text().startswith("my notes")
