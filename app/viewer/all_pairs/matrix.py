"""All pairs as a picture: scores below the diagonal, true overlap above, accepted pairs ringed."""

import base64
from html import escape

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from app.viewer.all_pairs.judging import MISSED, NO_OVERLAP, WRONG_MOTION, JudgedPairs
from app.viewer.draw.colors import colorize
from app.viewer.state import ColorMap
from gpgrad_core.arrays import Array, NDArray

RIGHT_COLOR, SHOWN_COLOR = "#2fbf4f", "#ff00ff"
OUTCOME_COLORS = {WRONG_MOTION: "#ff3b30", NO_OVERLAP: "#ffffff", MISSED: "#ff9f0a"}
"""Of the rings of pairs on which verdict and truth disagree."""
TOP_SHARE = 0.995
"""Scores above those of this share of the pairs have the last colour: a few are far above."""


def affinity_svg(judged: JudgedPairs, shown: tuple[str, str] | None = None) -> str:
    """Draw the matrix, with a row per query and a column per database submap.

    Args:
        judged: All pairs with their verdicts.
        shown: (query, database) of the pair that the scene shows, to point at.

    Returns:
        A picture for a page; ids in it are escaped.
    """
    ids = [submap.id for submap in judged.compared.dataset.submaps]
    places = {name: k for k, name in enumerate(ids)}
    count = len(ids)
    marks: list[str] = []
    for closure, outcome in zip(judged.closures, judged.outcomes, strict=True):
        row, column = places[closure.query_id], places[closure.database_id]
        color = OUTCOME_COLORS.get(outcome)
        if closure.accepted:
            color = color or RIGHT_COLOR
        if color is not None:
            name = escape(
                f"{closure.query_id} → {closure.database_id}: {outcome}, "
                f"score {closure.registration.score:.1f}"
            )
            # A dark rim, or green would not be seen on the greens of the scores.
            ring = f'<circle cx="{column + 0.5}" cy="{row + 0.5}" r=".34" fill="none" stroke='
            marks.append(
                f'{ring}"#000" stroke-width=".3"/>{ring}"{color}" stroke-width=".18">'
                f"<title>{name}</title></circle>"
            )
    if shown is not None and shown[0] in places and shown[1] in places:
        row, column = sorted((places[shown[0]], places[shown[1]]), reverse=True)
        marks.append(
            f'<rect data-testid="shown-pair" x="{column}" y="{row}" width="1" height="1" '
            f'fill="none" stroke="{SHOWN_COLOR}" stroke-width=".22"/>'
        )
    return (
        f'<svg data-testid="affinity" role="img" aria-label="scores of all pairs" '
        f'viewBox="-.2 -.2 {count + 0.4} {count + 0.4}" style="width:100%;display:block">'
        f'<image href="{_uri(matrix_pixels(judged))}" width="{count}" height="{count}" '
        f'style="image-rendering:pixelated"/>{"".join(marks)}</svg>'
    )


def highest_color(judged: JudgedPairs) -> float:
    """Give the score that has the last colour."""
    scores = np.array([closure.registration.score for closure in judged.closures])
    return max(float(np.quantile(scores, TOP_SHARE)), 1e-9) if len(scores) else 1.0


def matrix_pixels(judged: JudgedPairs) -> UInt8[NDArray[np.uint8], "n n 4"]:
    """Colour every pair: scores in viridis from 0, overlaps in greys from 0 (dark) to 1.

    What is not known, and the diagonal, stays transparent.
    """
    scores, overlaps = judged.scores(), judged.overlaps()
    pixels = np.zeros((*scores.shape, 4), np.uint8)
    layers: tuple[tuple[Float[Array, "n n"], float, ColorMap], ...] = (
        (scores, highest_color(judged), "viridis"),
        (overlaps, 1.0, "grey"),
    )
    for values, high, name in layers:
        known = np.isfinite(values)
        pixels[known, :3] = colorize(values[known], 0.0, high, name)
        pixels[known, 3] = 255
    return pixels


def _uri(pixels: UInt8[NDArray[np.uint8], "rows columns 4"]) -> str:
    _, png = cv2.imencode(".png", pixels[..., [2, 1, 0, 3]])
    return "data:image/png;base64," + base64.b64encode(png.tobytes()).decode("ascii")
