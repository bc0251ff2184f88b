"""The figures of the paper that can be made of datasets, each with its caption, and their page."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from matplotlib.figure import Figure

from gpgrad_core.evaluation.names import file_names
from gpgrad_core.evaluation.pages import TEMPLATES, render
from gpgrad_core.evaluation.plots.curves import draw_figure_8, draw_figure_9, inlier_curve
from gpgrad_core.evaluation.plots.style import in_print, save_printed
from gpgrad_core.evaluation.plots.submaps import (
    aligning_poses,
    draw_figure_1,
    draw_figure_3,
    draw_figure_4,
    draw_figure_6,
    draw_figure_10,
)
from gpgrad_core.evaluation.reproduction import TITLES, ShownPair, ShownSubmap, Subject, poses_of
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.types import Dataset
from gpgrad_core.version import VERSION

PAGE = "index.html"
PIXELS_AN_INCH = 110
"""How large a figure is on a screen, by its size on paper."""
NOT_MADE = (
    "Figs. 2 and 5 of the paper are a diagram and photographs. Its Fig. 7 judges single camera "
    "images, which submaps do not replace."
)


@dataclass(frozen=True, eq=False)
class PaperFigure:
    """A figure that can be drawn.

    Attributes:
        number: Its number in the paper.
        name: Name of its files, without the ending.
        caption: What it shows.
        draw: Draws it.
        shown: What that is given.
    """

    number: int
    name: str
    caption: str
    draw: Callable[..., Figure]
    shown: tuple[object, ...]


def write_figures(
    directory: Path,
    subjects: Sequence[Subject],
    numbers: frozenset[int],
    command: Callable[[frozenset[int]], str],
    progress: Progress = silent,
) -> tuple[str, ...]:
    """Draw all figures that can be made, and write the page.

    Args:
        directory: An existing folder.
        subjects: The datasets, each with what its figures need.
        numbers: Numbers of the wanted figures in the paper.
        command: Gives the command that makes the figures of these numbers.
        progress: Called with the fraction done; may raise Cancelled.

    Returns:
        What is left out and why, one line each.
    """
    figures, notes = list_figures(subjects, numbers)
    widths: dict[str, str] = {}
    for k, figure in enumerate(figures):
        with in_print():
            drawn = figure.draw(*figure.shown)
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
        notes=[*notes, NOT_MADE],
        chapters=[
            (number, TITLES[number], list(drawn), command(frozenset({number})))
            for number, drawn in groupby(figures, key=_number)
        ],
        widths=widths,
        evaluations=evaluations,
        with_intervals=any(summary.interval is not None for summary in summaries),
        version=VERSION,
    )
    (directory / PAGE).write_text(page, encoding="utf-8")
    return tuple(notes)


def list_figures(
    subjects: Sequence[Subject], numbers: frozenset[int]
) -> tuple[list[PaperFigure], list[str]]:
    """List the figures that can be made.

    Args:
        subjects: The datasets, each with what its figures need.
        numbers: Numbers of the wanted figures in the paper.

    Returns:
        The figures, by number and then by dataset; and what is left out and why, one line each.
    """
    figures: list[PaperFigure] = []
    notes = [note for subject in subjects for note in subject.notes]
    names = file_names((subject.dataset.name for subject in subjects), "dataset")
    for subject, name in zip(subjects, names, strict=True):
        made = _figures_of(subject, name, numbers, notes)
        figures += [figure for figure in made if figure.number in numbers]
    figures += _figures_of_all(subjects, numbers, notes)
    return sorted(figures, key=_number), notes


def _number(figure: PaperFigure) -> int:
    return figure.number


def _figures_of(
    subject: Subject, name: str, numbers: frozenset[int], notes: list[str]
) -> list[PaperFigure]:
    """List the figures of one dataset, and note those that it cannot have."""
    shown, pair, dataset = subject.shown, subject.pair, subject.dataset
    if shown is None:
        return []
    figures = [
        PaperFigure(3, f"figure_3_{name}", _caption_of_map(dataset, shown), draw_figure_3, (shown,))
    ]
    if pair is None:
        if wanted := numbers & {1, 4, 10}:
            why = "one submap makes no pair" if len(dataset.submaps) < 2 else "no pair has a motion"
            notes.append(f"{dataset.name}: {_figs(wanted)} left out: {why}")
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
            draw_figure_1,
            (dataset, pair),
        ),
        PaperFigure(
            4,
            f"figure_4_{name}",
            f"{dataset.name}: the check of a loop closure. Top: the gradient maps of both submaps, "
            "with their variance in red and blue, which is full where the variance mask rejects "
            f"keypoints. Middle: the associations, and among them the inliers. Bottom: both maps "
            f"aligned by the motion found, with both variances. {verdict}",
            draw_figure_4,
            (pair,),
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
                draw_figure_10,
                (dataset, pair),
            )
        )
    elif 10 in numbers:
        notes.append(f"{dataset.name}: Fig. 10 left out: the poses of the submaps are not known")
    return figures


def _figures_of_all(
    subjects: Sequence[Subject], numbers: frozenset[int], notes: list[str]
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
            figures.append(PaperFigure(6, "figure_6", caption, draw_figure_6, (tracked,)))
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
            draw_figure_8,
            (judged,),
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
                draw_figure_9,
                (ranked,),
            )
        )
    elif 9 in numbers:
        notes.append("Fig. 9 left out: no pair of any dataset is true")
    return [figure for figure in figures if figure.number in numbers]


def _first_full(subjects: Sequence[Subject]) -> str:
    """Say from which n on all pairs that pass are true, on every dataset."""
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
    """Say what was found of the pair, and whether that is right."""
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
