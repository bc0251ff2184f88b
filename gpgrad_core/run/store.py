"""Results of stages on disk, shared by runs and by processes, and limited to a number of bytes.

They are msgpack with a checksum: reading runs no code, as a pickle would; NPZ takes four times as
long.
"""

import contextlib
import hashlib
import importlib
import os
import shutil
import sqlite3
import stat
import struct
import tempfile
import threading
import weakref
import zlib
from collections.abc import Callable, Generator
from dataclasses import fields, is_dataclass
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import time
from typing import Any, TypeVar, cast

import msgspec
import numpy as np
import platformdirs

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.reading.paths import check_depth

R = TypeVar("R")

MAX_BYTES = 10_000_000_000
"""Bytes that a store keeps unless told otherwise."""
INLINE = 16_384
"""Results of at most this many bytes lie in the index itself; larger ones get a file each."""
INDEX = "index.sqlite"
SLACK = 0.01
"""Share of the limit that a process may add before it counts all entries again."""
FRESH = 600.0
"""A use is written down only so long after the last one [s], so that most reads write nothing."""
ENDING, PART = ".packed", ".part"
LEFT_AFTER = 3600.0
"""Age from which an unfinished file counts as left by a killed process [s]."""
WAIT = 30.0
"""Time that a process waits for another one that writes to the index [s]."""
LIBRARIES = ("numpy", "scipy", "opencv-contrib-python-headless")
"""Libraries whose version may change a result."""
CHECKSUM = struct.Struct("<I")
"""CRC-32 of all that comes after it."""

SCHEMA = """
create table if not exists kept (
    key text primary key, used real not null, bytes integer not null, packed blob
) without rowid;
create table if not exists damaged (key text)
"""
TOTAL = "select total(bytes) from kept"
BEYOND = """
select key from (select key, sum(bytes) over (order by used desc, key) as held from kept)
where held > ?
"""
"""What has no room beside all that was used later."""
STEPS = 100_000
"""Steps of the database's machine between two looks at whether it takes too many."""


def default_folder() -> Path | None:
    """Find the user's cache folder; None without a home, as in some containers."""
    try:
        return platformdirs.user_cache_path("gpgrad", appauthor=False) / "results"
    except RuntimeError:
        return None


class Store:
    """Remembers results on disk by what they were made from, for processes and threads at once.

    An entry belongs to the code and the library versions that made it. A full store drops the
    entries that were not used for the longest time. A damaged entry is made anew and counted. Where
    a store cannot be read or written, results are made as without it. An index is damaged if its
    tables or contents are others than were written, or if a query is endless.

    Libraries that keep results on disk read them back as pickles, which run what a stranger wrote
    into them, and after damage to their index they fail until somebody removes it.
    """

    def __init__(self, folder: Path | None = None, max_bytes: int = MAX_BYTES) -> None:
        """Open a store, by default in the user's cache; it is made at the first result."""
        place = default_folder() if folder is None else folder
        if place is None:
            raise InputError("the user has no home; name a folder for the kept results")
        self.folder = Path(place).absolute()
        check_depth(self.folder)
        self.max_bytes = max_bytes
        self._added: int | None = None  # bytes since there was room for sure
        self._opened: _Opened | None = None
        self._turn = threading.Lock()  # of the threads that use the index
        if os.path.exists(self.folder) and not self.folder.is_dir():  # noqa: PTH110 - never raises
            raise InputError(f"{self.folder}: is a file; name a folder for the kept results")

    def with_room(self, num_bytes: int) -> "Store":
        """This store with a limit of at least so many bytes, if half of the disk has them."""
        try:
            above = next(
                folder for folder in (self.folder, *self.folder.parents) if folder.exists()
            )
            free = shutil.disk_usage(above).free // 2
        except OSError:
            free = 0
        return Store(self.folder, max(self.max_bytes, min(num_bytes, free)))

    def __reduce__(self) -> tuple[Callable[[Path, int], "Store"], tuple[Path, int]]:
        """Become one store in another process, however often it is sent there."""
        return _store_here, (self.folder, self.max_bytes)

    def __call__(self, make: Callable[[], R], *inputs: object) -> R:
        """Return ``make()``, from the disk if it was made before.

        What it is made from are all names, numbers, parameters, tuples of these, and submaps, which
        count by their fingerprints, that determine the result.
        """
        key = key_of(*inputs)
        stored = self.get(key)
        if stored is not None:
            return cast("R", stored)
        result = make()
        self.put(key, result)
        return result

    def get(self, key: str) -> object | None:
        """Return a result; None if it is missing, cannot be read or is damaged."""
        query = "select packed, used, bytes from kept where key = ?"
        with contextlib.suppress(OSError, sqlite3.Error):
            with self._index() as index:
                row = index.execute(query, (key,)).fetchone()
                if row is None:
                    return None
                packed, used, num_bytes = row
                if time() - used > FRESH:
                    with contextlib.suppress(sqlite3.OperationalError):  # another's, for reading
                        index.execute("update kept set used = ? where key = ?", (time(), key))
            try:
                whole = _read_whole(self._file(key), num_bytes) if packed is None else packed
                return unpack(whole)
            except Damaged:
                self._drop(key)
        return None

    def holds(self, key: str) -> bool:
        """Whether the store has a result; it may still turn out to be damaged."""
        query = "select packed is null from kept where key = ?"
        row = self._ask(lambda index: index.execute(query, (key,)).fetchone(), None)
        with contextlib.suppress(OSError):
            return row is not None and (not row[0] or self._file(key).exists())
        return False

    def put(self, key: str, result: object) -> bool:
        """Store a result; False if the disk is full or the folder cannot be written."""
        packed = pack(result)
        inline = len(packed) <= INLINE
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with self._index() as index:
                index.execute(
                    "insert or replace into kept values (?, ?, ?, ?)",
                    (key, time(), len(packed), packed if inline else None),
                )
                self._added = None if self._added is None else self._added + len(packed)
                if self._added is None or self._added > self.max_bytes * SLACK:
                    self._make_room(index)
                    self._added = 0
            # The file comes last: an entry without its file is made anew, and a file without its
            # entry would never be dropped.
            if not inline:
                self._write(self._file(key), packed)
        except (OSError, sqlite3.Error):
            return False
        return True

    def take_damaged(self) -> int:
        """Count the entries that any process has found damaged, and forget that number."""
        return self._ask(lambda index: index.execute("delete from damaged").rowcount, 0)

    def _write(self, file: Path, packed: bytes) -> None:
        """Write a file under another name first, so that others never read half of it."""
        file.parent.mkdir(exist_ok=True)
        descriptor, unfinished = tempfile.mkstemp(PART, dir=file.parent)
        try:
            with os.fdopen(descriptor, "wb") as out:
                out.write(packed)
            Path(unfinished).replace(file)
        except BaseException:
            Path(unfinished).unlink(missing_ok=True)
            raise
        for left in file.parent.glob(f"*{PART}"):  # by a process that was killed
            if time() - left.stat().st_mtime > LEFT_AFTER:
                left.unlink(missing_ok=True)

    @property
    def num_bytes(self) -> int:
        return self._ask(lambda index: int(index.execute(TOTAL).fetchone()[0]), 0)

    def _ask(self, ask: Callable[[sqlite3.Connection], R], otherwise: R) -> R:
        """Use the index; where it cannot be read or written, the answer is another."""
        try:
            with self._index() as index:
                return ask(index)
        except (OSError, sqlite3.Error):
            return otherwise

    def _make_room(self, index: sqlite3.Connection) -> None:
        """Drop the entries that were not used for the longest time, while there are too many."""
        if index.execute(TOTAL).fetchone()[0] > self.max_bytes:
            for (key,) in index.execute(BEYOND, (self.max_bytes,)).fetchall():
                index.execute("delete from kept where key = ?", (key,))
                self._unlink(key)

    def _drop(self, key: str) -> None:
        with contextlib.suppress(OSError, sqlite3.Error):
            with self._index() as index:
                index.execute("delete from kept where key = ?", (key,))
                index.execute("insert into damaged values (?)", (key,))
            self._unlink(key)

    def _file(self, key: str) -> Path:
        return self.folder / key[:2] / f"{key}{ENDING}"

    def _unlink(self, key: str, folder: str = "") -> None:
        """Remove the files of the entries of a pattern; older versions had another ending."""
        for file in self.folder.glob(f"{folder or key[:2]}/{key}.*"):
            if file.is_dir():
                file.rmdir()
            else:
                file.unlink(missing_ok=True)

    @contextlib.contextmanager
    def _index(self) -> Generator[sqlite3.Connection]:
        """Use the index for one transaction. A damaged one is made anew for the next."""
        file = self.folder / INDEX
        if not self.folder.is_dir():
            raise FileNotFoundError(self.folder)
        with self._turn:
            try:
                with self._transaction(file) as index:
                    yield index
            except (sqlite3.OperationalError, sqlite3.IntegrityError) as error:
                self._close()
                if str(error) != "interrupted":
                    raise  # locked, read-only or full: not damaged
                self._make_index(file)
                raise
            except (sqlite3.DatabaseError, ArithmeticError, TypeError, ValueError) as error:
                self._close()
                self._make_index(file)
                raise sqlite3.DatabaseError(str(error)) from error

    @contextlib.contextmanager
    def _transaction(self, file: Path) -> Generator[sqlite3.Connection]:
        """Open the index unless it is open, and check its tables."""
        if self._opened is not None and not self._opened.is_of(file):
            self._close()
        if self._opened is None:
            if file.exists() and not file.is_file():
                raise sqlite3.DatabaseError("it is no file")
            self._opened = _Opened(file)
        with self._opened.connection as index:
            left = 10 * STEPS + file.stat().st_size

            def is_endless() -> bool:
                nonlocal left
                left -= STEPS
                return left < 0

            index.set_progress_handler(is_endless, STEPS)
            if _tables(index) != _right_tables():
                index.executescript(SCHEMA)
                if _tables(index) != _right_tables():
                    raise sqlite3.DatabaseError("its tables are others")
            yield index

    def _close(self) -> None:
        if self._opened is not None:
            self._opened.close()
            self._opened = None

    def _make_index(self, file: Path) -> None:
        """Make the index anew, and remove the entries' files, which it would not know."""
        if file.is_dir():
            file.rmdir()
        for ending in ("", "-journal", "-wal", "-shm"):
            file.with_name(file.name + ending).unlink(missing_ok=True)
        self._unlink("[0-9a-f]" * 64, "??")
        with self._transaction(file) as index:
            index.execute("insert into damaged values (?)", (INDEX,))


@lru_cache(maxsize=4)
def _store_here(folder: Path, max_bytes: int) -> Store:
    """The store that was sent to this process, cached, so that it seldom counts the entries."""
    return Store(folder, max_bytes)


class _Opened:
    """An index that is open, and which file it is. It is closed at the latest with its owner."""

    def __init__(self, file: Path) -> None:
        self.connection = sqlite3.connect(file, timeout=WAIT, check_same_thread=False)
        self.close = weakref.finalize(self, self.connection.close)
        self.connection.execute("pragma synchronous = off")  # a power cut may damage it: `_index`
        about = file.stat()
        self._number = about.st_dev, about.st_ino

    def is_of(self, file: Path) -> bool:
        try:
            about = file.stat()
        except OSError:
            return False
        return self._number == (about.st_dev, about.st_ino)


def _tables(index: sqlite3.Connection) -> list[tuple[object, ...]]:
    return index.execute("select type, name, sql from sqlite_master order by name").fetchall()


@cache
def _right_tables() -> list[tuple[object, ...]]:
    with contextlib.closing(sqlite3.connect(":memory:")) as index:
        index.executescript(SCHEMA)
        return _tables(index)


def _read_whole(file: Path, num_bytes: object) -> bytes:
    about = file.stat()
    if not stat.S_ISREG(about.st_mode) or about.st_size != num_bytes:
        raise Damaged(f"{file} has not the {num_bytes} bytes of the index")
    return file.read_bytes()


def key_of(*inputs: object) -> str:
    """Hash what a result is made from, and the code that makes it; TypeError if it has no text."""
    text = "\n".join((code_version(), *(_text(part) for part in inputs)))
    return hashlib.sha256(text.encode()).hexdigest()


def _text(part: object) -> str:
    """Write what a result is made from as a text that is the same in every process."""
    fingerprint = getattr(part, "fingerprint", None)
    if isinstance(fingerprint, str):
        return f"submap {fingerprint}"
    if part is None or isinstance(part, bool | int | float | str):
        return repr(part)
    if isinstance(part, tuple):
        return f"({', '.join(_text(item) for item in cast('tuple[object, ...]', part))})"
    if is_dataclass(part):
        inside = (f"{f.name}={_text(getattr(part, f.name))}" for f in fields(part))
        return f"{type(part).__qualname__}({', '.join(inside)})"
    raise TypeError(f"a {type(part).__qualname__} has no stable text")


@cache
def code_version() -> str:
    """Hash this package's code and the versions of libraries: what gives the same results."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[1]
    for file in sorted(root.rglob("*.py")):
        digest.update(str(file.relative_to(root)).encode())
        digest.update(file.read_bytes())
    return " ".join(
        (digest.hexdigest(), *(f"{name} {library_version(name)}" for name in LIBRARIES))
    )


def library_version(name: str) -> str:
    """Find a library's version; another build of it may be installed under another name."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"


class Damaged(Exception):
    """The bytes are not what was packed."""


def pack(value: object) -> bytes:
    """Pack arrays, numbers, texts, None, tuples, dicts by text and dataclasses of this package."""
    content = msgspec.msgpack.encode(_tree(value))
    return CHECKSUM.pack(zlib.crc32(content)) + content


def unpack(data: bytes) -> object:
    """Unpack a value with read-only arrays; Damaged if bytes or its class have changed."""
    try:
        (checksum,) = CHECKSUM.unpack_from(data)
        content = memoryview(data)[CHECKSUM.size :]
        if zlib.crc32(content) != checksum:
            raise ValueError("the checksum is another")
        return _value(msgspec.msgpack.decode(content))
    except Exception as error:  # whatever msgspec, NumPy or a class makes of damaged bytes
        raise Damaged(str(error)) from error


def _tree(value: object) -> object:
    """Describe a value for msgpack: what is no plain one is a table with its kind as the key."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        return {"int": str(value)}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray):
        array = cast("NDArray[np.generic]", value)
        if array.dtype.hasobject:
            raise TypeError("an array of objects cannot be packed")
        return {"array": (array.tobytes(), array.dtype.str, array.shape)}
    if isinstance(value, tuple | list):
        items = cast("tuple[object, ...]", value)
        return {"list" if isinstance(value, list) else "tuple": [_tree(item) for item in items]}
    if isinstance(value, dict):
        entries = cast("dict[str, object]", value)
        return {"dict": {key: _tree(entry) for key, entry in entries.items()}}
    kind = type(value)
    if is_dataclass(value) and kind.__module__.startswith("gpgrad_core."):
        attributes = {f.name: _tree(getattr(value, f.name)) for f in fields(value) if f.init}
        return {"class": (f"{kind.__module__}:{kind.__qualname__}", attributes)}
    raise TypeError(f"a {kind.__qualname__} cannot be packed")


def _value(tree: object) -> object:
    if not isinstance(tree, dict):
        return tree
    ((kind, content),) = cast("dict[str, Any]", tree).items()
    match kind:
        case "int":
            return int(content)
        case "array":
            packed, dtype, shape = content
            return np.frombuffer(packed, dtype).reshape(shape)
        case "list" | "tuple":
            items = [_value(item) for item in content]
            return items if kind == "list" else tuple(items)
        case "dict":
            return {key: _value(entry) for key, entry in content.items()}
        case _:
            name, attributes = content
            return _class(name)(**{field: _value(entry) for field, entry in attributes.items()})


def _class(name: str) -> type:
    module, _, qualified = name.partition(":")
    if not module.startswith("gpgrad_core."):
        raise ValueError(f"{module} is not of this package")
    kind = getattr(importlib.import_module(module), qualified)
    if not is_dataclass(kind):
        raise ValueError(f"{name} is no dataclass")
    return cast("type", kind)
