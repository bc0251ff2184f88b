"""The matrix of all pairs beside the picture: large, with its key, and linked with the map."""

from dataclasses import replace
from html import escape

import numpy as np
import viser

from app.viewer.charts import png_uri, text
from app.viewer.features.pairs.matrix import (
    OUTCOME_COLORS,
    MatrixLook,
    PairCells,
    mark_svg,
    matrix_html,
    score_shares,
)
from app.viewer.features.pairs.model import JudgedPairs
from app.viewer.features.world import WorldScene
from app.viewer.scene.cameras import place_on_screen, view_of
from app.viewer.scene.colors import DATABASE, QUERY, colorize, css
from app.viewer.scene.placement import Canvas
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import inline_script, send
from gpgrad_core.types import PairOfIds

MOST_ROWS = 400
"""Of the large matrix, which can be enlarged further; more submaps are gathered in groups."""
WIDTH = 640.0
"""Of its picture in its own units."""
BAR = 170.0
"""Width of the bar of colours [pixels]."""


def board_html(content: str | None) -> str:
    """Put the board over the canvas of a page, or take it away; it may have to wait for pairs."""
    if content is None:
        return inline_script("window.gpgradMatrix?.show?.(null)")
    close = (
        f'<button type="button" aria-label="Close the matrix" title="Close the matrix (Shift + P)" '
        f'onclick="{send("board")}">✕</button>'
    )
    waits = '<p role="status">Comparing the first pairs …</p>'
    return (
        f'<section data-board="" data-testid="matrix-board" aria-label="Matrix of all pairs">'
        f"<style>{fill_page_file('board.css')}</style>{close}{content or waits}</section>"
        + inline_script(f"{fill_page_file('matrix.js')};gpgradMatrix.show(this.parentNode)")
    )


def draw_board(
    judged: JudgedPairs,
    cells: PairCells,
    summary: str,
    shown: tuple[str, str],
    look: MatrixLook,
) -> str:
    """Draw the large matrix with its heading and its key."""
    look = replace(look, width=WIDTH, asks=True)
    return (
        f"<h2>All pairs</h2><p>{escape(summary)}</p>"
        f"{matrix_html('board', cells, judged.top_score, shown, look)}"
        f'<div class="key">{_color_bar(judged.top_score, look.threshold)}{_key(judged, look)}</div>'
    )


def _color_bar(high: float, threshold: float) -> str:
    """Draw the colours of the scores, with a tick at the threshold."""
    scores = np.linspace(0.0, high, int(BAR))
    colors = colorize(score_shares(scores, high, threshold), 0.0, 1.0, "viridis")
    at = min(threshold / high, 1.0) * BAR
    return (
        f'<svg width="{BAR + 24:g}" height="42" viewBox="-6 -14 {BAR + 24:g} 42" role="img" '
        f'aria-label="Score, from 0 to {high:.1f}; the least is {threshold:g}" font-size="11" '
        f'fill="currentColor"><image href="{png_uri(colors[None])}" width="{BAR:g}" height="12" '
        f'preserveAspectRatio="none"/>{text(0, 25, "score 0")}'
        f"{text(BAR, 25, f'{high:.0f}', 'middle')}"
        f'<path d="M{at:.1f} -1v15" stroke="currentColor" stroke-width="2"/>'
        f"{text(at, -4, f'least {threshold:g}', 'middle' if at > 20 else 'start')}</svg>"
    )


def _key(judged: JudgedPairs, look: MatrixLook) -> str:
    """Name the marks that the matrix has."""
    outcomes = set(judged.outcomes.values())
    names = [name for name in OUTCOME_COLORS if name in outcomes]
    names += ["not compared"] if judged.num_skipped else []
    key = "".join(f"<span>{mark_svg(name)}{escape(name)}</span>" for name in names)
    return key + ("<span>by hand: ◤ accepted, ◢ refused</span>" if look.by_hand else "")


def light(pair: PairOfIds, scene: WorldScene, page: viser.ClientHandle, canvas: Canvas) -> str:
    """Draw the footprints of a pair and an arc between them, in pixels of a page's canvas."""
    drawn, middles = "", list[tuple[float, float]]()
    for name, color in zip(pair, (QUERY, DATABASE), strict=True):
        corners = scene.footprint(name)
        if corners is None:
            continue
        places = place_on_screen(view_of(page), canvas, corners)
        if not np.isfinite(places).all():
            continue
        x, y = places.mean(axis=0).tolist()
        middles.append((x, y))
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in places.tolist())
        drawn += (
            f'<polygon points="{points}" fill="{css(color)}" fill-opacity=".22" '
            f'stroke="{css(color)}" stroke-width="3" stroke-linejoin="round"/>'
        )
    if len(middles) == 2:
        (x, y), (u, v) = middles
        bend = 0.35 * float(np.hypot(u - x, v - y)) + 30.0
        arc = f"M{x:.1f} {y:.1f}Q{(x + u) / 2:.1f} {(y + v) / 2 - bend:.1f} {u:.1f} {v:.1f}"
        drawn += "".join(
            f'<path d="{arc}" fill="none" stroke="{color}" stroke-width="{width}"/>'
            for color, width in (("#000", 6), ("#fff", 3))
        )
    for (x, y), name in zip(middles, pair, strict=False):
        drawn += f'<g class="name">{text(x, y - 6, name, "middle")}</g>'
    return drawn
