"""Work that takes a while: a lane of jobs that shows on a work bar what it does and how it ended.

Files that pages request are such work: a worker writes them, and they are sent when complete.
"""

import logging
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
import viser
from jaxtyping import UInt8

from app.viewer.session.decisions import Decisions
from app.viewer.session.jobs import Job, Jobs, Lane, Result, Slots
from app.viewer.session.methods import MethodName
from app.viewer.widgets.status import WHOLE, WorkBar
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.io.poses import write_poses
from gpgrad_core.io.records.closures import report_closures, write_closure_table, write_closures
from gpgrad_core.run import Progress
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.slam import (
    OptimisedGraph,
    build_pose_graph,
    optimise_pose_graph,
    vertex_numbers,
    write_graph,
)
from gpgrad_core.types import Dataset

CANCELLED = "Cancelled."

_log = logging.getLogger(__name__)


def message_of(error: Exception) -> str:
    """What went wrong, in one line; an unexpected error goes to the log too."""
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, OSError) and error.strerror:  # of a path that nobody can have, or a disk
        named = f"{error.filename}: " if error.filename else ""
        return str(InputError(f"{named}{error.strerror}"))
    _log.error("unexpected error", exc_info=error)
    return f"Unexpected {type(error).__name__}: {error}"


class Work(Lane[Job, Result]):
    """Does one job at a time; progress, cancelling and failure go to the work bar."""

    def __init__(
        self,
        jobs: Jobs,
        bar: WorkBar,
        what: Callable[[Job], str],
        work: Callable[[Job, Progress], Result],
        on_result: Callable[[Job, Result, float], None],
        *,
        slots: Slots | None = None,
        on_cancel: Callable[[Job], None] = lambda _: None,
        watch: Callable[[float | None, str], None] = lambda _fraction, _message: None,
        phases: Mapping[str, float] = WHOLE,
    ) -> None:
        """Begin at rest; see `Lane`.

        ``what`` names what a job does, such as "Fitting"; empty for one too quick for a bar. The
        bar is idle when there is a result, and its button cancels the work: ``on_cancel`` comes
        before the bar shows that. ``watch`` is called with how far a job is, and with None and the
        message once it has ended. Phases are those of `WorkBar.running`.
        """

        def tell(job: Job, fraction: float) -> None:
            doing = what(job)
            if doing:
                bar.running(doing, fraction, phases)
                watch(fraction, "")

        def run(job: Job, progress: Progress) -> Result:
            told = 0.0

            def report(fraction: float) -> None:
                nonlocal told
                progress(fraction)
                if abs(fraction - told) >= 0.01:  # of the whole
                    told = fraction
                    tell(job, fraction)

            return work(job, report)

        def finish(job: Job, result: Result, seconds: float) -> None:
            bar.idle()
            watch(None, "")
            on_result(job, result, seconds)

        def fail(_job: Job, error: Exception) -> None:
            message = message_of(error)
            bar.failed(message)
            watch(None, message)

        def end(job: Job) -> None:
            on_cancel(job)
            bar.done(CANCELLED)
            watch(None, CANCELLED)

        self._tell = tell
        super().__init__(jobs, run, finish, fail, on_cancel=end, slots=slots)
        bar.on_cancel(self.cancel)

    def start(self, job: Job) -> None:
        self._tell(job, 0.0)
        self.submit(job)


Write: TypeAlias = Callable[[Path, Progress], None]
"""Writes a file to a path, and reports its progress."""


def safe_name(name: str, otherwise: str) -> str:
    """Keep of a name what every file system takes; ``otherwise`` if nothing is left.

    >>> safe_name("my hills/2", "file"), safe_name("...", "file")
    ('my_hills_2', 'file')
    """
    return re.sub(r"[^\w.+-]+", "_", name).strip("._") or otherwise


def send_file(page: viser.ClientHandle, name: str, content: bytes) -> None:
    """Let a page save a file."""
    page.send_file_download(name, content, save_immediately=True)


GROUND_AND_INK = {False: ("#ffffff", "#14181d"), True: ("#0c0f13", "#e6eaef")}
"""Background of a picture, and what is written on it, by whether it is dark, as the page is."""


def view_of_page(
    page: viser.ClientHandle, width: int, height: int
) -> UInt8[NDArray[np.uint8], "rows columns 4"]:
    """Ask a page to draw its view of the scene anew, so many pixels wide and high."""
    try:
        return page.get_render(
            height=height,
            width=width,
            transport_format="png",
            timeout=60.0,  # [s]; a page without a graphics card draws for seconds
        )
    except TimeoutError as error:
        raise InputError(
            "the page sent no picture within 60 s; bring its window to the front and try again"
        ) from error


@dataclass(frozen=True, eq=False)
class FileOrder:
    """A file that a page wants."""

    page: viser.ClientHandle
    name: str
    write: Write


class Downloads(Work[FileOrder, bytes]):
    """Makes one file at a time, and sends it to the page that wants it."""

    def __init__(self, jobs: Jobs, bar: WorkBar, slots: Slots) -> None:

        def send(order: FileOrder, content: bytes, seconds: float) -> None:
            send_file(order.page, order.name, content)
            bar.done(f"{order.name}: {len(content):,} bytes in {seconds:.1f} s")

        super().__init__(jobs, bar, lambda order: f"Making {order.name}", _make, send, slots=slots)

    def order(self, page: viser.ClientHandle, name: str, write: Write) -> None:
        self.start(FileOrder(page, name, write))


def _make(order: FileOrder, progress: Progress) -> bytes:
    with TemporaryFolder("gpgrad-download-") as folder:
        path = Path(folder) / order.name
        order.write(path, progress)
        return path.read_bytes()


def write_closure_file(
    path: Path,
    dataset: Dataset,
    result: DetectionResult,
    params: PipelineParams,
    method: MethodName,
    *,
    decisions: Decisions | None = None,
    solved: OptimisedGraph | None = None,
) -> None:
    """Write loop closures in the format that the ending of the file names.

    ``.json`` and ``.csv`` hold all verdicts, ``.g2o`` the pose graph, and ``.txt`` the corrected
    poses in TUM's format, which are optimised unless that is done. Those that a person accepted are
    never left out.
    """
    decided = decisions or Decisions()
    trusted, by_hand = decided.trusted, decided.of_closures()
    match path.suffix:
        case ".g2o":
            graph = build_pose_graph(dataset, result.closures, trusted=trusted)
            write_graph(path, graph, None if solved is None else solved.poses)
        case ".txt":
            graph = build_pose_graph(dataset, result.closures, trusted=trusted)
            poses = (solved or optimise_pose_graph(graph)).poses
            numbers = vertex_numbers(graph)
            write_poses(path, {numbers[name]: pose for name, pose in poses.items()})
        case ".csv":
            write_closure_table(path, report_closures(dataset, result, params, method=method))
        case _:
            report = report_closures(dataset, result, params, method=method, decisions=by_hand)
            write_closures(path, report)
