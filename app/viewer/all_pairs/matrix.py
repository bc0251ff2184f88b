"""All pairs as a picture: scores below the diagonal, true overlap above, verdicts as marks.

The page itself finds the cell under the mouse and its values: the picture carries them along, and
has one handler for all cells.
"""

import base64
import json
from html import escape

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from app.viewer.all_pairs.cells import Cell, PairCells
from app.viewer.all_pairs.judging import JudgedPairs
from app.viewer.decisions import ACCEPTED, MISSED, NO_OVERLAP, RIGHT, WRONG_MOTION
from app.viewer.draw.colors import colorize
from app.viewer.state import ColorMap
from app.viewer.widgets.bridge import run_when_shown
from app.viewer.widgets.html import FAINT
from gpgrad_core.arrays import Array, NDArray

RIGHT_COLOR, SHOWN_COLOR = "#2fbf4f", "#ff00ff"
OUTCOME_COLORS = {
    RIGHT: RIGHT_COLOR,
    ACCEPTED: RIGHT_COLOR,
    WRONG_MOTION: "#ff3b30",
    NO_OVERLAP: "#ffffff",
    MISSED: "#ff9f0a",
}
"""Of the marks. Each has a shape of its own too, for those who do not tell the colours apart."""
TOP_SHARE = 0.995
"""Scores above those of this share of the pairs have the last colour: a few are far above."""
WIDTH = 300.0
"""Of the picture in its own units, which are about the page's pixels."""
FONT, LETTER = 10.0, 5.9
"""Height and width of a letter."""
LONGEST_NAME = 10
"""Letters of an id beside the matrix; the rest is left out."""
LONGEST_READ = 40
"""Letters of an id where the mouse is."""
POINT = "Point at a cell to read it, and click to open the pair."

# In the page: which cell the mouse is on, what it says, and what a click tells.
SCRIPT = """
window.gpgradMatrix = window.gpgradMatrix || {
  cell(svg, event) {
    const at = new DOMPoint(event.clientX, event.clientY)
      .matrixTransform(svg.getScreenCTM().inverse());
    const d = svg.dataset, cells = svg.cells || (svg.cells = JSON.parse(d.cells));
    const column = Math.floor((at.x - d.left) / d.side), row = Math.floor((at.y - d.top) / d.side);
    const inside = row >= 0 && column >= 0 && row < +d.rows && column < +d.columns;
    const text = cells[row + ',' + column] || (+d.mirrored && cells[column + ',' + row]);
    return {row, column, text: inside ? text : undefined};
  },
  move(svg, event) {
    const found = this.cell(svg, event), d = svg.dataset;
    const spot = svg.querySelector('[data-spot]');
    const said = svg.parentElement.querySelector('[data-said]');
    said.textContent = found.text || said.dataset.said;
    spot.setAttribute('visibility', found.text ? 'visible' : 'hidden');
    spot.setAttribute('x', +d.left + found.column * d.side);
    spot.setAttribute('y', +d.top + found.row * d.side);
    svg.style.cursor = found.text ? 'pointer' : 'default';
  },
  leave(svg) {
    const said = svg.parentElement.querySelector('[data-said]');
    said.textContent = said.dataset.said;
    svg.querySelector('[data-spot]').setAttribute('visibility', 'hidden');
  },
  click(svg, event) {
    const {row, column, text} = this.cell(svg, event);
    if (text) gpgrad.say('matrix', {name: svg.dataset.name, row, column});
  },
};
"""


def matrix_html(
    name: str, pairs: PairCells, high: float, shown: tuple[str, str] | None = None
) -> str:
    """Draw a matrix, with a row per query and a column per database submap.

    Args:
        name: That a click on the matrix tells, with the row and the column.
        pairs: The cells.
        high: Score of the last colour.
        shown: (query, database) of the pair that the scene shows, to point at.

    Returns:
        HTML with a line that says what the mouse is on; ids in it are escaped. Its size does not
        grow with the number of submaps.
    """
    num_rows, num_columns = len(pairs.rows), len(pairs.columns)
    row_names = [_short(group[0], LONGEST_NAME) for group in pairs.rows]
    column_names = [_short(group[0], LONGEST_NAME) for group in pairs.columns]
    left = 5.0 + LETTER * max(map(len, row_names), default=1)
    side = (WIDTH - left - 1.0) / max(num_rows, num_columns)
    bottom = side * num_rows + 1.0
    names, depth = _axis_names(row_names, column_names, left, side, bottom)
    right = left + side * num_columns
    picture = _uri(cell_pixels(pairs, high))
    texts = {f"{row},{column}": text for (row, column), text in _texts(pairs).items()}
    return (
        f'<div style="padding:.2em .75em">'
        f'<svg data-testid="affinity-{name}" data-name="{name}" data-left="{left:.2f}" '
        f'data-top="1" data-side="{side:.4f}" data-rows="{num_rows}" '
        f'data-columns="{num_columns}" data-mirrored="{int(pairs.rows == pairs.columns)}" '
        f'data-cells="{escape(_json(texts))}" '
        f'role="img" aria-label="scores of all pairs" viewBox="0 0 {WIDTH:g} {bottom + depth:.1f}" '
        f'style="width:100%;display:block" font-size="{FONT:g}" fill="currentColor" '
        f'onmousemove="gpgradMatrix.move(this,event)" onmouseleave="gpgradMatrix.leave(this)" '
        f'onclick="gpgradMatrix.click(this,event)">'
        f'<rect x="{left:.2f}" y="1" width="{right - left:.2f}" height="{bottom - 1.0:.2f}" '
        f'fill="#8884"/>'
        f'<image href="{picture}" x="{left:.2f}" y="1" width="{right - left:.2f}" '
        f'height="{bottom - 1.0:.2f}" preserveAspectRatio="none" '
        f'style="image-rendering:pixelated"/>'
        f"{_marks(name, pairs, left, side)}{_shown(pairs, shown, left, side)}"
        f'<rect data-spot="" visibility="hidden" width="{side:.2f}" height="{side:.2f}" '
        f'fill="none" stroke="#fff" stroke-width="1.5" pointer-events="none"/>{names}</svg>'
        f'<div data-testid="matrix-said-{name}" data-said="{escape(POINT)}" '
        f'style="font-size:.85em;line-height:1.35;height:2.7em;overflow:hidden;{FAINT}">'
        f"{escape(POINT)}</div></div>{run_when_shown(SCRIPT)}"
    )


def highest_color(judged: JudgedPairs) -> float:
    """Give the score that has the last colour."""
    scores = np.array([closure.registration.score for closure in judged.closures])
    return max(float(np.quantile(scores, TOP_SHARE)), 1e-9) if len(scores) else 1.0


def cell_pixels(pairs: PairCells, high: float) -> UInt8[NDArray[np.uint8], "rows columns 4"]:
    """Colour every cell: scores in viridis from 0, overlaps in greys from 0 (dark) to 1.

    What is not known stays transparent.
    """
    scores = np.full(pairs.overlaps.shape, np.nan)
    for at, cell in pairs.cells.items():
        scores[at] = cell.score
    pixels = np.zeros((*scores.shape, 4), np.uint8)
    layers: tuple[tuple[Float[Array, "rows columns"], float, ColorMap], ...] = (
        (pairs.overlaps, 1.0, "grey"),
        (scores, high, "viridis"),
    )
    for values, highest, color_map in layers:
        known = np.isfinite(values)
        pixels[known, :3] = colorize(values[known], 0.0, highest, color_map)
        pixels[known, 3] = 255
    return pixels


def _texts(pairs: PairCells) -> dict[tuple[int, int], str]:
    """Say what each cell holds; what lies above the diagonal says the same as its mirror."""
    texts: dict[tuple[int, int], str] = {}
    mirrored = pairs.rows == pairs.columns
    for (row, column), cell in pairs.cells.items():
        overlap = float(pairs.overlaps[column, row]) if mirrored else float("nan")
        texts[row, column] = _text(cell, overlap)
    return texts


def _text(cell: Cell, overlap: float) -> str:
    shared = f" · true overlap {overlap:.2f}" if np.isfinite(overlap) else ""
    pair = f"{_short(cell.query, LONGEST_READ)} → {_short(cell.database, LONGEST_READ)}"
    if cell.num_pairs == 1:
        return f"{pair} · score {cell.score:.1f} · {cell.outcome}{shared}"
    return (
        f"Best of {cell.num_pairs:,} pairs: {pair} · score {cell.score:.1f}. "
        f"Worst outcome: {cell.outcome}{shared}"
    )


def _axis_names(
    rows: list[str], columns: list[str], left: float, side: float, bottom: float
) -> tuple[str, float]:
    """Write as many ids as fit beside and below; gives the height of those below too."""
    written: list[str] = []
    for k in range(0, len(rows), _every(len(rows), side, FONT + 1.0)):
        y = 1.0 + (k + 0.5) * side + 0.35 * FONT
        written.append(
            f'<text x="{left - 3:.1f}" y="{y:.1f}" text-anchor="end">{escape(rows[k])}</text>'
        )
    longest = LETTER * max(map(len, columns), default=1)
    level = longest + 5.0 <= max(4.0 * side, 30.0)
    for k in range(0, len(columns), _every(len(columns), side, longest + 5 if level else FONT + 1)):
        x = left + (k + 0.5) * side
        if level:
            x = min(max(x, 0.5 * longest), WIDTH - 0.5 * longest)
            where = f'x="{x:.1f}" y="{bottom + FONT:.1f}" text-anchor="middle"'
        else:
            where = (
                f'transform="translate({x + 0.35 * FONT:.1f} {bottom + 3:.1f}) rotate(-90)" '
                'text-anchor="end"'
            )
        written.append(f"<text {where}>{escape(columns[k])}</text>")
    return "".join(written), FONT + 4.0 if level else longest + 6.0


def _every(count: int, side: float, needed: float) -> int:
    """Say how many names to go on by, so that each has the room that it needs."""
    steps = (scale * step for scale in (1, 10, 100, 1000) for step in (1, 2, 5))
    return next((step for step in steps if step * side >= needed), max(count, 1))


def _marks(name: str, pairs: PairCells, left: float, side: float) -> str:
    """Mark the accepted and the missed pairs: a path for all marks of an outcome."""
    paths: dict[str, list[str]] = {}
    for (row, column), cell in pairs.cells.items():
        if cell.outcome in OUTCOME_COLORS:
            x, y = left + (column + 0.5) * side, 1.0 + (row + 0.5) * side
            paths.setdefault(cell.outcome, []).append(_shape(cell.outcome, x, y, 0.32 * side))
    # A dark rim, or green would not be seen on the greens of the scores.
    thick = min(max(0.16 * side, 0.9), 2.5)
    return "".join(
        f'<defs><path id="mark-{name}-{k}" d="{"".join(path)}"/></defs>'
        f'<g data-outcome="{outcome}" data-count="{len(path)}" fill="none">'
        f'<use href="#mark-{name}-{k}" stroke="#000" stroke-width="{1.9 * thick:.2f}"/>'
        f'<use href="#mark-{name}-{k}" stroke="{OUTCOME_COLORS[outcome]}" '
        f'stroke-width="{thick:.2f}"/></g>'
        for k, (outcome, path) in enumerate(sorted(paths.items()))
    )


def _shape(outcome: str, x: float, y: float, r: float) -> str:
    """Draw a ring for a right pair, a cross, a square or a diamond for the others."""
    if outcome == WRONG_MOTION:
        both = f"l{2 * r:.1f} {2 * r:.1f}m0 {-2 * r:.1f}l{-2 * r:.1f} {2 * r:.1f}"
        return f"M{x - r:.1f} {y - r:.1f}{both}"
    if outcome == NO_OVERLAP:
        return f"M{x - r:.1f} {y - r:.1f}h{2 * r:.1f}v{2 * r:.1f}h{-2 * r:.1f}z"
    if outcome == MISSED:
        return f"M{x:.1f} {y - r:.1f}l{r:.1f} {r:.1f}l{-r:.1f} {r:.1f}l{-r:.1f} {-r:.1f}z"
    arc = f"a{r:.1f} {r:.1f} 0 1 0 "
    return f"M{x - r:.1f} {y:.1f}{arc}{2 * r:.1f} 0{arc}{-2 * r:.1f} 0z"


def _shown(pairs: PairCells, shown: tuple[str, str] | None, left: float, side: float) -> str:
    """Point at the pair shown, whichever way round it is."""
    if shown is None:
        return ""
    places = (pairs.place(*shown), pairs.place(*reversed(shown)))
    found = [at for at in places if at is not None]
    if not found:
        return ""
    row, column = max(found)
    return (
        f'<rect data-testid="shown-pair" data-row="{row}" data-column="{column}" '
        f'x="{left + column * side:.2f}" y="{1.0 + row * side:.2f}" width="{side:.2f}" '
        f'height="{side:.2f}" fill="none" stroke="{SHOWN_COLOR}" '
        f'stroke-width="{min(max(0.2 * side, 1.5), 3.0):.2f}"/>'
    )


def _short(name: str, longest: int) -> str:
    return name if len(name) <= longest else f"{name[: longest - 1]}…"


def _json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def _uri(pixels: UInt8[NDArray[np.uint8], "rows columns 4"]) -> str:
    _, png = cv2.imencode(".png", pixels[..., [2, 1, 0, 3]])
    return "data:image/png;base64," + base64.b64encode(png.tobytes()).decode("ascii")
