"""Results on disk: found again, bounded, shared, never in the way; and how they are packed."""

import contextlib
import os
import shutil
import sqlite3
import subprocess
import sys
import zlib
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from gpgrad_core.detection import PipelineParams
from gpgrad_core.mapping.gradient_map import TerrainParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import (
    CHECKSUM,
    ENDING,
    INDEX,
    Damaged,
    Store,
    key_of,
    library_version,
    pack,
    unpack,
)
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Features, Registration, Submap
from tests.support.laws import examples
from tests.support.refusal import assert_refused

LARGE = 10_000
"""Numbers of an array that gets a file of its own."""


class Counted:
    def __init__(self, size: int = 10) -> None:
        self.size, self.count = size, 0

    def __call__(self) -> np.ndarray:
        self.count += 1
        return np.full(self.size, float(self.count))


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "kept")


@pytest.mark.parametrize("size", [10, LARGE])
def test_a_result_is_made_once_and_found_by_a_later_run(store: Store, size: int) -> None:
    make = Counted(size)
    first = store(make, "stage", 1, 0.5)
    again = Store(store.folder)(make, "stage", 1, 0.5)
    np.testing.assert_array_equal(first, again)
    assert make.count == 1
    store(make, "stage", 1, 0.25)
    assert make.count == 2


def test_keys_tell_apart_whatever_determines_a_result() -> None:
    cloud = np.random.default_rng(0).normal(size=(30, 3))
    submap, moved = Submap.from_points(cloud, "a"), Submap.from_points(cloud + 1e-9, "a")
    params, other = TerrainParams(), TerrainParams(length_scale=0.31)
    parts = [
        *(("fit", submap, params), ("fit", moved, params), ("map", submap, params)),
        *(("fit", submap, other), ("fit", (submap,), params), ("fit", (submap, moved), params)),
        *(("fit", "1"), ("fit", 1), ("fit", 1.0), ("fit", None), ("fit",)),
    ]
    assert len({key_of(*made_from) for made_from in parts}) == len(parts)
    assert key_of("fit", Submap.from_points(cloud, "b"), params) == key_of("fit", submap, params)
    with pytest.raises(TypeError, match="no stable text"):
        key_of(cloud)
    assert library_version("a-library-that-nobody-has") == "unknown"


def test_keys_are_the_same_in_another_process() -> None:
    parts = ("fit", ("length_scale",), 0.1, None)
    code = f"from gpgrad_core.run.store import key_of\nprint(key_of(*{parts!r}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == key_of(*parts)


def test_the_longest_unused_is_dropped_first(tmp_path: Path) -> None:
    store = Store(tmp_path, max_bytes=5 * 8 * LARGE)
    for k in range(8):
        store(Counted(LARGE), k)
    files = sum(file.stat().st_size for file in tmp_path.rglob(f"*{ENDING}"))
    assert files == store.num_bytes <= store.max_bytes
    kept = [store.holds(key_of(k)) for k in range(8)]
    assert kept == sorted(kept)
    assert (kept[0], kept[-1]) == (False, True)


@pytest.mark.parametrize("damage", ["in the index", "cut", "lost", "pipe", "folder"])
def test_a_damaged_entry_is_made_anew_and_counted(store: Store, damage: str) -> None:
    make = Counted(10 if damage == "in the index" else LARGE)
    store(make, "a")
    if damage == "in the index":
        with contextlib.closing(sqlite3.connect(store.folder / INDEX)) as index, index:
            index.execute("update kept set packed = ?", (b"not an archive",))
    else:
        (file,) = store.folder.rglob(f"*{ENDING}")
        break_file(file, damage)
    assert store(make, "a")[0] == store(make, "a")[0] == 2
    assert make.count == 2
    assert Store(store.folder).take_damaged() == (damage != "lost")
    assert store.take_damaged() == 0


def break_file(file: Path, damage: str) -> None:
    content = file.read_bytes()
    file.unlink()
    if damage == "pipe":
        if not hasattr(os, "mkfifo"):
            pytest.skip("this system has no named pipes")
        os.mkfifo(file)
    elif damage == "folder":
        file.mkdir()
    elif damage == "words":
        file.write_bytes(b"words, and no database" * 100)
    elif damage == "cut":
        file.write_bytes(content[:-100])


@pytest.mark.parametrize("damage", ["words", "pipe", "folder"])
def test_an_index_that_is_no_database_is_made_anew(store: Store, damage: str) -> None:
    make = Counted(LARGE)
    store(make, "a")
    break_file(store.folder / INDEX, damage)
    assert store.num_bytes == 0
    assert not list(store.folder.rglob(f"*{ENDING}"))
    assert store(make, "a")[0] == store(make, "a")[0] == make.count == 2
    assert store.take_damaged() == 1


ENDLESS = "with recursive n(x) as (select 1 union all select x + 1 from n) select 'a' as key"
KEPT = "key text, used real, bytes integer, packed blob"


@pytest.mark.parametrize(
    "statements",
    [
        "update kept set used = 'words'",
        "update kept set used = x'00ff'",
        "update kept set bytes = 9e999",
        "drop table kept; create table kept (a, b)",
        f"drop table kept; create table kept ({KEPT}, check (bytes < 0))",
        "alter table kept add column more",
        f"drop table kept; create view kept as {ENDLESS}, 0.0 as used, x as bytes, null as packed"
        " from n",
        f"drop table damaged; create view damaged as {ENDLESS} from n",
        f"create trigger t before insert on kept begin insert into damaged {ENDLESS} from n; end",
    ],
)
def test_an_index_that_holds_something_else_is_made_anew(store: Store, statements: str) -> None:
    make = Counted()
    store(make, "a")
    with contextlib.closing(sqlite3.connect(store.folder / INDEX)) as index, index:
        index.executescript(statements)
    store(make, "a")
    assert store.num_bytes < 10_000
    store(make, "a")
    assert make.count <= 2
    assert store.take_damaged() == 1


def test_a_query_without_an_end_is_given_up(tmp_path: Path) -> None:
    """Where the tables themselves seem right, steps are counted."""
    schema = (
        "create table if not exists damaged (key text);"
        f"create view if not exists kept as {ENDLESS}, x as bytes from n"
    )
    program = (
        "import pathlib, gpgrad_core.run.store as store\n"
        f"store.SCHEMA = {schema!r}\n"
        f"kept = store.Store(pathlib.Path({str(tmp_path)!r}))\n"
        "print(kept.num_bytes, kept.take_damaged())"
    )
    command = [sys.executable, "-c", program]
    said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert said.stdout == "0 1\n"


def test_an_index_with_a_broken_page_is_made_anew(store: Store) -> None:
    for k in range(60):
        store(Counted(500), k)
    index = store.folder / INDEX
    content = bytearray(index.read_bytes())
    content[4096:] = b"\xff" * (len(content) - 4096)
    index.write_bytes(content)
    make = Counted()
    later = Store(store.folder)  # the one that is open has the page in memory
    for _ in range(3):
        later(make, "a")
    assert make.count <= 2
    assert later.take_damaged() >= 1


def test_a_folder_that_was_removed_meanwhile_is_made_anew(store: Store) -> None:
    make = Counted(LARGE)
    store(make, "a")
    shutil.rmtree(store.folder)
    store(make, "a")
    Store(store.folder)(make, "a")
    assert make.count == 2
    assert store.take_damaged() == 0


def test_what_a_killed_process_left_is_removed(store: Store) -> None:
    store(Counted(LARGE), "a")
    (file,) = store.folder.rglob(f"*{ENDING}")
    left, fresh = file.with_name("old.part"), file.with_name("new.part")
    for unfinished in (left, fresh):
        unfinished.write_bytes(b"half")
    os.utime(left, (0, 0))
    store.put(file.stem, np.zeros(LARGE))
    assert not left.exists()
    assert fresh.exists()


def test_what_cannot_be_written_is_no_hindrance(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("x")
    nowhere, make = Store(tmp_path / "file" / "kept"), Counted()
    assert [nowhere(make, "a")[0] for _ in range(2)] == [1, 2]
    assert nowhere.num_bytes == 0
    assert_refused(lambda: Store(tmp_path / "file"), "file: is a file; name a folder")
    full = OSError(28, "No space left on device")
    monkeypatch.setattr("gpgrad_core.run.store.tempfile.mkstemp", Mock(side_effect=full))
    make = Counted(LARGE)
    assert [store(make, "a")[0] for _ in range(2)] == [1, 2]


def _put_many(folder: Path, start: int) -> int:
    store = Store(folder)
    for k in range(40):
        store(Counted(LARGE if k % 5 == 0 else 10), start + k)
    return store.take_damaged()


@pytest.mark.slow
def test_processes_share_a_folder(tmp_path: Path) -> None:
    with ProcessPoolExecutor(2, get_context("spawn")) as executor:
        damaged = list(executor.map(_put_many, [tmp_path] * 4, [0, 20, 0, 30]))
    assert damaged == [0] * 4
    store = Store(tmp_path)
    assert all(store.get(key_of(k)) is not None for k in range(70))


CALLS: list[int] = []


def size_of(submap: Submap, factor: int) -> float:
    CALLS.append(factor)
    return float(factor * len(submap.points))


def test_a_memo_asks_its_store_and_another_process_gets_the_same_one(store: Store) -> None:
    submap = Submap.from_points(np.random.default_rng(0).normal(size=(7, 3)))
    memo = Memo(store=store)
    assert memo.lasting(size_of, submap, 2) == 14.0
    assert memo.lasting(size_of, submap, 2) == 14.0
    later = Memo(store=Store(store.folder))
    assert later.lasting(size_of, submap, 2) == 14.0
    assert CALLS == [2]
    assert memo(size_of, submap, 2) == 14.0
    assert CALLS == [2]
    remade, arguments = memo.__reduce__()
    assert remade(*arguments).store is store


NUMBERS = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(allow_nan=False), st.text()
)
VALUES = st.recursive(
    NUMBERS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.lists(inner, max_size=3).map(tuple),
        st.dictionaries(st.text(max_size=5), inner, max_size=3),
    ),
    max_leaves=8,
)


@examples(40)
@given(VALUES)
@example([2**63, -(2**63) - 1, 2**63 - 1, -(2**63)])  # numbers that msgpack has, and has not
def test_plain_values_come_back(value: object) -> None:
    assert unpack(pack(value)) == value


@examples(40)
@given(arrays(st.sampled_from(["f4", "f8", "u1", "i8", "?", "c8"]), array_shapes(min_side=0)))
def test_arrays_come_back_with_their_type_and_cannot_be_written(array: np.ndarray) -> None:
    made = unpack(pack((1, array)))
    assert isinstance(made, tuple)
    np.testing.assert_array_equal(made[1], array)
    assert made[1].dtype == array.dtype
    assert not made[1].flags.writeable


def test_dataclasses_come_back_with_all_that_is_in_them() -> None:
    params = PipelineParams()
    assert unpack(pack(params)) == params
    registration = Registration(
        SE2(1.0, -2.0, 0.5), np.array([True, False]), np.inf, 3.0, 0.5, 2.5, covariance=np.eye(3)
    )
    made = unpack(pack(registration))
    assert isinstance(made, Registration)
    assert made.T_database_query == registration.T_database_query
    assert made.dissimilarity == np.inf
    assert made.agreement is None
    np.testing.assert_array_equal(made.inliers, [True, False])
    np.testing.assert_array_equal(made.covariance, np.eye(3))


def test_other_classes_are_neither_packed_nor_unpacked() -> None:
    with pytest.raises(TypeError, match="Generator cannot be packed"):
        pack((1, np.random.default_rng(0)))
    some = Features(*(np.zeros(shape) for shape in ((0, 2), 0, 0, 0)), np.zeros((0, 4), np.uint8))
    content = pack(some)[CHECKSUM.size :]
    for other in (b"subprocess:Popen....", b"gpgrad_core.se2:abcde", b"gpgrad_core.types:cast"):
        changed = content.replace(b"gpgrad_core.types:Features"[: len(other)], other)
        assert changed != content
        with pytest.raises(Damaged):
            unpack(CHECKSUM.pack(zlib.crc32(changed)) + changed)


@given(st.data())
def test_a_changed_or_cut_byte_is_noticed_or_changes_nothing(data: st.DataObject) -> None:
    value = (1.5, "text", np.arange(40.0))
    packed = bytearray(pack(value))
    place = data.draw(st.integers(0, len(packed) - 1))
    if data.draw(st.booleans()):
        packed = packed[:place]
    else:
        packed[place] ^= data.draw(st.integers(1, 255))
    try:
        made = unpack(bytes(packed))
    except Damaged:
        return
    assert isinstance(made, tuple)
    assert made[:2] == value[:2]
    np.testing.assert_array_equal(made[2], value[2])
