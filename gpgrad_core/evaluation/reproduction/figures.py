"""The figures of the paper that can be made of datasets, each with its caption."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from gpgrad_core.evaluation.reproduction.closure import draw_check, draw_session
from gpgrad_core.evaluation.reproduction.curves import (
    draw_precision_by_inliers,
    draw_precision_recall,
    inlier_curve,
)
from gpgrad_core.evaluation.reproduction.subject import Shown, Subject, poses_of
from gpgrad_core.evaluation.reproduction.terrain import (
    aligning_poses,
    draw_map,
    draw_matching_maps,
)
from gpgrad_core.evaluation.reproduction.tracks import draw_tracks

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
    """

    number: int
    name: str
    caption: str
    draw: Callable[[], Figure]


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
    for subject, name in zip(subjects, _file_names(subjects), strict=True):
        made = _figures_of(subject, name, numbers, notes)
        figures += [figure for figure in made if figure.number in numbers]
    figures += _figures_of_all(subjects, numbers, notes)
    return sorted(figures, key=lambda figure: figure.number), notes


def _figures_of(
    subject: Subject, name: str, numbers: frozenset[int], notes: list[str]
) -> list[PaperFigure]:
    """List the figures of one dataset, and note those that it cannot have."""
    shown, dataset = subject.shown, subject.dataset
    if shown is None:
        return []
    figures = [
        PaperFigure(3, f"figure_3_{name}", _caption_of_map(subject, shown), lambda: draw_map(shown))
    ]
    if shown.closure is None:
        if wanted := numbers & {1, 4, 10}:
            why = "one submap makes no pair" if len(dataset.submaps) < 2 else "no pair has a motion"
            notes.append(f"{dataset.name}: {_figs(wanted)} left out: {why}")
        return figures
    assert shown.database is not None
    pair = _caption_of_pair(subject, shown)
    _, aligned = aligning_poses(dataset, shown)
    figures += [
        PaperFigure(
            1,
            f"figure_1_{name}",
            f"{dataset.name}: (a) and (c) point clouds of two submaps, (b) and (d) their gradient "
            f"maps, (e) both clouds aligned by {aligned}, the query in red and the database "
            f"submap in blue. {pair}",
            lambda: draw_matching_maps(dataset, shown),
        ),
        PaperFigure(
            4,
            f"figure_4_{name}",
            f"{dataset.name}: the check of a loop closure. Top: the gradient maps of both submaps, "
            "with their variance in red and blue, which is full where the variance mask rejects "
            f"keypoints. Middle: the associations, and among them the inliers. Bottom: both maps "
            f"aligned by the motion found, with both variances. {pair}",
            lambda: draw_check(shown),
        ),
    ]
    poses, frame = poses_of(dataset)
    if shown.query.id in poses and shown.database.id in poses:
        figures.append(
            PaperFigure(
                10,
                f"figure_10_{name}",
                f"{dataset.name}: submaps {shown.query.id} (red) and {shown.database.id} (blue) "
                f"among all others (grey), aligned by {frame}. Numbers name the submaps, and a "
                f"'+' marks the origin of each. {pair}",
                lambda: draw_session(dataset, shown),
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
        tracked = [one.dataset for one in subjects if poses_of(one.dataset)[0]]
        notes += [
            f"{one.dataset.name}: not in Fig. 6: fewer than two submaps have a pose"
            for one in subjects
            if one.dataset not in tracked
        ]
        if tracked:
            frames = "; ".join(f"{one.name} by {poses_of(one)[1]}" for one in tracked)
            caption = (
                "The tracks of the rover, through the origins of the submaps, coloured by their "
                "order in time. A red circle marks the start and a red square the end. Positions: "
                f"{frames}."
            )
            figures.append(PaperFigure(6, "figure_6", caption, lambda: draw_tracks(tracked)))
    judged = [one.evaluation for one in subjects if one.evaluation is not None]
    if curves := numbers & {8, 9}:
        notes += [
            f"{one.dataset.name}: not in {_figs(curves)}: fewer than two submaps have a true pose "
            "(poses_gt.txt)"
            for one in subjects
            if one.evaluation is None
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
            lambda: draw_precision_recall(judged),
        )
    )
    ranked = [one for one in judged if inlier_curve(one.methods[0]) is not None]
    if ranked:
        mean = "; the mean is over those of which a pair passes" if len(ranked) > 1 else ""
        figures.append(
            PaperFigure(
                9,
                "figure_9",
                f"Precision of {leading} on every dataset, as a function of the least number of "
                f"inliers n{mean}. A line ends where no pair passes. {_first_full(subjects)} "
                f"{rule}",
                lambda: draw_precision_by_inliers(ranked),
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


def _caption_of_map(subject: Subject, shown: Shown) -> str:
    made = shown.query_map
    return (
        f"{subject.dataset.name}, submap {shown.query.id}: (a) and (d) the point cloud "
        f"({shown.query.num_points:,} points) from two sides, (b) elevation and (c) its variance, "
        "Eqs. (2) and (3), (e) the slope along x, Eq. (4), and (f) the gradient map. Length-scale "
        f"{made.length_scale:.3g} m, signal {made.signal_std:.3g} m, {made.grid.resolution:g} m "
        "per pixel."
    )


def _caption_of_pair(subject: Subject, shown: Shown) -> str:
    """Say what was found of the pair, and whether that is right."""
    assert shown.closure is not None
    verdict = "accepts" if shown.closure.accepted else "refuses"
    truth = {
        None: "",
        True: " By the true poses this is right.",
        False: " By the true poses the pair or its motion is wrong.",
    }[shown.right if shown.closure.accepted else None]
    return (
        f"The method {subject.method.name} {verdict} the pair {shown.closure.query_id}, "
        f"{shown.closure.database_id}: {shown.closure.reason}.{truth}"
    )


def _figs(numbers: frozenset[int] | set[int]) -> str:
    """Name figures.

    >>> _figs({4, 1}), _figs({8})
    ('Figs. 1 and 4', 'Fig. 8')
    """
    *some, last = (str(number) for number in sorted(numbers))
    return f"Figs. {', '.join(some)} and {last}" if some else f"Fig. {last}"


def _file_names(subjects: Sequence[Subject]) -> list[str]:
    """Give the datasets' names as parts of file names, all different."""
    names: list[str] = []
    for subject in subjects:
        plain = re.sub(r"[^\w-]+", "_", subject.dataset.name).strip("_") or "dataset"
        name, k = plain, 1
        while name in names:
            k += 1
            name = f"{plain}_{k}"
        names.append(name)
    return names
