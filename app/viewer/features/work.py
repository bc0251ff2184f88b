"""Work that takes a while: a runner that says on a work bar what it does and how it ended.

Files for the pages that ask for them are such work: made by a worker, and sent when they are whole.
"""

import logging
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeAlias

import viser

from app.viewer.session.runner import Job, Result, Runner
from app.viewer.widgets.work_bar import WorkBar
from gpgrad_core.errors import InputError
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.run.progress import Progress

_log = logging.getLogger(__name__)

CANCELLED = "Cancelled."
REPORT_EVERY = 0.01
"""The progress is shown anew once it has grown by this share of the whole."""


def message_of(error: Exception) -> str:
    """Say what went wrong in one line; an unexpected error goes to the log too."""
    if isinstance(error, InputError):
        return str(error)
    _log.error("unexpected error", exc_info=error)
    return f"Unexpected {type(error).__name__}: {error}"


def nobody(fraction: float | None, message: str) -> None:
    """Watch nothing; the default."""


class Work(Generic[Job, Result]):
    """Does one job at a time; progress, cancelling and failure go to the work bar."""

    def __init__(
        self,
        bar: WorkBar,
        what: Callable[[Job], str],
        work: Callable[[Job, Progress], Result],
        on_result: Callable[[Job, Result, float], None],
        *,
        name: str,
        slots: threading.Semaphore | None = None,
        on_cancel: Callable[[Job], None] | None = None,
        watch: Callable[[float | None, str], None] = nobody,
        even_from: float = 0.0,
    ) -> None:
        """Start the worker.

        Args:
            bar: Where it says how far it is; its button cancels the work.
            what: Says what a job does, such as "Fitting"; empty for a job too quick for a bar.
            work: Turns a job into a result; see `Runner`.
            on_result: Given the job, its result and the seconds it took. The bar is idle then.
            name: Of the thread, for debuggers.
            slots: One is held while a job runs; None shares the processors with nobody.
            on_cancel: Told of a job that a user has cancelled, before the bar says so.
            watch: Given how far a job is; and None with the message once it has ended.
            even_from: The fraction from which on it goes on evenly; see `WorkBar.running`.
        """
        self._bar = bar
        self._what = what
        self._work = work
        self._on_result = on_result
        self._after_cancel = on_cancel
        self._watch = watch
        self._even_from = even_from
        self._runner: Runner[Job, Result] = Runner(
            self._run,
            self._finish,
            self._fail,
            on_cancel=self._cancelled,
            slots=slots,
            name=name,
        )
        bar.on_cancel(self.cancel)

    def start(self, job: Job) -> None:
        """Ask for a job; returns at once. It supersedes what runs."""
        self._report(job, 0.0)
        self._runner.submit(job)

    def cancel(self) -> None:
        """Stop what runs at its next progress call; returns at once."""
        self._runner.cancel()

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nothing runs; says whether that came true within the timeout [s]."""
        return self._runner.wait_idle(timeout)

    def close(self) -> None:
        """Stop."""
        self._runner.close()

    def _run(self, job: Job, progress: Progress) -> Result:
        reported = 0.0

        def report(fraction: float) -> None:
            nonlocal reported
            progress(fraction)
            if abs(fraction - reported) >= REPORT_EVERY:
                reported = fraction
                self._report(job, fraction)

        return self._work(job, report)

    def _report(self, job: Job, fraction: float) -> None:
        what = self._what(job)
        if what:
            self._bar.running(what, fraction, self._even_from)
            self._watch(fraction, "")

    def _finish(self, job: Job, result: Result, seconds: float) -> None:
        self._bar.idle()
        self._watch(None, "")
        self._on_result(job, result, seconds)

    def _fail(self, job: Job, error: Exception) -> None:
        del job
        message = message_of(error)
        self._bar.failed(message)
        self._watch(None, message)

    def _cancelled(self, job: Job) -> None:
        if self._after_cancel is not None:
            self._after_cancel(job)
        self._bar.done(CANCELLED)
        self._watch(None, CANCELLED)


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
