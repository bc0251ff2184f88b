"""Which source a text names: ``-``, a port, ``tcp://HOST:PORT``, a file or a folder."""

import io
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

from gpgrad_core.errors import InputError
from gpgrad_core.live.folder import SubmapFolder
from gpgrad_core.live.recorded import GrowingRecording
from gpgrad_core.live.server import Server
from gpgrad_core.live.source import LOOK, News, Source, Stream
from gpgrad_core.reading.files import check_regular
from gpgrad_core.reading.paths import check_path
from gpgrad_core.recordings.bag_reader import ENDINGS
from gpgrad_core.recordings.build import is_recording


def open_source(text: str) -> Source:
    """Open the source that a text names."""
    if text == "-":
        # Without a buffer: one that a thread still reads has a lock, on which Python's end waits.
        return Stream(io.FileIO(sys.stdin.fileno(), closefd=False).read)
    if text.isdecimal():
        return Server(port=_port(text, text))
    if text.startswith("tcp://"):
        host, _, port = text.removeprefix("tcp://").rpartition(":")
        return Server(host.strip("[]") or "127.0.0.1", _port(port, text))
    path = check_path(text)
    if path.is_dir():
        return _Folder(path)
    if not path.exists():
        raise InputError(
            f"{text}: there is no such file or folder; a source is one of these, -, a port, or "
            "tcp://HOST:PORT"
        )
    if path.suffix.lower() not in ENDINGS:
        raise InputError(
            f"{path}: a file that is followed is a bag ({' '.join(ENDINGS)}); for clouds, name the "
            "folder into which they are written"
        )
    return GrowingRecording(check_regular(path))


def outlives(text: str) -> bool:
    """Whether a source can be read again: what comes over a socket or a pipe comes once."""
    return text != "-" and not text.isdecimal() and not text.startswith("tcp://")


def _port(text: str, where: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise InputError(f"{where}: a port is a number from 0 to 65535, as in tcp://127.0.0.1:8090")
    return int(text)


class _Folder(Source):
    """A folder that may still be empty: what is written into it first says what it will be."""

    def __init__(self, path: Path) -> None:
        super().__init__(str(path))
        self._path = path

    def news(self, stopped: threading.Event) -> Iterator[News]:
        while not stopped.is_set():
            if not any(self._path.iterdir()):
                stopped.wait(LOOK)
                continue
            has_bag = any(file.suffix.lower() in ENDINGS for file in self._path.iterdir())
            is_growing = has_bag or is_recording(self._path)
            source = (GrowingRecording if is_growing else SubmapFolder)(self._path)
            source.keep(self._stored_ids)
            yield from source.news(stopped)
            return
