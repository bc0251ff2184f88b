"""The matrix of all pairs beside the picture: large, with its key, and linked with the map."""

from dataclasses import replace
from html import escape

import numpy as np
from jaxtyping import Float

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
from app.viewer.scene.cameras import place_on_screen
from app.viewer.scene.colors import DATABASE, QUERY, colorize, css
from app.viewer.scene.placement import Canvas
from app.viewer.session.state import Camera
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import inline_script, send
from gpgrad_core.arrays import Array

MOST_ROWS = 400
"""Of the large matrix, which can be enlarged further; more submaps are gathered in groups."""
WIDTH = 640.0
"""Of its picture in its own units."""
BAR = 170.0
"""Width of the bar of colours [pixels]."""


def board_html(content: str | None) -> str:
    """Show the board over the canvas of a page, or hide it; it may have to wait for pairs."""
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
    outcomes = set(judged.outcomes.values())
    names = [name for name in OUTCOME_COLORS if name in outcomes]
    names += ["not compared"] if judged.num_skipped else []
    key = "".join(f"<span>{mark_svg(name)}{escape(name)}</span>" for name in names)
    key += "<span>greys: true overlap</span>" if judged.check is not None else ""
    return key + ("<span>by hand: ◤ accepted, ◢ refused</span>" if look.by_hand else "")


def light(names: tuple[str, ...], scene: WorldScene, camera: Camera, canvas: Canvas) -> str:
    """Draw the outline of a submap, or of two with the arch between them, in pixels of a canvas."""
    colors = map(css, (QUERY, DATABASE)) if len(names) == 2 else ("var(--gg-accent)",)
    drawn, written = "", ""
    for name, color in zip(names, colors, strict=True):
        places = place_on_screen(camera, canvas, scene.outline(name))
        if not len(places) or not np.isfinite(places).all():
            continue
        drawn += (
            f'<polygon points="{_points(places)}" style="fill:{color};stroke:{color}" '
            f'fill-opacity=".22" stroke-width="3" stroke-linejoin="round"/>'
        )
        if len(names) == 2:
            x, y = places.mean(axis=0).tolist()
            written += text(x, y - 6, name, "middle")
    if len(names) == 2:
        arch = place_on_screen(camera, canvas, scene.arch((names[0], names[1])))
        if len(arch) and np.isfinite(arch).all():
            drawn += "".join(
                f'<polyline points="{_points(arch)}" fill="none" stroke="{color}" '
                f'stroke-width="{width}"/>'
                for color, width in (("#000", 6), ("#fff", 3))
            )
    look = "fill:#fff;stroke:#000;stroke-width:3px;paint-order:stroke"
    return f'{drawn}<g style="{look}">{written}</g>'


def _points(places: Float[Array, "n 2"]) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in places.tolist())
