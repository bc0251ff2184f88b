"""What a notebook shows: the pages of `gpgrad_core.pages` in a frame of a cell's output."""

from dataclasses import dataclass
from html import escape
from pathlib import Path

from gpgrad_core.detection import DetectionResult, PairResult, PipelineParams
from gpgrad_core.detection.pipeline import check_affordable
from gpgrad_core.evaluation import Evaluation
from gpgrad_core.io.records.closures import ClosureReport, report_closures
from gpgrad_core.io.records.files import replacing
from gpgrad_core.pages.page import page_of_dataset, page_of_pair
from gpgrad_core.pages.subject import subject_of
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Dataset


@dataclass(frozen=True, eq=False)
class Inline:
    """A page that a notebook shows in the output of a cell.

    It needs no server: saved with the notebook, it works wherever the notebook is opened and
    trusted.
    """

    page: str  # the page as HTML
    height: int = 760  # of the frame [pixels of the page]
    # whether the frame keeps the page from the notebook, its cookies and its server
    closed: bool = True

    def _repr_html_(self) -> str:
        """Embed the page in a frame of its own, so that neither side changes the other."""
        limits = ' sandbox="allow-scripts"' if self.closed else ""
        return (
            f'<iframe srcdoc="{escape(self.page)}" width="100%" height="{self.height}" '
            f'style="border:0"{limits}></iframe>'
        )

    def save(self, path: Path | str) -> Path:
        """Write the page as a file, which opens from disk.

        Raises:
            InputError: If the file cannot be written there.
        """
        path = Path(path)
        with replacing(path) as unfinished:
            unfinished.write_text(self.page, encoding="utf-8")
        return path


def show(
    shown: PairResult | Dataset,
    detection: DetectionResult | ClosureReport | None = None,
    *,
    params: PipelineParams | None = None,
    evaluation: Evaluation | None = None,
    memo: Memo | None = None,
    height: int = 760,
    progress: Progress = silent,
) -> Inline:
    """Show a pair, or a dataset with its loop closures, in a notebook.

    Args:
        shown: The result of `register_pair`, which is shown in three dimensions; or a dataset,
            which is shown as a map before and after its correction, with its scores and pairs.
        detection: The verdicts on the dataset's pairs; without them the terrain alone is shown.
        params: Parameters of the maps; None takes those of the detection, or else the defaults.
        evaluation: The detection judged by the true poses; None judges it, if there are any.
        memo: That of the detection, so that its maps need not be made again.
        height: Height of the frame [pixels of the page].
        progress: Called with the fraction done; may raise Cancelled.

    Returns:
        What a notebook shows as the value of a cell, and `Inline.save` writes as a file.

    Raises:
        InputError: If a submap's map cannot be made.
    """
    if isinstance(shown, PairResult):
        used = params or PipelineParams()
        return Inline(page_of_pair(shown, max_std_ratio=used.features.max_std_ratio), height)
    used = params or (detection.params if isinstance(detection, DetectionResult) else None)
    used = used or PipelineParams()
    for submap in shown.submaps:
        check_affordable(submap, used)  # refused before the long work on any
    if not isinstance(detection, ClosureReport):
        detection = report_closures(shown, detection or DetectionResult((), {}), used)
    subject = subject_of(shown, detection, used, evaluation=evaluation)
    return Inline(page_of_dataset(subject, memo, progress), height)
