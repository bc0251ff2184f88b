"""MCAP files that are still being written, read as far as they are whole."""

import io
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpgrad_core.reading.files import open_regular

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
"""What a record begins with: its kind, and the bytes that follow."""
FOOTER = RECORD.pack(2, 20) + bytes(20) + MAGIC
"""The end of a file without a summary."""

if TYPE_CHECKING:
    SystemPath = Path
else:
    SystemPath = type(Path())


def is_finished(path: Path) -> bool:
    """Tell whether a file has the end that a finished one has."""
    with open_regular(path) as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(max(0, size - len(MAGIC)))
        return size > 2 * len(MAGIC) and file.read() == MAGIC


def whole_until(path: Path, since: int = len(MAGIC)) -> int:
    """Find where the last whole record of a file ends [bytes], from the end of an earlier one on.

    MCAP's specification is mcap.dev/spec: the magic bytes, and then records.
    """
    with open_regular(path) as file:
        size = file.seek(0, io.SEEK_END)
        end = since
        while end + RECORD.size <= size:
            file.seek(end)
            _, length = RECORD.unpack(file.read(RECORD.size))
            if end + RECORD.size + length > size:
                break
            end += RECORD.size + length
    return end


class GrowingMcap(SystemPath):
    """The path of a growing MCAP, opened as if it ended after its last whole record.

    Libraries look for the end of a file first, which this one does not have yet.
    """

    whole: int = len(MAGIC)
    """Where the last whole record ends [bytes]."""

    def open(self, *_args: Any, **_options: Any) -> Any:
        return io.BufferedReader(_Ended(io.FileIO(str(self)), self.whole))


class _Ended(io.RawIOBase):
    """A file up to a place, and a footer after it."""

    def __init__(self, file: io.FileIO, whole: int) -> None:
        super().__init__()
        self._file, self._whole, self._place = file, whole, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        start = {
            io.SEEK_SET: 0,
            io.SEEK_CUR: self._place,
            io.SEEK_END: self._whole + len(FOOTER),
        }[whence]
        self._place = start + offset
        return self._place

    def readinto(self, buffer: Any, /) -> int:
        view = memoryview(buffer).cast("B")
        left = self._whole - self._place
        if left > 0:
            self._file.seek(self._place)
            data = self._file.read(min(left, len(view)))
        else:
            data = FOOTER[-left : len(view) - left]
        view[: len(data)] = data
        self._place += len(data)
        return len(data)

    def close(self) -> None:
        self._file.close()
        super().close()
