"""A drive ends where the whole dataset at once ends, and its record gives it back."""

import os
import sys
import zlib
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gpgrad_core import demo_path, detect_loop_closures, load_dataset
from gpgrad_core.detection import MapDetector
from gpgrad_core.errors import InputError
from gpgrad_core.run import Cancelled
from gpgrad_core.run.memo import Memo
from gpgrad_core.slam import (
    Drive,
    Moment,
    Run,
    RunWriter,
    build_pose_graph,
    optimise_pose_graph,
    read_run,
    write_run,
)
from gpgrad_core.slam.run_file import HEAD, MAGIC
from gpgrad_core.types import LoopClosure, Registration
from tests.core.slam.simulated import Oracle, Traverse, simulate
from tests.support.cancelling import cancelling


def driven(
    traverse: Traverse, record: RunWriter | None = None, *, incremental: bool = False
) -> Drive:
    drive = Drive(detector=Oracle.of(traverse), record=record, name="rows", incremental=incremental)
    for submap in traverse.dataset.submaps:
        drive.add(submap)
    return drive


def test_a_closure_moves_the_map_and_makes_it_more_certain() -> None:
    moments = driven(simulate(12, row=6)).moments
    sizes = [np.linalg.det(moment.covariances[-1]) for moment in moments]
    closing = next(k for k, moment in enumerate(moments) if moment.accepted)
    assert all(a < b for a, b in pairwise(sizes[:closing]))
    assert sizes[closing] < sizes[closing - 1]
    assert moments[closing].moved > 0
    assert all(moment.moved == 0 for moment in moments[:closing])


def test_listeners_hear_of_each_moment_after_it_is_kept(tmp_path: Path) -> None:
    traverse = simulate(4, row=2)
    heard: list[tuple[Moment, int]] = []
    path = tmp_path / "run.gpgrad"
    with RunWriter(path) as record:
        drive = Drive(detector=Oracle.of(traverse), record=record)
        stop = drive.listen(lambda moment: heard.append((moment, len(read_run(path).moments))))
        first, second, third, _ = traverse.dataset.submaps
        drive.add(first)
        drive.add(second)
        stop()
        drive.add(third)
    assert [moment for moment, _ in heard] == list(drive.moments[:2])
    assert [count for _, count in heard] == [1, 2]


def test_a_record_has_one_writer(tmp_path: Path) -> None:
    path = tmp_path / "run.gpgrad"
    (first,) = simulate(1).dataset.submaps
    with RunWriter(path) as record:
        record.keep(first)
        for begin in (RunWriter, RunWriter.resume):
            with pytest.raises(InputError, match="another process writes this file"):
                begin(path)
    assert [submap.id for submap in read_run(path).submaps] == [first.id]
    with RunWriter.resume(path)[0], pytest.raises(InputError, match="another process"):
        RunWriter(path)
    assert [submap.id for submap in read_run(path).submaps] == [first.id]
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        with pytest.raises(InputError, match="is no regular file"):
            RunWriter(tmp_path / "pipe")


def test_what_is_cancelled_stays_in_the_record_and_can_be_added_again(tmp_path: Path) -> None:
    traverse = simulate(3, row=3)
    path = tmp_path / "run.gpgrad"

    with RunWriter(path) as record:
        drive = Drive(detector=Oracle.of(traverse), record=record)
        first, second, _ = traverse.dataset.submaps
        drive.add(first)
        with pytest.raises(Cancelled):
            drive.add(second, cancelling())
        run = read_run(path)
        assert [submap.id for submap in run.submaps] == ["0000", "0001"]
        assert len(run.moments) == len(drive.moments) == 1
        drive.add(second)
    assert [moment.submap_id for moment in read_run(path).moments] == ["0000", "0001"]


def test_an_incremental_drive_is_nearly_the_whole_and_ends_as_the_whole(tmp_path: Path) -> None:
    traverse = simulate(20, row=5)
    path = tmp_path / "run.gpgrad"
    whole = driven(traverse)
    with RunWriter(path, replace(whole.settings, incremental=True)) as record:
        drive = driven(traverse, record, incremental=True)
        onward, differ = drive.moments, 0
        for one, other in zip(onward, whole.moments, strict=True):
            np.testing.assert_allclose(one.places, other.places, atol=1e-3)
            np.testing.assert_allclose(one.covariances[-1], other.covariances[-1], rtol=1e-2)
            differ += not np.array_equal(one.places, other.places)
        assert differ > 5  # it has gone on from the last solution
        heard: list[Moment] = []
        drive.listen(heard.append)
        assert not drive.is_settled
        drive.finish()
    assert drive.is_settled
    assert heard == [drive.moments[-1]]
    assert drive.settle() is None
    np.testing.assert_array_equal(
        drive.result.poses["0019"].translation, whole.moments[-1].places[-1, :3]
    )
    end = replace(whole.moments[-1], moved=drive.moments[-1].moved)
    assert_same_moments(drive.moments, (*onward[:-1], end))
    run = read_run(path)
    assert run.settled
    assert run.settings.incremental
    assert_same_moments(run.moments, drive.moments)
    copy = tmp_path / "copy.gpgrad"
    write_run(copy, drive)
    assert_same_moments(read_run(copy).moments, drive.moments)


def test_a_moment_that_was_settled_changes_none_that_come_later(tmp_path: Path) -> None:
    traverse = simulate(20, row=5)
    once = driven(traverse, incremental=True)
    path = tmp_path / "run.gpgrad"
    with RunWriter(path) as record:
        drive = Drive(detector=Oracle.of(traverse), record=record, incremental=True)
        for k, submap in enumerate(traverse.dataset.submaps):
            if k == 19:
                assert drive.settle() is not None
                assert read_run(path).settled
            drive.add(submap)
    assert_same_moments(drive.moments, once.moments)
    run = read_run(path)
    assert not run.settled
    assert_same_moments(run.moments, once.moments)
    writer, before = RunWriter.resume(path)
    with writer:
        writer.settle(before.moments[-1])
        writer.settle(before.moments[-1])
    again = read_run(path)
    assert again.settled
    assert_same_moments(again.moments, once.moments)
    settled = once.settle()  # a drive without a record
    assert settled is not None
    np.testing.assert_array_equal(settled.places, driven(traverse).moments[-1].places)


def test_a_closure_that_contradicts_the_last_solution_has_all_weighed_anew() -> None:
    traverse = simulate(20, row=5, wrong=0.2)
    with driven(traverse, incremental=True) as drive:
        drive.settle()
        assert set(drive.moments[-1].left_out) == traverse.wrong
        refusing = [k for k, moment in enumerate(drive.moments) if moment.left_out]
        assert refusing
        assert refusing[0] < 19


def assert_same_moments(moments: tuple[Moment, ...], others: tuple[Moment, ...]) -> None:
    assert len(moments) == len(others)
    for one, other in zip(moments, others, strict=True):
        for name in ("ids", "starts_traverse", "shortlist", "left_out", "moved"):
            assert getattr(one, name) == getattr(other, name), name
        for name in ("places", "covariances"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        for name in ("translation", "quaternion"):
            ours, theirs = (getattr(moment.odometry, name) for moment in (one, other))
            np.testing.assert_array_equal(ours, theirs)
        for name in ("closures", "turned"):
            ours, theirs = (map(fields, getattr(moment, name)) for moment in (one, other))
            assert list(ours) == list(theirs)


def fields(closure: LoopClosure) -> list[object]:
    """Everything that a verdict says, so that two of them can be compared."""
    found = closure.registration
    return [
        {**vars(closure), "registration": None, "refusal": None},  # of it, a record has the words
        {**vars(found), "covariance": None, "inliers": found.inliers.tolist()},
        None if found.covariance is None else found.covariance.tolist(),
    ]


@pytest.fixture
def recorded(tmp_path: Path) -> tuple[Path, Drive]:
    path = tmp_path / "run.gpgrad"
    with RunWriter(path) as record, driven(simulate(8, row=4, wrong=0.1), record) as drive:
        return path, drive


def test_a_record_gives_all_of_it_back(recorded: tuple[Path, Drive], tmp_path: Path) -> None:
    path, drive = recorded
    whole = tmp_path / "whole.gpgrad"
    write_run(whole, drive)
    for run in (read_run(path), read_run(whole)):
        assert_same_moments(run.moments, drive.moments)
        assert not run.notes
        for submap, given in zip(run.submaps, drive.submaps, strict=True):
            np.testing.assert_array_equal(submap.points, given.points)
            assert submap.fingerprint == given.fingerprint
    assert read_run(whole).settings == drive.settings


def with_a_changed_byte(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize(
    ("damage", "says", "least"),
    [
        *((lambda content, lost=lost: content[:-lost], "is not whole", 6) for lost in (1, 2000)),
        (with_a_changed_byte, "damaged", 1),
    ],
    ids=["its last byte lost", "its last entries lost", "a byte changed"],
)
def test_of_a_damaged_record_the_rest_is_used_and_a_writer_goes_on_behind_it(
    recorded: tuple[Path, Drive], damage: Callable[[bytes], bytes], says: str, least: int
) -> None:
    path, drive = recorded
    path.write_bytes(damage(path.read_bytes()))
    run = read_run(path)
    (note,) = run.notes
    assert says in note
    assert "\n" not in note
    assert_same_moments(run.moments, drive.moments[: len(run.moments)])
    assert len(run.moments) >= least
    writer, before = RunWriter.resume(path)
    with writer:
        assert len(before.moments) == len(run.moments)
        for submap, moment in zip(drive.submaps, drive.moments, strict=True):
            writer.keep(submap)
            writer.add(moment)
    again = read_run(path)
    assert not again.notes
    assert_same_moments(again.moments, drive.moments)


@pytest.mark.skipif(sys.platform == "win32", reason="files have no limit there")
def test_what_a_full_disk_refuses_is_not_half_there_and_can_come_again(
    recorded: tuple[Path, Drive], tmp_path: Path
) -> None:
    import resource  # noqa: PLC0415 - Windows has none

    _, drive = recorded
    path = tmp_path / "full.gpgrad"
    first, second = drive.submaps[:2]
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with RunWriter(path) as writer:
        writer.keep(first)
        resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 100, before[1]))
        try:
            with pytest.raises(OSError, match="File too large") as raised:
                writer.keep(second)
            assert raised.value.filename == str(path)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert not read_run(path).notes
        writer.keep(second)
    run = read_run(path)
    assert not run.notes
    assert [submap.id for submap in run.submaps] == [first.id, second.id]


def entry(content: bytes) -> bytes:
    return HEAD.pack(len(content), zlib.crc32(content)) + content


def settings_with(group: bytes) -> bytes:
    """Pack settings whose table of the map is something else."""
    entry = {"type": "settings", "gpgrad": "1", "name": "", "graph": {}, "solver": {}}
    entry |= {"candidates": "all", "search_radius": None, "params": {"map": 0}}
    return msgspec.msgpack.encode(entry)[:-1] + group


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is not a record"),
        (b"gpgrad run 9\n", "is not a record"),
        (MAGIC, "ends before its settings"),
        (MAGIC + HEAD.pack(2**32 - 1, 0), "ends before its settings"),
        (MAGIC + entry(b"\x91" * 100_000 + b"\xc0"), "entry 1: "),
        (MAGIC + entry(settings_with(b"\x91" * 100_000 + b"\xc0")), "entry 1: "),
        (MAGIC + entry(settings_with(b"\x81\xc0\xc0")), "map must be a table"),
        (MAGIC + entry(settings_with(b"\x81\x91\x01\xc0")), "map must be a table"),
        (MAGIC + entry(b"\xc0"), "entry 1"),
        (MAGIC + entry(b"\x81\xa4type\xa6moment"), "entry 1"),
        (MAGIC + entry(b"\xdd\xff\xff\xff\xff"), "entry 1"),
    ],
)
def test_what_is_no_record_is_refused_in_one_line(
    tmp_path: Path, content: bytes, says: str
) -> None:
    path = tmp_path / "run.gpgrad"
    path.write_bytes(content)
    with pytest.raises(InputError, match=says) as error:
        read_run(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_an_entry_cannot_come_twice(recorded: tuple[Path, Drive]) -> None:
    path, _ = recorded
    content = path.read_bytes()
    size, _ = HEAD.unpack_from(content, len(MAGIC))
    first = content[len(MAGIC) : len(MAGIC) + HEAD.size + size]
    path.write_bytes(content + first)
    with pytest.raises(InputError, match="settings a second time"):
        read_run(path)
    path.write_bytes(content + content[len(MAGIC) + len(first) :])
    with pytest.raises(InputError, match="'0000' a second time"):
        read_run(path)


@pytest.mark.slow
def test_the_demo_ends_as_gpgrad_slam_does(tmp_path: Path) -> None:
    demo = load_dataset(demo_path())
    some = (demo.submap(name) for name in ("001", "002", "007", "008"))
    dataset = replace(demo, submaps=tuple(some))
    together = detect_loop_closures(dataset)
    assert any(closure.accepted for closure in together.closures)
    batch = optimise_pose_graph(build_pose_graph(dataset, together.closures))
    registered: dict[tuple[str, str], Registration] = {}
    ends: list[Run] = []
    for k in range(2):  # the second drive finds all pairs registered
        detector, path = MapDetector(together.params, Memo()), tmp_path / f"{k}.gpgrad"
        with (
            RunWriter(path) as record,
            Drive(
                together.params, detector=detector, registered=registered, record=record
            ) as drive,
        ):
            for submap in dataset.submaps:
                drive.add(submap)
        np.testing.assert_array_equal(drive.result.history, batch.history)
        assert list(map(fields, drive.closures)) == list(map(fields, together.closures))
        ends.append(read_run(path))
        assert_same_moments(ends[k].moments, drive.moments)
    assert_same_moments(ends[0].moments, ends[1].moments)
