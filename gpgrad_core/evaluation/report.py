"""Writes the report of an evaluation: ``report.json``, ``report.md``, its sections and figures."""

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from math import degrees
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np

from gpgrad_core import __version__
from gpgrad_core.detection import DetectionResult
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation.judge import Evaluation, MethodVerdict, evaluate
from gpgrad_core.evaluation.overlap import TruePairs
from gpgrad_core.evaluation.rules import EvaluationParams, Labels, Rule
from gpgrad_core.io.records.closures import ClosureReport, count_images, write_closures
from gpgrad_core.io.records.files import replacing, write_json
from gpgrad_core.run import Progress, silent
from gpgrad_core.types import Dataset, ImageSays

UNKNOWN = "n/a"
CAPTIONS = {
    "precision_recall_by_inliers": "Like the paper's Fig. 8: the threshold is n = 1 to 20 inliers.",
    "precision_recall": "Precision over recall of all methods. A star marks what a method accepts.",
    "precision_by_inliers": "Like the paper's Fig. 9: precision and recall against n.",
    "affinity_": "The true overlap of all pairs, and the scores of a method.",
    "loops_": "The loop closures of a method on the true traverse.",
}
"""Captions of figures by the beginning of their names; the first that fits is used."""
TEMPLATES = Path(__file__).parent / "templates"
Protocol = Literal["gpgrad", "paper"]
MIN_OVERLAPS = (0.3, 0.1)
"""Smallest overlap of a true pair in the paper: on Etna, and in Morocco (Sec. VII-A)."""
SURE_INLIERS = 5
"""From so many inliers on, all pairs of the paper were right (Sec. VII-C)."""


@dataclass(frozen=True, eq=False)
class Section:
    """An additional section of the report, which does not come from the ranking of pairs."""

    key: str  # its key in ``report.json``
    content: Mapping[str, object]  # its value there: numbers, texts, lists and tables by name
    text: str  # its Markdown, which begins with a heading


def render(template: Path, **values: object) -> str:
    """Fill a template of Jinja; ``.html`` escapes all values, and a missing name is an error."""
    # Imported here because commands that write no page need not wait for it.
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415

    environment = Environment(
        loader=FileSystemLoader(template.parent),
        autoescape=template.suffix == ".html",
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template.name).render(values)


def cell(text: str) -> str:
    """Write a text as a cell of a Markdown table."""
    return text.replace("|", "/")


def check_directory(
    directory: Path | str, names: Iterable[str] = (), *, overwrite: bool = True
) -> Path:
    """Check that a report can be written to a folder, which need not exist, before long work."""
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
    write_json(directory / "report.json", content)
    return (*written, directory / "report.md", directory / "report.json")


def describe(
    evaluation: Evaluation, figures: Sequence[str] = (), sections: Sequence[Section] = ()
) -> str:
    """Write the text of the report in Markdown; `figures` are its pictures, without the ending."""
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
        shown_inliers=(1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20),
        version=__version__,
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
                "gpgrad": __version__,
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


@dataclass(frozen=True)
class ByInliers:
    """How a method ranks the pairs by their inliers, under one protocol."""

    protocol: str  # the protocol in a few words
    method: str  # name of the method
    true: int  # number of true pairs
    false: int  # number of false pairs
    left_out: int  # number of pairs that are not judged
    average_precision: float | None  # of the ranking by n; None if no pair is true
    recall_at_full_precision: float | None  # of the same
    right_from: int | None  # the smallest n from which all pairs are true; None if there is none
    found_from_4: tuple[int, int]  # numbers of true and of false pairs with four inliers or more
    found_from_5: tuple[int, int]  # the same with five inliers or more
    false_placed_right: int  # number of the latter false pairs whose motion is right


def describe_evaluation(evaluation: Evaluation, reports: Mapping[str, ClosureReport]) -> list[str]:
    """Summarise an evaluation: a line for each method, and one for the camera images."""
    rule, lines = evaluation.rules[0], list[str]()
    for method in evaluation.methods:
        verdict = method.rules[0]
        line = f"{method.name}: "
        if verdict.ranked:
            line += (
                f"AP {verdict.ranked.average_precision.value:.3f}, "
                f"R100 {verdict.ranked.recall_at_full_precision.value:.3f}, "
            )
        lines.append(
            f"{line}accepts {verdict.accepted_true} true and {verdict.accepted_false} false pairs, "
            f"misses {verdict.missed} ({rule.name})"
        )
        if images := count_images(pair.images for pair in reports[method.name].pairs):
            lines.append(f"{method.name}: {images}")
    return lines


def as_in_paper(params: EvaluationParams) -> EvaluationParams:
    """Judge all pairs: neighbours too, and every pair that is not true is false."""
    return replace(params, neighbours=0, count_grey=True)


def describe_protocol(
    dataset: Dataset,
    detections: Mapping[str, DetectionResult | ClosureReport],
    evaluation: Evaluation,
) -> Section:
    """Judge detections by the paper's protocol too, and set the results beside ours."""
    rows: list[ByInliers] = []
    papers = replace(as_in_paper(evaluation.params), num_resamples=0)
    for overlap in MIN_OVERLAPS:
        params = replace(papers, min_overlap=overlap)
        judged = evaluate(dataset, detections, params, pairs=evaluation.pairs, seed=evaluation.seed)
        rows += _rows_by_inliers(judged, f"paper's, {judged.rules[0].name}", 0)
    for k, rule in enumerate(evaluation.rules):
        rows += _rows_by_inliers(evaluation, f"ours, {rule.name}", k)
    text = render(TEMPLATES / "protocols.md", rows=rows, params=evaluation.params, cell=cell)
    return Section("protocols", {"by_inliers": [asdict(row) for row in rows]}, text)


def _rows_by_inliers(evaluation: Evaluation, protocol: str, rule: int) -> list[ByInliers]:
    labels, rows = evaluation.labels[rule], list[ByInliers]()
    true, false = labels.positive, labels.negative
    for method in evaluation.methods:
        ranked, n = method.rules[rule].ranked, method.ranking.num_inliers
        most = int(n[false].max(initial=0))  # of a false pair
        rows.append(
            ByInliers(
                protocol=protocol,
                method=method.name,
                true=int(np.sum(true)),
                false=int(np.sum(false)),
                left_out=int(np.sum(~labels.judged)),
                average_precision=ranked and ranked.average_precision_by_inliers,
                recall_at_full_precision=ranked and ranked.recall_at_full_precision_by_inliers,
                right_from=most + 1 if (true & (n > most)).any() else None,
                found_from_4=(int(np.sum(true & (n >= 4))), int(np.sum(false & (n >= 4)))),
                found_from_5=(
                    int(np.sum(true & (n >= SURE_INLIERS))),
                    int(np.sum(false & (n >= SURE_INLIERS))),
                ),
                false_placed_right=int(np.sum(false & (n >= SURE_INLIERS) & method.errors.near)),
            )
        )
    return rows


def describe_images(
    reports: Mapping[str, ClosureReport], evaluation: Evaluation
) -> tuple[Section, ...]:
    """Count by the truth what camera images say of the pairs that the terrain accepted."""
    labels = evaluation.labels[0]
    content: dict[str, dict[str, dict[str, int]]] = {}
    for name, report in reports.items():
        counts = {word: {"true": 0, "false": 0, "left_out": 0} for word in get_args(ImageSays)}
        for closure in report.pairs:
            row = evaluation.pairs.rows.get(frozenset(closure.pair))
            if closure.images is not None and row is not None:
                true, false = labels.positive[row], labels.negative[row]
                truth = "true" if true else "false" if false else "left_out"
                counts[closure.images.verdict][truth] += 1
                content[name] = counts
    if not content:
        return ()
    text = render(TEMPLATES / "images.md", methods=content, rule=evaluation.rules[0], cell=cell)
    return (Section("images", content, text),)
