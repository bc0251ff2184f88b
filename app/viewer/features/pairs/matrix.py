"""All pairs as a matrix of scores and true overlaps; the page itself finds what the mouse is on."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape

import numpy as np
from jaxtyping import Float, UInt8

from app.viewer.charts import png_uri, round_step, text, upright_text
from app.viewer.features.pairs.model import JudgedPairs
from app.viewer.features.world import WorldScene
from app.viewer.scene.cameras import place_on_screen
from app.viewer.scene.colors import DATABASE, QUERY, colorize, css
from app.viewer.scene.placement import Canvas
from app.viewer.session.decisions import (
    ACCEPTED,
    MISSED,
    NO_OVERLAP,
    REFUSED,
    RIGHT,
    WRONG_MOTION,
)
from app.viewer.session.layers import ColorMap
from app.viewer.session.state import Camera
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import inline_script, page_script, send
from app.viewer.widgets.html import FAINT
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import score_in_words
from gpgrad_core.types import LoopClosure, PairOfIds

WIDTH = 300.0
"""Of the pictures in their own units, which are about the page's pixels."""
RIGHT_COLOR, SHOWN_COLOR = "#2fbf4f", "#ff00ff"
OUTCOME_COLORS = {
    RIGHT: RIGHT_COLOR,
    ACCEPTED: RIGHT_COLOR,
    WRONG_MOTION: "#ff3b30",
    NO_OVERLAP: "#ffffff",
    MISSED: "#ff9f0a",
}
"""Of the marks. Each has a shape of its own too, for those who do not tell the colours apart."""
FONT, LETTER = 10.0, 5.9
"""Height and width of a letter."""
LONGEST_NAME, LONGEST_READ = 10, 40
"""Letters of an id beside the matrix, and where the mouse is; the rest is left out."""
OPEN_PAIR = "open-pair"
"""What a page says to have a pair shown."""
MOST_GROUPS = 60
"""Rows of a matrix: a page draws a few thousand cells well, and no more. More submaps are gathered
in groups of equal size, and a cell is a block of pairs."""
BREAK = 0.4, 0.62
"""Shares of the colour map up to the threshold, and from there on: it shows as a step."""
WORST_FIRST = (NO_OVERLAP, WRONG_MOTION, MISSED, RIGHT, ACCEPTED, REFUSED)
"""A cell of several pairs has the colour of its worst."""


@dataclass(frozen=True)
class Cell:
    """The pairs of one cell: the one with the highest score, and the worst outcome of all."""

    query: str
    database: str
    score: float
    outcome: str
    num_pairs: int


@dataclass(frozen=True, eq=False)
class PairCells:
    """Cells by rows (queries) and columns (database submaps), whose ids each has."""

    rows: tuple[tuple[str, ...], ...]
    columns: tuple[tuple[str, ...], ...]
    cells: Mapping[tuple[int, int], Cell]  # by (row, column); none where no pair was compared
    # highest true overlap of pairs, mirrored to `cells`; NaN where there is none
    overlaps: Float[Array, "rows columns"]

    @property
    def has_blocks(self) -> bool:
        return any(len(group) > 1 for group in (*self.rows, *self.columns))

    def place(self, query: str, database: str) -> tuple[int, int] | None:
        """Find the cell of a pair (row, column); None if it is not in this matrix."""
        row = next((k for k, group in enumerate(self.rows) if query in group), None)
        column = next((k for k, group in enumerate(self.columns) if database in group), None)
        return None if row is None or column is None else (row, column)


@dataclass(frozen=True)
class MatrixLook:
    """How a matrix is drawn."""

    # the score from which on pairs may be accepted, where the colours have a step
    threshold: float = 0.0
    # what a person decided about pairs
    by_hand: Mapping[PairOfIds, bool] = field(default_factory=dict[PairOfIds, bool])
    width: float = WIDTH  # of the picture in its own units
    # whether the page asks the server what a cell holds, of which it would have too many
    asks: bool = False


PLAIN = MatrixLook()
KEYS = 'tabindex="0" onkeydown="gpgradMatrix.key(this,event)" '


def gather_all(judged: JudgedPairs, most: int = MOST_GROUPS) -> PairCells:
    """Group all pairs of a dataset into a limited number of rows and columns."""
    ids = [submap.id for submap in judged.run.dataset.submaps]
    size = max(1, -(-len(ids) // most))
    groups = tuple(tuple(ids[k : k + size]) for k in range(0, len(ids), size))
    return gather(judged, groups, groups)


def gather_block(judged: JudgedPairs, whole: PairCells, pair: tuple[str, str]) -> PairCells | None:
    """Show the pairs of the block that has a pair, one by one; None if cells are no blocks."""
    place = whole.place(*pair)
    if place is None or not whole.has_blocks:
        return None
    rows, columns = whole.rows[place[0]], whole.columns[place[1]]
    return gather(judged, tuple((name,) for name in rows), tuple((name,) for name in columns))


def gather(
    judged: JudgedPairs, rows: Sequence[tuple[str, ...]], columns: Sequence[tuple[str, ...]]
) -> PairCells:
    """Group the pairs of some submaps into cells."""
    row_of = {name: k for k, group in enumerate(rows) for name in group}
    column_of = {name: k for k, group in enumerate(columns) for name in group}
    gathered: dict[tuple[int, int], list[LoopClosure]] = {}
    for closure in judged.closures:
        row, column = row_of.get(closure.query_id), column_of.get(closure.database_id)
        if row is not None and column is not None:
            gathered.setdefault((row, column), []).append(closure)
    cells: dict[tuple[int, int], Cell] = {}
    for at, closures in gathered.items():
        best = max(closures, key=lambda closure: closure.registration.score)
        worst = min((judged.outcomes[one.pair] for one in closures), key=WORST_FIRST.index)
        cells[at] = Cell(*best.pair, best.registration.score, worst, len(closures))
    overlaps = np.full((len(rows), len(columns)), np.nan)
    if (truth := judged.run.truth) is not None:
        at_rows = np.array([row_of.get(name, -1) for name in truth.ids])[truth.database]
        at_columns = np.array([column_of.get(name, -1) for name in truth.ids])[truth.query]
        # On the diagonal, the pairs within a group are shown by their scores.
        within = (at_rows >= 0) & (at_columns >= 0) & (at_rows != at_columns)
        measured = judged.rule.measured(truth)
        np.fmax.at(overlaps, (at_rows[within], at_columns[within]), measured[within])
    return PairCells(tuple(rows), tuple(columns), cells, overlaps)


def matrix_html(
    name: str,
    pairs: PairCells,
    high: float,
    shown: tuple[str, str] | None = None,
    look: MatrixLook = PLAIN,
) -> str:
    """Draw a matrix, with a row per query and a column per database submap.

    Scores lie below the diagonal, true overlaps above, and verdicts are marks; the pair shown is
    pointed at. The score ``high`` has the last colour, and a click tells the name, the row and the
    column. A line says what the mouse is on; ids in it are escaped. The size does not grow with
    the number of submaps.
    """
    num_rows, num_columns = len(pairs.rows), len(pairs.columns)
    row_names = [cut_name(group[0], LONGEST_NAME) for group in pairs.rows]
    column_names = [cut_name(group[0], LONGEST_NAME) for group in pairs.columns]
    left = 5.0 + LETTER * max(map(len, row_names), default=1)
    side = (look.width - left - 1.0) / max(num_rows, num_columns)
    bottom = side * num_rows + 1.0
    names, depth = _axis_names(row_names, column_names, left, side, look.width)
    place = f'x="{left:.2f}" y="1" width="{side * num_columns:.2f}" height="{side * num_rows:.2f}"'
    mirrored = pairs.rows == pairs.columns  # above the diagonal stands what its mirror says
    texts = {
        f"{row},{column}": words_of(pairs, row, column)
        for row, column in (() if look.asks else pairs.cells)
    }
    point = "Point at a cell to read it, and click to open the pair."
    return (
        f'<div style="padding:.2em .75em">'
        f'<svg data-testid="affinity-{name}" data-name="{name}" data-left="{left:.2f}" '
        f'data-top="1" data-side="{side:.4f}" data-rows="{num_rows}" '
        f'data-columns="{num_columns}" data-mirrored="{int(mirrored)}" '
        f'data-cells="{as_attribute(texts)}" data-asks="{int(look.asks)}" '
        f'role="{"application" if look.asks else "img"}" aria-label="scores of all pairs" '
        f'viewBox="0 0 {look.width:g} {bottom + depth:.1f}" '
        f'style="width:100%;display:block" font-size="{FONT:g}" fill="currentColor" '
        f'onmousemove="gpgradMatrix.move(this,event)" onmouseleave="gpgradMatrix.leave(this)" '
        f"{KEYS if look.asks else ''}"
        f'onclick="gpgradMatrix.click(this,event)">{_hatch(name, side)}'
        f'<rect {place} fill="url(#hatch-{name})"/>'
        f'<image href="{png_uri(cell_pixels(pairs, high, look.threshold))}" {place} '
        f'preserveAspectRatio="none" style="image-rendering:pixelated"/>'
        f"{_marks(name, pairs, left, side)}{_by_hand(pairs, look.by_hand, left, side)}"
        f"{_shown(pairs, shown, left, side)}"
        f'<rect data-spot="" visibility="hidden" width="{side:.2f}" height="{side:.2f}" '
        f'fill="none" stroke="#fff" stroke-width="1.5" pointer-events="none"/>{names}</svg>'
        f"{hover_line(point, f'matrix-said-{name}')}</div>"
        f"{page_script('matrix.js')}"
    )


def score_shares(
    scores: Float[Array, "*n"], high: float, threshold: float
) -> Float[NDArray[np.float64], "*n"]:
    """The place of scores in their colour map, which has a step at the threshold."""
    if not 0.0 < threshold < high:
        return np.clip(scores / high, 0.0, 1.0)
    below = BREAK[0] * scores / threshold
    above = BREAK[1] + (1.0 - BREAK[1]) * (scores - threshold) / (high - threshold)
    return np.clip(np.where(scores < threshold, below, above), 0.0, 1.0)


def cell_pixels(
    pairs: PairCells, high: float, threshold: float = 0.0
) -> UInt8[NDArray[np.uint8], "rows columns 4"]:
    """Colour every cell: scores in viridis, overlaps in greys from 0 (dark); others stay clear."""
    scores = np.full(pairs.overlaps.shape, np.nan)
    for at, cell in pairs.cells.items():
        scores[at] = cell.score
    scores = score_shares(scores, high, threshold)
    pixels = np.zeros((*scores.shape, 4), np.uint8)
    layers: tuple[tuple[Float[Array, "rows columns"], ColorMap], ...] = (
        (pairs.overlaps, "grey"),
        (scores, "viridis"),
    )
    for values, color_map in layers:
        finite = np.isfinite(values)
        pixels[finite, :3] = colorize(values[finite], 0.0, 1.0, color_map)
        pixels[finite, 3] = 255
    return pixels


def words_of(pairs: PairCells, row: int, column: int) -> str:
    """The content of a cell, also by its mirror; empty where nothing was compared."""
    mirrored = pairs.rows == pairs.columns
    if mirrored and (row, column) not in pairs.cells:
        row, column = column, row
    cell = pairs.cells.get((row, column))
    if cell is None:
        return ""
    overlap = float(pairs.overlaps[column, row]) if mirrored else np.nan
    shared = f" · true overlap {overlap:.2f}" if np.isfinite(overlap) else ""
    pair = f"{cut_name(cell.query, LONGEST_READ)} → {cut_name(cell.database, LONGEST_READ)}"
    if cell.num_pairs == 1:
        return f"{pair} · score {score_in_words(cell.score)} · {cell.outcome}{shared}"
    return (
        f"Best of {cell.num_pairs:,} pairs: {pair} · score {score_in_words(cell.score)}. "
        f"Worst outcome: {cell.outcome}{shared}"
    )


def _axis_names(
    rows: list[str], columns: list[str], left: float, side: float, width: float
) -> tuple[str, float]:
    """Write as many ids as fit beside and below; gives the height of those below too."""
    bottom = side * len(rows) + 1.0

    def every(needed: float) -> int:
        return int(round_step(needed / side))

    written = [
        text(left - 3, 1.0 + (k + 0.5) * side + 0.35 * FONT, rows[k], "end")
        for k in range(0, len(rows), every(FONT + 1.0))
    ]
    longest = LETTER * max(map(len, columns), default=1)
    level = longest + 5.0 <= max(4.0 * side, 30.0)
    for k in range(0, len(columns), every(longest + 5.0 if level else FONT + 1.0)):
        x = left + (k + 0.5) * side
        if level:
            x = min(max(x, 0.5 * longest), width - 0.5 * longest)
            written.append(text(x, bottom + FONT, columns[k], "middle"))
        else:
            written.append(upright_text(x + 0.35 * FONT, bottom + 3, columns[k], "end"))
    return "".join(written), FONT + 4.0 if level else longest + 6.0


def _marks(name: str, pairs: PairCells, left: float, side: float) -> str:
    """Mark the accepted and the missed pairs: a path for all marks of an outcome."""
    paths: dict[str, list[str]] = {}
    for (row, column), cell in pairs.cells.items():
        if cell.outcome in OUTCOME_COLORS:
            x, y = left + (column + 0.5) * side, 1.0 + (row + 0.5) * side
            paths.setdefault(cell.outcome, []).append(_shape(cell.outcome, x, y, 0.3 * side))
    # A dark rim, or green would be lost on the greens of the scores.
    thick = max(0.9, min(0.12 * side, 2.0), 0.05 * side)
    return "".join(
        f'<defs><path id="mark-{name}-{k}" d="{"".join(path)}"/></defs>'
        f'<g data-outcome="{outcome}" data-count="{len(path)}" fill="none">'
        f'<use href="#mark-{name}-{k}" stroke="#000" stroke-width="{1.9 * thick:.2f}"/>'
        f'<use href="#mark-{name}-{k}" stroke="{OUTCOME_COLORS[outcome]}" '
        f'stroke-width="{thick:.2f}"/></g>'
        for k, (outcome, path) in enumerate(sorted(paths.items()))
    )


def mark_svg(outcome: str) -> str:
    """Draw the mark of an outcome for a key; without one, the ground of what was not compared."""
    color, shape = OUTCOME_COLORS.get(outcome), _shape(outcome, 7, 7, 4)
    drawn = f'{_hatch("key", 12)}<rect width="14" height="14" fill="url(#hatch-key)"/>'
    if color is not None:
        drawn = '<rect width="14" height="14" fill="#31688e"/>' + "".join(
            f'<path d="{shape}" fill="none" stroke="{ink}" stroke-width="{width}"/>'
            for ink, width in (("#000", 4), (color, 2))
        )
    return f'<svg width="14" height="14" viewBox="0 0 14 14" aria-hidden="true">{drawn}</svg>'


def _hatch(name: str, side: float) -> str:
    """Define the ground of pairs that were not compared: hatched, as no score is."""
    step = max(side / 3, 2.5)
    return (
        f'<defs><pattern id="hatch-{name}" width="{step:.2f}" height="{step:.2f}" '
        f'patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
        f'<path d="M0 0V{step:.2f}" stroke="#888" stroke-opacity=".5"/></pattern></defs>'
    )


def _by_hand(pairs: PairCells, by_hand: Mapping[PairOfIds, bool], left: float, side: float) -> str:
    """Fill a corner of what a person decided: the upper left if accepted, else the lower right."""
    corner, path = 0.42 * side, ""
    for pair, accepted in by_hand.items():
        place = pairs.place(*pair)
        if place is not None:
            way = 1.0 if accepted else -1.0
            x, y = left + place[1] * side, 1.0 + place[0] * side
            x, y = (x, y) if accepted else (x + side, y + side)
            path += f"M{x:.1f} {y:.1f}h{way * corner:.1f}L{x:.1f} {y + way * corner:.1f}z"
    return (
        f'<path data-by-hand="{len(by_hand)}" d="{path}" fill="#fff" stroke="#000" '
        f'stroke-width="{0.04 * side:.2f}"/>'
        if path
        else ""
    )


def _shape(outcome: str, x: float, y: float, r: float) -> str:
    """Draw a ring for a right pair, a cross, a square or a diamond for the others."""
    r = round(r, 1)  # as it is written, or a ring would be no circle
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
    if shown is None:
        return ""
    places = (pairs.place(*shown), pairs.place(*reversed(shown)))
    place = max((at for at in places if at is not None), default=None)
    if place is None:
        return ""
    row, column = place
    return (
        f'<rect data-testid="shown-pair" data-row="{row}" data-column="{column}" '
        f'x="{left + column * side:.2f}" y="{1.0 + row * side:.2f}" width="{side:.2f}" '
        f'height="{side:.2f}" fill="none" stroke="{SHOWN_COLOR}" '
        f'stroke-width="{min(max(0.2 * side, 1.5), 3.0):.2f}"/>'
    )


def hover_line(words: str, test_id: str = "") -> str:
    """Write the line that says what the mouse is on, and else some words."""
    name = f'data-testid="{test_id}" ' if test_id else ""
    return (
        f'<div {name}data-said="{escape(words)}" style="font-size:.85em;line-height:1.35;'
        f'height:2.7em;overflow:hidden;{FAINT}">{escape(words)}</div>'
    )


def cut_name(name: str, longest: int) -> str:
    """Shorten an ID that is too long."""
    return name if len(name) <= longest else f"{name[: longest - 1]}…"


def as_attribute(value: object) -> str:
    """Write data of a picture, for an attribute."""
    return escape(json.dumps(value, ensure_ascii=False, separators=(",", ":")))


MOST_ROWS = 400
"""Of the large matrix, which can be enlarged further; more submaps are gathered in groups."""
BOARD_WIDTH = 640.0
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
    look = replace(look, width=BOARD_WIDTH, asks=True)
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
