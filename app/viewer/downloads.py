"""Files for the pages that ask for them: made in a worker, and sent when they are whole."""

import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import viser

from app.viewer.widgets.work_bar import WorkBar
from app.viewer.work import Work
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.run.progress import Progress

Write: TypeAlias = Callable[[Path, Progress], None]
"""Given where to write a file, and a progress hook."""


def safe_name(name: str, otherwise: str) -> str:
    """Keep of a name what every file system takes; ``otherwise`` if nothing is left.

    >>> safe_name("my hills/2", "file"), safe_name("...", "file")
    ('my_hills_2', 'file')
    """
    return re.sub(r"[^\w.+-]+", "_", name).strip("._") or otherwise


def send_file(page: viser.ClientHandle, name: str, content: bytes) -> None:
    """Let a page save a file."""
    page.send_file_download(name, content, save_immediately=True)


@dataclass(frozen=True, eq=False)
class FileOrder:
    """A file that a page wants."""

    page: viser.ClientHandle
    name: str
    write: Write


class Downloads:
    """Makes one file at a time."""

    def __init__(self, bar: WorkBar, name: str, slots: threading.Semaphore) -> None:
        """Start the worker.

        Args:
            bar: Where it says how far a file is.
            name: Of the thread, for debuggers.
            slots: One is held while a file is made.
        """
        self._bar = bar
        self._work: Work[FileOrder, bytes] = Work(
            bar, lambda order: f"Making {order.name}", _make, self._send, name=name, slots=slots
        )

    def order(self, page: viser.ClientHandle, name: str, write: Write) -> None:
        """Make a file and send it to a page; returns at once."""
        self._work.start(FileOrder(page, name, write))

    def wait_idle(self, timeout: float) -> bool:
        """Wait until no file is being made; says whether that came true within [s]."""
        return self._work.wait_idle(timeout)

    def close(self) -> None:
        """Stop."""
        self._work.close()

    def _send(self, order: FileOrder, content: bytes, seconds: float) -> None:
        send_file(order.page, order.name, content)
        self._bar.done(f"{order.name}: {len(content):,} bytes in {seconds:.1f} s")


def _make(order: FileOrder, progress: Progress) -> bytes:
    with TemporaryFolder("gpgrad-download-") as folder:
        path = Path(folder) / order.name
        order.write(path, progress)
        return path.read_bytes()
