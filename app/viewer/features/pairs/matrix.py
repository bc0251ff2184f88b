"""All pairs as a matrix of scores and true overlaps; the page itself finds what the mouse is on."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from jaxtyping import Float, UInt8

from app.viewer.charts import png_uri, round_step, text, upright_text
from app.viewer.features.pairs.model import JudgedPairs
from app.viewer.scene.colors import colorize
from app.viewer.session.decisions import (
    ACCEPTED,
    MISSED,
    NO_OVERLAP,
    REFUSED,
    RIGHT,
    WRONG_MOTION,
)
from app.viewer.session.state import ColorMap
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import inline_script
from app.viewer.widgets.html import FAINT
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import score_in_words
from gpgrad_core.types import LoopClosure

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
    # highest true overlap of pairs, mirrored to `cells`; NaN where it is not known
    overlaps: Float[Array, "rows columns"]

    @property
    def has_blocks(self) -> bool:
        """Whether a cell stands for several pairs."""
        return any(len(group) > 1 for group in (*self.rows, *self.columns))

    def place(self, query: str, database: str) -> tuple[int, int] | None:
        """Find the cell of a pair (row, column); None if it is not in this matrix."""
        row = next((k for k, group in enumerate(self.rows) if query in group), None)
        column = next((k for k, group in enumerate(self.columns) if database in group), None)
        return None if row is None or column is None else (row, column)


def gather_all(judged: JudgedPairs) -> PairCells:
    """Put all pairs of a dataset into at most `MOST_GROUPS` rows and columns."""
    ids = [submap.id for submap in judged.run.dataset.submaps]
    size = max(1, -(-len(ids) // MOST_GROUPS))
    groups = tuple(tuple(ids[k : k + size]) for k in range(0, len(ids), size))
    return gather(judged, groups, groups)


def gather_block(judged: JudgedPairs, whole: PairCells, pair: tuple[str, str]) -> PairCells | None:
    """Show the pairs one by one of the block that has a pair, the later submap first.

    None where every cell of the whole is a single pair, or where the pair is of another dataset.
    """
    place = whole.place(*pair)
    if place is None or not whole.has_blocks:
        return None
    rows, columns = whole.rows[place[0]], whole.columns[place[1]]
    return gather(judged, tuple((name,) for name in rows), tuple((name,) for name in columns))


def gather(
    judged: JudgedPairs, rows: Sequence[tuple[str, ...]], columns: Sequence[tuple[str, ...]]
) -> PairCells:
    """Put the pairs of some submaps into cells."""
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
    name: str, pairs: PairCells, high: float, shown: tuple[str, str] | None = None
) -> str:
    """Draw a matrix, with a row per query and a column per database submap.

    Scores lie below the diagonal, true overlaps above, and verdicts are marks; the pair shown is
    pointed at. The score ``high`` has the last colour, and a click tells the name, the row and the
    column. A line says what the mouse is on; ids in it are escaped. The size does not grow with
    the number of submaps.
    """
    num_rows, num_columns = len(pairs.rows), len(pairs.columns)
    row_names = [_cut(group[0], LONGEST_NAME) for group in pairs.rows]
    column_names = [_cut(group[0], LONGEST_NAME) for group in pairs.columns]
    left = 5.0 + LETTER * max(map(len, row_names), default=1)
    side = (WIDTH - left - 1.0) / max(num_rows, num_columns)
    bottom = side * num_rows + 1.0
    names, depth = _axis_names(row_names, column_names, left, side, bottom)
    place = f'x="{left:.2f}" y="1" width="{side * num_columns:.2f}" height="{side * num_rows:.2f}"'
    mirrored = pairs.rows == pairs.columns  # above the diagonal stands what its mirror says
    texts = {
        f"{row},{column}": _words(cell, float(pairs.overlaps[column, row]) if mirrored else np.nan)
        for (row, column), cell in pairs.cells.items()
    }
    point = "Point at a cell to read it, and click to open the pair."
    return (
        f'<div style="padding:.2em .75em">'
        f'<svg data-testid="affinity-{name}" data-name="{name}" data-left="{left:.2f}" '
        f'data-top="1" data-side="{side:.4f}" data-rows="{num_rows}" '
        f'data-columns="{num_columns}" data-mirrored="{int(mirrored)}" '
        f'data-cells="{as_attribute(texts)}" '
        f'role="img" aria-label="scores of all pairs" viewBox="0 0 {WIDTH:g} {bottom + depth:.1f}" '
        f'style="width:100%;display:block" font-size="{FONT:g}" fill="currentColor" '
        f'onmousemove="gpgradMatrix.move(this,event)" onmouseleave="gpgradMatrix.leave(this)" '
        f'onclick="gpgradMatrix.click(this,event)"><rect {place} fill="#8884"/>'
        f'<image href="{png_uri(cell_pixels(pairs, high))}" {place} preserveAspectRatio="none" '
        f'style="image-rendering:pixelated"/>'
        f"{_marks(name, pairs, left, side)}{_shown(pairs, shown, left, side)}"
        f'<rect data-spot="" visibility="hidden" width="{side:.2f}" height="{side:.2f}" '
        f'fill="none" stroke="#fff" stroke-width="1.5" pointer-events="none"/>{names}</svg>'
        f"{hover_line(point, f'matrix-said-{name}')}</div>"
        f"{inline_script(fill_page_file('matrix.js'))}"
    )


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
        finite = np.isfinite(values)
        pixels[finite, :3] = colorize(values[finite], 0.0, highest, color_map)
        pixels[finite, 3] = 255
    return pixels


def _words(cell: Cell, overlap: float) -> str:
    shared = f" · true overlap {overlap:.2f}" if np.isfinite(overlap) else ""
    pair = f"{_cut(cell.query, LONGEST_READ)} → {_cut(cell.database, LONGEST_READ)}"
    if cell.num_pairs == 1:
        return f"{pair} · score {score_in_words(cell.score)} · {cell.outcome}{shared}"
    return (
        f"Best of {cell.num_pairs:,} pairs: {pair} · score {score_in_words(cell.score)}. "
        f"Worst outcome: {cell.outcome}{shared}"
    )


def _axis_names(
    rows: list[str], columns: list[str], left: float, side: float, bottom: float
) -> tuple[str, float]:
    """Write as many ids as fit beside and below; gives the height of those below too."""

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
            x = min(max(x, 0.5 * longest), WIDTH - 0.5 * longest)
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


def _cut(name: str, longest: int) -> str:
    return name if len(name) <= longest else f"{name[: longest - 1]}…"


def as_attribute(value: object) -> str:
    """Write data of a picture, for an attribute."""
    return escape(json.dumps(value, ensure_ascii=False, separators=(",", ":")))
