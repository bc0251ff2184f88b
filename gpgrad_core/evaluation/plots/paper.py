"""The figures of the paper that can be made of datasets, each with its caption, and their page."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from operator import attrgetter
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator

from gpgrad_core import __version__
from gpgrad_core.evaluation.experiment import TITLES, FigureData, ShownPair, ShownSubmap, poses_of
from gpgrad_core.evaluation.judge import Evaluation, MethodVerdict
from gpgrad_core.evaluation.plots.report import inlier_curve
from gpgrad_core.evaluation.plots.style import (
    COLUMN,
    INLIER_TICKS,
    RANDOM,
    colour_of,
    in_print,
    line_of,
    new_figure,
    new_panels,
    save_printed,
)
from gpgrad_core.evaluation.plots.submaps import (
    aligning_poses,
    draw_figure_1,
    draw_figure_3,
    draw_figure_4,
    draw_figure_6,
    draw_figure_10,
)
from gpgrad_core.evaluation.precision_recall import PrecisionRecall
from gpgrad_core.evaluation.report import TEMPLATES, render
from gpgrad_core.reading.paths import file_names
from gpgrad_core.run import Progress, silent
from gpgrad_core.types import Array, Dataset

PAGE = "index.html"
PIXELS_AN_INCH = 110
"""How large a figure is on a screen, by its size on paper."""
NUMBER = attrgetter("number")


@dataclass(frozen=True, eq=False)
class PaperFigure:
    """A figure that can be drawn."""

    number: int  # its number in the paper
    name: str  # name of its files, without the ending
    caption: str  # what it shows
    draw: Callable[[], Figure]  # draws it


def write_figures(
    directory: Path,
    subjects: Sequence[FigureData],
    numbers: frozenset[int],
    command: Callable[[frozenset[int]], str],
    progress: Progress = silent,
) -> tuple[str, ...]:
    """Draw the figures that can be made, and write the page, into a folder that exists."""
    figures, notes = list_figures(subjects, numbers)
    widths: dict[str, str] = {}
    for k, figure in enumerate(figures):
        with in_print():
            drawn = figure.draw()
            for ending in (".png", ".svg"):
                save_printed(drawn, directory / f"{figure.name}{ending}")
        widths[figure.name] = f"{drawn.get_figwidth() * PIXELS_AN_INCH:.0f}"
        progress((k + 1) / len(figures))
    evaluations = [subject.evaluation for subject in subjects if subject.evaluation]
    summaries = [
        ranked.average_precision
        for evaluation in evaluations
        for method in evaluation.methods
        if (ranked := method.rules[0].ranked) is not None
    ]
    page = render(
        TEMPLATES / "reproduction.html",
        title=f"The paper's figures from {', '.join(subject.dataset.name for subject in subjects)}",
        method=subjects[0].method.name,
        command=command(numbers),
        notes=[
            *notes,
            "Figs. 2 and 5 of the paper are a diagram and photographs. Its Fig. 7 judges single "
            "camera images, which submaps do not replace.",
        ],
        chapters=[
            (number, TITLES[number], list(drawn), command(frozenset({number})))
            for number, drawn in groupby(figures, key=NUMBER)
        ],
        widths=widths,
        evaluations=evaluations,
        with_intervals=any(summary.interval is not None for summary in summaries),
        version=__version__,
    )
    (directory / PAGE).write_text(page, encoding="utf-8")
    return tuple(notes)


def list_figures(
    subjects: Sequence[FigureData], numbers: frozenset[int]
) -> tuple[list[PaperFigure], list[str]]:
    """List the figures by number and dataset, and what is left out and why, one line each."""
    figures: list[PaperFigure] = []
    notes = [note for subject in subjects for note in subject.notes]
    names = file_names((subject.dataset.name for subject in subjects), "dataset")
    for subject, name in zip(subjects, names, strict=True):
        drawn = _figures_of(subject, name, numbers, notes)
        figures += [figure for figure in drawn if figure.number in numbers]
    figures += _figures_of_all(subjects, numbers, notes)
    return sorted(figures, key=NUMBER), notes


def _figures_of(
    subject: FigureData, name: str, numbers: frozenset[int], notes: list[str]
) -> list[PaperFigure]:
    """List the figures of one dataset, and note those that it cannot have."""
    shown, pair, dataset = subject.shown, subject.pair, subject.dataset
    if shown is None:
        return []
    caption = _caption_of_map(dataset, shown)
    figures = [PaperFigure(3, f"figure_3_{name}", caption, partial(draw_figure_3, shown))]
    if pair is None:
        if chosen := numbers & {1, 4, 10}:
            why = "one submap makes no pair" if len(dataset.submaps) < 2 else "no pair has a motion"
            notes.append(f"{dataset.name}: {_figs(chosen)} left out: {why}")
        return figures
    verdict = _caption_of_pair(subject.method.name, pair)
    _, aligned = aligning_poses(dataset, pair)
    figures += [
        PaperFigure(
            1,
            f"figure_1_{name}",
            f"{dataset.name}: (a) and (c) point clouds of two submaps, (b) and (d) their gradient "
            f"maps, (e) both clouds aligned by {aligned}, the query in red and the database "
            f"submap in blue. {verdict}",
            partial(draw_figure_1, dataset, pair),
        ),
        PaperFigure(
            4,
            f"figure_4_{name}",
            f"{dataset.name}: the check of a loop closure. Top: the gradient maps of both submaps, "
            "with their variance in red and blue, which is full where the variance mask rejects "
            f"keypoints. Middle: the associations, and among them the inliers. Bottom: both maps "
            f"aligned by the motion found, with both variances. {verdict}",
            partial(draw_figure_4, pair),
        ),
    ]
    query, database = pair.query.submap.id, pair.database.submap.id
    poses, frame = poses_of(dataset)
    if query in poses and database in poses:
        figures.append(
            PaperFigure(
                10,
                f"figure_10_{name}",
                f"{dataset.name}: submaps {query} (red) and {database} (blue) "
                f"among all others (grey), aligned by {frame}. Numbers name the submaps, and a "
                f"'+' marks the origin of each. {verdict}",
                partial(draw_figure_10, dataset, pair),
            )
        )
    elif 10 in numbers:
        notes.append(f"{dataset.name}: Fig. 10 left out: the poses of the submaps are not known")
    return figures


def _figures_of_all(
    subjects: Sequence[FigureData], numbers: frozenset[int], notes: list[str]
) -> list[PaperFigure]:
    """List the figures of several datasets, and note those that are not in them."""
    figures: list[PaperFigure] = []
    if 6 in numbers:
        tracked = [subject.dataset for subject in subjects if poses_of(subject.dataset)[0]]
        notes += [
            f"{subject.dataset.name}: not in Fig. 6: fewer than two submaps have a pose"
            for subject in subjects
            if subject.dataset not in tracked
        ]
        if tracked:
            frames = "; ".join(f"{dataset.name} by {poses_of(dataset)[1]}" for dataset in tracked)
            caption = (
                "The tracks of the rover, through the origins of the submaps, coloured by their "
                "order in time. A red circle marks the start and a red square the end. Positions: "
                f"{frames}."
            )
            figures.append(PaperFigure(6, "figure_6", caption, partial(draw_figure_6, tracked)))
    judged = [subject.evaluation for subject in subjects if subject.evaluation is not None]
    if curves := numbers & {8, 9}:
        notes += [
            f"{subject.dataset.name}: not in {_figs(curves)}: fewer than two submaps have a true "
            "pose (poses_gt.txt)"
            for subject in subjects
            if subject.evaluation is None
        ]
    if not judged:
        return figures
    leading, rule = subjects[0].method.name, judged[0].rules[0].statement
    figures.append(
        PaperFigure(
            8,
            "figure_8",
            "Precision and recall of the methods. Of methods that rank by the number of inliers n, "
            "as the paper does, n goes from 1 to 20 and every n has a dot; of the others, the "
            "threshold is each method's own score. The dotted line is a random classifier. "
            f"{rule}",
            partial(draw_figure_8, judged),
        )
    )
    ranked = [
        evaluation for evaluation in judged if inlier_curve(evaluation.methods[0]) is not None
    ]
    if ranked:
        mean = "; the mean is over those of which a pair passes" if len(ranked) > 1 else ""
        figures.append(
            PaperFigure(
                9,
                "figure_9",
                f"Precision of {leading} on every dataset, as a function of the least number of "
                f"inliers n{mean}. A line ends where no pair passes. {_first_full(subjects)} "
                f"{rule}",
                partial(draw_figure_9, ranked),
            )
        )
    elif 9 in numbers:
        notes.append("Fig. 9 left out: no pair of any dataset is true")
    return [figure for figure in figures if figure.number in numbers]


def _first_full(subjects: Sequence[FigureData]) -> str:
    """Describe from which n on all pairs that pass are true, on every dataset."""
    least = 1
    for subject in subjects:
        curve = None if subject.evaluation is None else inlier_curve(subject.evaluation.methods[0])
        if curve is not None:
            wrong = curve.thresholds[curve.precision < 1.0]
            least = max(least, 1 + int(wrong.max(initial=0.0)))
    if least > 20:
        return "Up to n = 20, some of the pairs that pass are false."
    return f"From n = {least} on, all pairs that pass are true."


def _caption_of_map(dataset: Dataset, shown: ShownSubmap) -> str:
    return (
        f"{dataset.name}, submap {shown.submap.id}: (a) and (d) the point cloud "
        f"({shown.submap.num_points:,} points) from two sides, (b) elevation and (c) its variance, "
        "Eqs. (2) and (3), (e) the slope along x, Eq. (4), and (f) the gradient map. Length-scale "
        f"{shown.map.length_scale:.3g} m, signal {shown.map.signal_std:.3g} m, "
        f"{shown.map.grid.resolution:g} m per pixel."
    )


def _caption_of_pair(method: str, pair: ShownPair) -> str:
    """Describe the result of the pair, and whether it is right."""
    closure = pair.closure
    verdict = "accepts" if closure.accepted else "refuses"
    truth = {
        None: "",
        True: " By the true poses this is right.",
        False: " By the true poses the pair or its motion is wrong.",
    }[pair.right if closure.accepted else None]
    return (
        f"The method {method} {verdict} the pair {closure.query_id}, {closure.database_id}: "
        f"{closure.reason}.{truth}"
    )


def _figs(numbers: frozenset[int] | set[int]) -> str:
    """Name figures.

    >>> _figs({4, 1}), _figs({8})
    ('Figs. 1 and 4', 'Fig. 8')
    """
    *some, last = (str(number) for number in sorted(numbers))
    return f"Figs. {', '.join(some)} and {last}" if some else f"Fig. {last}"


def draw_figure_8(evaluations: Sequence[Evaluation]) -> Figure:
    """Draw precision over recall of all methods, a panel for each dataset: the paper's Fig. 8."""
    figure, panels = new_panels([evaluation.dataset for evaluation in evaluations], height=2.2)
    names = list(
        dict.fromkeys(method.name for evaluation in evaluations for method in evaluation.methods)
    )
    for panel, evaluation in zip(panels, evaluations, strict=True):
        labels = evaluation.labels[0]
        for method in evaluation.methods:
            _draw_printed(panel, method, names.index(method.name))
        if labels.positive.any():
            share = float(np.mean(labels.positive[labels.judged]))
            panel.axhline(share, color=RANDOM, linestyle=":", linewidth=1.0)
        else:
            panel.text(0.5, 0.5, "no pair is true", ha="center", transform=panel.transAxes)
        panel.set_xlim(0.0, 1.02)
        panel.set_ylim(0.0, 1.03)
        panel.grid(alpha=0.3, linewidth=0.5)
        panel.set_xlabel("recall")
        panel.set_ylabel("precision")
    handles = [
        Line2D([], [], label=name, **line_of(k, printed=True)) for k, name in enumerate(names)
    ]
    handles.append(Line2D([], [], label="random", color=RANDOM, linestyle=":", linewidth=1.0))
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    return figure


def draw_figure_9(evaluations: Sequence[Evaluation]) -> Figure:
    """Draw precision against the threshold on n, and its mean over all datasets: Fig. 9."""
    figure = new_figure(COLUMN, 2.5)
    panel = figure.subplots()
    ranked = [
        (evaluation.dataset, curve)
        for evaluation in evaluations
        if (curve := inlier_curve(evaluation.methods[0])) is not None
    ]
    for k, (dataset, curve) in enumerate(ranked):
        panel.plot(
            curve.thresholds,
            curve.precision,
            label=dataset,
            color=colour_of(k),
            linewidth=1.0,
            marker="osD^vPX*"[k % 8],
            markersize=3.5,
        )
    if len(ranked) > 1:
        panel.plot(
            ranked[0][1].thresholds,
            mean_precision([curve for _, curve in ranked]),
            label="mean",
            color="black",
            linewidth=2.0,
            zorder=1.5,
        )
    panel.set_xlabel("least number of inliers n")
    panel.set_ylabel("precision")
    panel.set_ylim(0.0, 1.03)
    panel.xaxis.set_major_locator(FixedLocator(INLIER_TICKS))
    panel.grid(alpha=0.3, linewidth=0.5)
    panel.legend(loc="lower right", framealpha=0.9)
    return figure


def _draw_printed(panel: Axes, method: MethodVerdict, number: int) -> None:
    ranked = method.rules[0].ranked
    if ranked is None:
        return
    # The paper's ranking is by the number of inliers alone: then n goes from 1 to 20.
    by_inliers = np.array_equal(method.ranking.score, method.ranking.num_inliers)
    curve = ranked.by_inliers if by_inliers else ranked.by_score
    some = np.isfinite(curve.precision)
    panel.plot(
        curve.recall[some],
        curve.precision[some],
        marker="." if by_inliers else "",
        markersize=4.0,
        zorder=2 if number == 0 else 3,  # it is wider, so it is seen below the others
        clip_on=False,
        **line_of(number, printed=True),
    )


def mean_precision(curves: Sequence[PrecisionRecall]) -> Float[Array, "t"]:
    """Compute the mean precision of the datasets of which a pair passes (t,); NaN if none does."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of a mean of nothing
        return np.nanmean([curve.precision for curve in curves], axis=0)
