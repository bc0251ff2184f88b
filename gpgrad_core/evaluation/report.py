"""Writes the report of an evaluation: ``report.json``, ``report.md`` and figures."""

import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from math import degrees
from pathlib import Path
from typing import cast

import numpy as np

from gpgrad_core.errors import InputError
from gpgrad_core.evaluation.judge import Evaluation, MethodVerdict
from gpgrad_core.evaluation.overlap import TruePairs
from gpgrad_core.evaluation.pages import TEMPLATES, cell, render
from gpgrad_core.evaluation.rules import Labels, Rule
from gpgrad_core.io.records.closure_writer import write_closures
from gpgrad_core.io.records.closures import ClosureReport
from gpgrad_core.io.records.files import replacing
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.version import VERSION

SHOWN_INLIERS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20)
UNKNOWN = "n/a"
CAPTIONS = {
    "precision_recall_by_inliers": "Like the paper's Fig. 8: the threshold is n = 1 to 20 inliers.",
    "precision_recall": "Precision over recall of all methods. A star marks what a method accepts.",
    "precision_by_inliers": "Like the paper's Fig. 9: precision and recall against n.",
    "affinity_": "The true overlap of all pairs, and the scores of a method.",
    "loops_": "The loop closures of a method on the true traverse.",
}
"""Captions of figures by the beginning of their names; the first that fits is used."""


@dataclass(frozen=True, eq=False)
class Section:
    """An additional section of the report, which does not come from the ranking of pairs.

    Attributes:
        key: Its key in ``report.json``.
        content: Its value there: numbers, texts, lists and tables by name.
        text: Its Markdown, which begins with a heading.
    """

    key: str
    content: Mapping[str, object]
    text: str


def check_directory(
    directory: Path | str, names: Iterable[str] = (), *, overwrite: bool = True
) -> Path:
    """Check that a report can be written to a folder; call it before long work.

    Args:
        directory: The folder; it need not exist.
        names: Files that will be written, or patterns of them.
        overwrite: Whether they may replace files that exist.

    Returns:
        The folder as a path.

    Raises:
        InputError: If it is a file, cannot be made or written to, or holds one of these files,
            which may not be replaced.
    """
    directory = Path(directory)
    if directory.exists() and not directory.is_dir():
        raise InputError(f"{directory}: is a file; give the name of a folder for the report")
    parent = directory if directory.is_dir() else directory.absolute().parent
    if not parent.is_dir():
        raise InputError(
            f"{directory}: cannot write: there is no folder {directory.parent}; make it first"
        )
    if not os.access(parent, os.W_OK):
        raise InputError(f"{directory}: cannot write: no permission to write to {parent}")
    for name in () if overwrite or not directory.is_dir() else names:
        for there in sorted(directory.glob(name)):
            raise InputError(
                f"{directory}: holds {there.name} of an earlier run; name another folder, or "
                "replace it: --overwrite"
            )
    return directory


def write_report(
    directory: Path | str,
    evaluation: Evaluation,
    *,
    closures: Mapping[str, ClosureReport] | None = None,
    sections: Sequence[Section] = (),
    progress: Progress = silent,
) -> tuple[Path, ...]:
    """Write a report into a folder.

    Each file is written whole or not at all, and the report itself is written last, so that it
    never refers to a figure that is missing. Other files in the folder stay.

    Args:
        directory: The folder; it is made if it does not exist.
        evaluation: The results to report.
        closures: The detections of each method, by its name in the evaluation. They are written
            to ``closures_METHOD.json``.
        sections: Additional sections.
        progress: Called with the fraction done; may raise Cancelled.

    Returns:
        The paths of all files written.

    Raises:
        InputError: If the folder cannot be made or written to.
    """
    # Imported here because Matplotlib takes half a second to load.
    from gpgrad_core.evaluation.plots.report import draw_report  # noqa: PLC0415

    directory = check_directory(directory)
    directory.mkdir(exist_ok=True)
    written: list[Path] = []
    closures = closures or {}
    for method, name in zip(evaluation.methods, evaluation.file_names, strict=True):
        if method.name in closures:
            written.append(directory / f"closures_{name}.json")
            write_closures(written[-1], closures[method.name])
    figures = draw_report(evaluation)
    for k, (name, figure) in enumerate(figures.items()):
        written.append(directory / f"{name}.png")
        with replacing(written[-1]) as unfinished:
            figure.savefig(unfinished)
        progress((k + 1) / len(figures))
    text = describe(evaluation, list(figures), sections)
    with replacing(directory / "report.md") as unfinished:
        unfinished.write_text(text, encoding="utf-8")
    content = report_evaluation(evaluation)
    content |= {section.key: _plain(section.content) for section in sections}
    content["figures"] = [f"{name}.png" for name in figures]
    with replacing(directory / "report.json") as unfinished:
        unfinished.write_text(
            json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n",
            encoding="utf-8",
        )
    return (*written, directory / "report.md", directory / "report.json")


def describe(
    evaluation: Evaluation, figures: Sequence[str] = (), sections: Sequence[Section] = ()
) -> str:
    """Write the text of the report in Markdown.

    Args:
        evaluation: The results to report.
        figures: Names of the pictures beside it, without their ending.
        sections: Additional sections.
    """
    text = render(
        TEMPLATES / "report.md",
        evaluation=evaluation,
        judged=[
            (rule, labels, [(method.name, method.rules[k]) for method in evaluation.methods])
            for k, (rule, labels) in enumerate(
                zip(evaluation.rules, evaluation.labels, strict=True)
            )
        ],
        figures=[(name, _caption(name)) for name in figures],
        sections=sections,
        shown_inliers=SHOWN_INLIERS,
        version=VERSION,
        cell=cell,
        share=_share,
        percent=_percent,
        centimetres=_centimetres,
        turn=_turn,
        degrees=degrees,
    )
    return text.rstrip() + "\n"


def _share(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else UNKNOWN


def _percent(share: float | None) -> str:
    return UNKNOWN if share is None else f"{100 * share:.1f} %"


def _centimetres(metres: float | None) -> str:
    return UNKNOWN if metres is None else f"{100 * metres:.1f} cm"


def _turn(radians: float | None) -> str:
    return UNKNOWN if radians is None else f"{degrees(radians):.2f}°"


def _caption(name: str) -> str:
    return next((text for start, text in CAPTIONS.items() if name.startswith(start)), name)


def report_evaluation(evaluation: Evaluation) -> dict[str, object]:
    """Make the content of ``report.json``: metres, radians, and null for unknown."""
    return cast(
        "dict[str, object]",
        _plain(
            {
                "dataset": evaluation.dataset,
                "gpgrad": VERSION,
                "seed": evaluation.seed,
                "params": evaluation.params,
                "notes": evaluation.notes,
                "rules": [
                    _rule(rule, labels)
                    for rule, labels in zip(evaluation.rules, evaluation.labels, strict=True)
                ],
                "methods": [_method(evaluation, method) for method in evaluation.methods],
                "pairs": _pairs(evaluation.pairs, evaluation),
            }
        ),
    )


def _rule(rule: Rule, labels: Labels) -> dict[str, object]:
    return {
        "name": rule.name,
        "measure": rule.measure,
        "threshold": rule.threshold,
        "statement": rule.statement,
        "true": int(np.sum(labels.positive)),
        "false": int(np.sum(labels.negative)),
        "grey": int(np.sum(labels.grey)),
    }


def _method(evaluation: Evaluation, method: MethodVerdict) -> dict[str, object]:
    return {
        "name": method.name,
        "seconds": method.ranking.seconds,
        "accepted": int(np.sum(method.ranking.accepted)),
        "accepted_right": method.accepted.right,
        "accepted_wrong_motion": method.accepted.wrong_motion,
        "accepted_no_overlap": method.accepted.no_overlap,
        "rules": {
            rule.measure: verdict
            for rule, verdict in zip(evaluation.rules, method.rules, strict=True)
        },
    }


def _pairs(pairs: TruePairs, evaluation: Evaluation) -> list[dict[str, object]]:
    return [
        {
            "query": pairs.ids[pairs.query[k]],
            "database": pairs.ids[pairs.database[k]],
            "box_iou": pairs.box_iou[k],
            "surface_overlap": pairs.surface_overlap[k],
            "height_difference": pairs.height_difference[k],
            "T_database_query": pairs.T_database_query[k],
            "methods": {
                method.name: {
                    "score": method.ranking.score[k],
                    "num_inliers": method.ranking.num_inliers[k],
                    "accepted": method.ranking.accepted[k],
                    "offset_error": method.errors.offset[k],
                    "turn_error": method.errors.turn[k],
                }
                for method in evaluation.methods
            },
        }
        for k in range(len(pairs))
    ]


def _plain(value: object) -> object:
    """Convert to what JSON has: numbers of nine digits, and null for those that are not finite."""
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {
            str(key): _plain(item) for key, item in cast("Mapping[object, object]", value).items()
        }
    if isinstance(value, np.ndarray | np.generic):
        return _plain(cast("object", value.tolist()))
    if isinstance(value, list | tuple):
        return [_plain(item) for item in cast("Sequence[object]", value)]
    if isinstance(value, float):
        return float(f"{value:.9g}") if math.isfinite(value) else None
    return value
