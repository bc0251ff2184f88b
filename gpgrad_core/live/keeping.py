"""Submaps on disk, each of them whole before its sender is told so.

The file grows only at its end. A record is a head in MessagePack, with the hash of what follows it,
and the arrays of the submap. A record that a killed process has not finished was never promised to
anybody, and is cut off. Arrays are read from the file when they are looked at: memory stays flat.
"""

import hashlib
import os
import struct
import tempfile
import threading
from pathlib import Path
from typing import Annotated, BinaryIO, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta, Struct

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError, readable
from gpgrad_core.live.frames import Seven, pose_of, seven
from gpgrad_core.run.folders import ProcessLock, naming
from gpgrad_core.run.memory import ALIGNED, map_file
from gpgrad_core.types import Submap

MAGIC = b"gpgrad submaps 1\n".ljust(ALIGNED, b"\0")
LARGEST_HEAD = 10_000
"""Bytes; it takes three hundred."""
ARRAYS = ("points", "noise_std", "ranges", "colors", "left_out")
"""What a submap has of each of its points, and those that were left out."""
HEAD = struct.Struct(">II")
"""Bytes of the head, and its hash's first four."""
Count: TypeAlias = Annotated[int, Meta(ge=0, le=100_000_000)]


class _Head(Struct, forbid_unknown_fields=True):
    """All of a submap but its arrays."""

    id: str
    fingerprint: str
    pose: Seven
    stamp: float | None
    counts: tuple[Count, Count, Count]  # dropped, wild and standing points
    shapes: dict[str, tuple[Count, ...]]
    hash: str  # of the arrays, as they follow

    @property
    def num_bytes(self) -> int:
        """Bytes of the arrays."""
        return sum(_padded(8 * int(np.prod(shape))) for shape in self.shapes.values())


class Keeper:
    """Keeps submaps in a file, or in one that ends with it.

    A submap that it gives back has its arrays in the file.
    """

    def __init__(self, path: Path | None = None) -> None:
        """Open a file, or begin it; None takes a temporary file, which nothing outlives.

        Raises:
            InputError: If the file is another one, is damaged, or is in use.
        """
        self._path = path
        self._lock = threading.Lock()
        self._records: dict[str, tuple[_Head, int]] = {}  # where the arrays begin
        if path is None:
            self._file: BinaryIO = tempfile.TemporaryFile(prefix="gpgrad-")  # noqa: SIM115
            self._file.write(MAGIC)
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        with readable(path):
            self._file = path.open("a+b")
        self._held = ProcessLock(path)
        if not self._held.held:
            self._file.close()
            raise InputError(f"{path}: another viewer is keeping its submaps there; name another")
        try:
            self._read(path)
        except BaseException:
            self.close()
            raise

    @property
    def names(self) -> tuple[str, ...]:
        """The ids of all submaps, in the order in which they came."""
        return tuple(self._records)

    def keep(self, submap: Submap, stamp: float | None = None) -> bool:
        """Keep a submap; it is on the disk when this returns.

        Returns:
            Whether it is new: otherwise the same one was kept already.

        Raises:
            InputError: If it has no odometry pose, or its id was kept with another content.
            OSError: If the disk is full; nothing was kept then.
        """
        if submap.pose_odometry is None:
            raise InputError(f"submap {submap.id} has no odometry pose, which a track needs")
        with self._lock:
            if submap.id in self._records:
                head, _ = self._records[submap.id]
                if (head.fingerprint, head.pose) == (
                    submap.fingerprint,
                    seven(submap.pose_odometry),
                ):
                    return False
                raise InputError(
                    f"submap {submap.id} came before with another content; the first one stays: "
                    "give each submap an id of its own"
                )
            self._append(submap, stamp)
            return True

    def submap(self, name: str) -> Submap:
        """Give a submap back.

        Raises:
            KeyError: If it was not kept.
        """
        head, start = self._records[name]
        mapped, offset = map_file(self._file, start, head.num_bytes)
        arrays: dict[str, NDArray[np.float64]] = {}
        for key, shape in head.shapes.items():
            count = int(np.prod(shape))
            arrays[key] = np.frombuffer(mapped, "<f8", count, offset).reshape(shape)
            offset += _padded(8 * count)
        dropped, wild, standing = head.counts
        return Submap(
            head.id,
            arrays.pop("points"),
            head.fingerprint,
            pose_odometry=pose_of(head.pose),
            num_dropped=dropped,
            num_wild=wild,
            num_standing=standing,
            left_out=arrays.get("left_out"),
            colors=arrays.get("colors"),
            noise_std=arrays.get("noise_std"),
            ranges=arrays.get("ranges"),
        )

    def close(self) -> None:
        """Close the file; submaps that were given back can still be read."""
        with self._lock:
            self._file.close()
            if self._path is not None:
                self._held.release()

    def _append(self, submap: Submap, stamp: float | None) -> None:
        arrays = {
            key: np.ascontiguousarray(array, "<f8")
            for key in ARRAYS
            if (array := getattr(submap, key)) is not None
        }
        digest, pieces = hashlib.blake2b(digest_size=16), list[bytes]()
        for array in arrays.values():
            pieces += [array.tobytes(), bytes(_padded(array.nbytes) - array.nbytes)]
        for piece in pieces:
            digest.update(piece)
        assert submap.pose_odometry is not None
        head = _Head(
            submap.id,
            submap.fingerprint,
            seven(submap.pose_odometry),
            stamp,
            (submap.num_dropped, submap.num_wild, submap.num_standing),
            {key: array.shape for key, array in arrays.items()},
            digest.hexdigest(),
        )
        content = msgspec.msgpack.encode(head)
        begin = self._file.seek(0, os.SEEK_END)
        first = HEAD.pack(len(content), _check(content)) + content
        first = first.ljust(_padded(len(first)), b"\0")
        try:
            with naming(self._path or Path(tempfile.gettempdir())):
                self._file.write(b"".join([first, *pieces]))
                self._file.flush()
                if self._path is not None:
                    os.fsync(self._file.fileno())
        except OSError:
            self._file.truncate(begin)
            raise
        self._records[submap.id] = head, begin + len(first)

    def _read(self, path: Path) -> None:
        """Read what an earlier run has kept, and cut off what it did not finish."""
        size = self._file.seek(0, os.SEEK_END)
        self._file.seek(0)
        magic = self._file.read(len(MAGIC))
        if not MAGIC.startswith(magic):
            raise InputError(f"{path}: is not a file of kept submaps; name another --record")
        end = len(MAGIC)
        if len(magic) < end:  # new, or killed before its first line was written
            self._cut(0)
            self._file.write(MAGIC)
            self._file.flush()
            os.fsync(self._file.fileno())
            _keep_name(path)
            return
        while end < size:
            record = self._next(end, size)
            if record is None:
                break
            head, start, whole = record
            after = start + head.num_bytes
            if not whole:
                if after < size:
                    raise InputError(f"{path}: submap {head.id} is damaged at byte {start:,}")
                break
            self._records[head.id] = head, start
            end = after
        if end < size:
            self._cut(end)

    def _next(self, begin: int, size: int) -> tuple[_Head, int, bool] | None:
        """Read a record's head, where its arrays begin, and whether they are what was written."""
        self._file.seek(begin)
        lengths = self._file.read(HEAD.size)
        if len(lengths) < HEAD.size:
            return None
        length, check = HEAD.unpack(lengths)
        if not 0 < length <= LARGEST_HEAD:
            return None
        content = self._file.read(length)
        if len(content) < length or _check(content) != check:
            return None
        try:
            head = msgspec.msgpack.decode(content, type=_Head)
        except (msgspec.DecodeError, RecursionError):
            return None
        start = begin + _padded(HEAD.size + length)
        if start + head.num_bytes > size:
            return None
        digest, left = hashlib.blake2b(digest_size=16), head.num_bytes
        self._file.seek(start)
        while left and (piece := self._file.read(min(left, 1 << 20))):
            digest.update(piece)
            left -= len(piece)
        return head, start, digest.hexdigest() == head.hash

    def _cut(self, end: int) -> None:
        self._file.truncate(end)
        self._file.flush()
        os.fsync(self._file.fileno())


def _padded(size: int) -> int:
    return size + -size % ALIGNED


def _check(content: bytes) -> int:
    return int.from_bytes(hashlib.blake2b(content, digest_size=4).digest(), "big")


def _keep_name(path: Path) -> None:
    """Let the file's name survive a power cut too."""
    if os.name == "nt":
        return  # Windows cannot open folders
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
