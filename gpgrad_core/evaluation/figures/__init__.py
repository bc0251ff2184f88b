"""Figures of an evaluation. They use matplotlib's objects without its global state."""

from matplotlib.figure import Figure

from gpgrad_core.evaluation.figures.affinity import draw_affinity
from gpgrad_core.evaluation.figures.curves import draw_against_inliers, draw_precision_recall
from gpgrad_core.evaluation.figures.loops import draw_loops
from gpgrad_core.evaluation.judge import Evaluation

__all__ = ["draw_figures"]


def draw_figures(evaluation: Evaluation) -> dict[str, Figure]:
    """Draw all figures of an evaluation.

    Returns:
        The figures by file name, without the ending.
    """
    figures: dict[str, Figure] = {}
    if any(labels.positive.any() for labels in evaluation.labels):
        figures["precision_recall"] = draw_precision_recall(evaluation)
        figures["precision_recall_by_inliers"] = draw_precision_recall(evaluation, by_inliers=True)
        figures["precision_by_inliers"] = draw_against_inliers(evaluation)
    for name, method in zip(evaluation.file_names, evaluation.methods, strict=True):
        figures[f"affinity_{name}"] = draw_affinity(evaluation, method)
        figures[f"loops_{name}"] = draw_loops(evaluation, method)
    return figures
