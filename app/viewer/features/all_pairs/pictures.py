"""All pairs as pictures: a matrix of scores and overlaps, a histogram, and a curve of both errors.

The page itself finds the cell or the mark under the mouse: a picture carries its texts along. The
threshold is drawn by the page too: it follows the hand at once, and the server's value later. So
no picture depends on it, and none is drawn anew under the hand.
"""

import json
from dataclasses import dataclass
from html import escape

import numpy as np
from jaxtyping import Float, UInt8

from app.viewer.charts import Axis, grid_line, png_uri, points_of, round_step, text, upright_text
from app.viewer.features.all_pairs.judging import (
    APART,
    TRUE,
    UNKNOWN,
    Cell,
    JudgedPairs,
    PairCells,
    TruthCheck,
)
from app.viewer.scene.colors import colorize
from app.viewer.session.decisions import ACCEPTED, MISSED, NO_OVERLAP, RIGHT, WRONG_MOTION
from app.viewer.session.state import ColorMap
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import inline_script
from app.viewer.widgets.html import FAINT
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.errors import score_in_words
from gpgrad_core.params import bounds_of

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
TRUTHS = (
    (TRUE, "the same place", "#009e73"),
    (APART, "apart", "#cc79a7"),
    (UNKNOWN, "not judged", "#8a8a8a"),
)
"""What the truth says of pairs, with its name and its colour."""
CURVE_COLOR, THRESHOLD_COLOR = "#1f77c8", "#ff00ff"
TOP_SHARE = 0.995
"""Scores above those of this share of the pairs have the last colour: a few are far above."""
FONT, LETTER = 10.0, 5.9
"""Height and width of a letter."""
LONGEST_NAME, LONGEST_READ = 10, 40
"""Letters of an id beside the matrix, and where the mouse is; the rest is left out."""
NUM_BINS = 50
BARS, BELOW, CURVE, MARKS = 64.0, 34.0, 120.0, 24.0
"""Heights of the bars above and below their line, of the curve, and of the strip of marks."""
LEAST_HIGH = 6.0
"""The axis goes as far as this score at least: twice the default threshold."""
MOST_POINTS, MOST_MARKS = 300, 200
"""Of the curve, and of the pairs on which verdict and truth disagree: what a page draws well."""
SHARES = Axis(0.0, 1.0, 30.0, WIDTH - 8.0)
"""Across the histogram and the curve."""


# The matrix.


def matrix_html(
    name: str, pairs: PairCells, high: float, shown: tuple[str, str] | None = None
) -> str:
    """Draw a matrix, with a row per query and a column per database submap.

    Scores lie below the diagonal, true overlaps above, and verdicts are marks.

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
    row_names = [_cut(group[0], LONGEST_NAME) for group in pairs.rows]
    column_names = [_cut(group[0], LONGEST_NAME) for group in pairs.columns]
    left = 5.0 + LETTER * max(map(len, row_names), default=1)
    side = (WIDTH - left - 1.0) / max(num_rows, num_columns)
    bottom = side * num_rows + 1.0
    names, depth = _axis_names(row_names, column_names, left, side, bottom)
    place = f'x="{left:.2f}" y="1" width="{side * num_columns:.2f}" height="{side * num_rows:.2f}"'
    texts = {f"{row},{column}": words for (row, column), words in _texts(pairs).items()}
    point = "Point at a cell to read it, and click to open the pair."
    return (
        f'<div style="padding:.2em .75em">'
        f'<svg data-testid="affinity-{name}" data-name="{name}" data-left="{left:.2f}" '
        f'data-top="1" data-side="{side:.4f}" data-rows="{num_rows}" '
        f'data-columns="{num_columns}" data-mirrored="{int(pairs.rows == pairs.columns)}" '
        f'data-cells="{_json(texts)}" '
        f'role="img" aria-label="scores of all pairs" viewBox="0 0 {WIDTH:g} {bottom + depth:.1f}" '
        f'style="width:100%;display:block" font-size="{FONT:g}" fill="currentColor" '
        f'onmousemove="gpgradMatrix.move(this,event)" onmouseleave="gpgradMatrix.leave(this)" '
        f'onclick="gpgradMatrix.click(this,event)"><rect {place} fill="#8884"/>'
        f'<image href="{png_uri(cell_pixels(pairs, high))}" {place} preserveAspectRatio="none" '
        f'style="image-rendering:pixelated"/>'
        f"{_marks(name, pairs, left, side)}{_shown(pairs, shown, left, side)}"
        f'<rect data-spot="" visibility="hidden" width="{side:.2f}" height="{side:.2f}" '
        f'fill="none" stroke="#fff" stroke-width="1.5" pointer-events="none"/>{names}</svg>'
        f"{_said(point, f'matrix-said-{name}')}</div>"
        f"{inline_script(fill_page_file('matrix.js'))}"
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
        finite = np.isfinite(values)
        pixels[finite, :3] = colorize(values[finite], 0.0, highest, color_map)
        pixels[finite, 3] = 255
    return pixels


def _texts(pairs: PairCells) -> dict[tuple[int, int], str]:
    """Say what each cell holds; what lies above the diagonal says the same as its mirror."""
    mirrored = pairs.rows == pairs.columns
    return {
        (row, column): _words(cell, float(pairs.overlaps[column, row]) if mirrored else np.nan)
        for (row, column), cell in pairs.cells.items()
    }


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


# The scores.


@dataclass(frozen=True, eq=False)
class ScoreHistogram:
    """Compared pairs by score and by what the truth says of them.

    Attributes:
        high: The last score of the axis; higher ones count in the last bin.
        counts: Pairs in each bin, by `TRUE`, `APART` and `UNKNOWN`.
    """

    high: float
    counts: dict[str, NDArray[np.intp]]

    @property
    def axis(self) -> Axis:
        """Of the scores."""
        return Axis(0.0, self.high, SHARES.start, SHARES.end)


def count_scores(judged: JudgedPairs) -> ScoreHistogram:
    """Count the compared pairs by score."""
    scores = np.array([closure.registration.score for closure in judged.closures], np.float64)
    top = float(np.quantile(scores, TOP_SHARE)) if len(scores) else 0.0
    high = float(np.ceil(max(1.05 * top, LEAST_HIGH)))
    places = np.clip(scores / high * NUM_BINS, 0, NUM_BINS - 1).astype(np.intp)
    truths = np.array(judged.truths, dtype=object)
    counts = {
        truth: np.bincount(places[truths == truth], minlength=NUM_BINS) for truth, *_ in TRUTHS
    }
    return ScoreHistogram(high, counts)


def scores_html(judged: JudgedPairs, histogram: ScoreHistogram) -> str:
    """Draw the histogram, with the curve below where the truth is known.

    It does not depend on the threshold: `threshold_html` moves that.
    """
    if not judged.closures:
        return ""
    bounds, left = bounds_of(ClosureParams)["min_score"], SHARES.start
    base = 12.0 + BARS
    axis = base + (BELOW if histogram.counts[APART].any() else 0.0)
    top = axis + 30.0
    check = judged.check
    has_curve = check is not None and check.curve is not None
    points = [] if check is None else _curve_points(check, top)
    height = top + CURVE + 26.0 if has_curve else top
    dot = (
        f'<circle data-dot="" data-testid="operating-point" r="5" fill="none" visibility="hidden" '
        f'stroke="{THRESHOLD_COLOR}" stroke-width="2.5"/>'
    )
    drawn = _bars(histogram, base, axis) + (_curve(points, top) if has_curve else "")
    return (
        f'<div style="padding:.2em .75em">{_key(judged, histogram)}'
        f'<svg data-scores="" data-testid="scores" data-left="{left:g}" '
        f'data-span="{SHARES.end - left:g}" '
        f'data-high="{histogram.high:g}" data-step="{bounds.step:g}" data-low="{bounds.low:g}" '
        f'data-most="{bounds.high:g}" data-value="{ClosureParams().min_score:g}" '
        f'data-curve="{top - 8:g}" data-points="{_json(points)}" '
        f'role="slider" tabindex="0" aria-label="Minimum score" aria-valuemin="{bounds.low:g}" '
        f'aria-valuemax="{histogram.high:g}" aria-valuenow="0" '
        f'viewBox="0 0 {WIDTH:g} {height:g}" font-size="10" fill="currentColor" '
        f'style="width:100%;display:block;cursor:ew-resize;touch-action:none;user-select:none" '
        f'onpointerdown="gpgradScore.grab(event)" onkeydown="gpgradScore.key(event)">'
        f'{drawn}<g data-threshold="" transform="translate({left:g} 0)">'
        f'<path d="M0 10V{axis:g}" stroke="{THRESHOLD_COLOR}" stroke-width="2"/>'
        f'<path d="M-5 {axis + 1:g}h10l-5 -7z" fill="{THRESHOLD_COLOR}"/>'
        f'<text data-number="" x="5" y="9" font-weight="600"></text></g>{dot if points else ""}'
        f"</svg></div>{inline_script(fill_page_file('scores.js'))}"
    )


def threshold_html(value: float) -> str:
    """Bring the threshold of every page to a score, unless a hand holds it there."""
    return inline_script(fill_page_file("threshold.js", VALUE=value))


def disagreements_html(judged: JudgedPairs, histogram: ScoreHistogram) -> str:
    """Mark the wrong and the missed pairs below the axis of the scores; a click opens one."""
    if judged.check is None:
        return ""
    disagreements = sorted(
        (
            (closure, outcome)
            for closure, outcome in zip(judged.closures, judged.outcomes, strict=True)
            if outcome in (WRONG_MOTION, NO_OVERLAP, MISSED)
        ),
        key=lambda judged_pair: -judged_pair[0].registration.score,
    )
    marks: list[tuple[float, str, str, str]] = []
    drawn: list[str] = []
    for closure, outcome in disagreements[:MOST_MARKS]:
        score, x = closure.registration.score, histogram.axis(closure.registration.score)
        pair = closure.pair
        marks.append(
            (round(x, 1), *pair, f"{' → '.join(pair)} · score {score_in_words(score)} · {outcome}")
        )
        missed = outcome == MISSED
        shape = f"M{x:.1f} 3l6 8l-6 8l-6 -8z" if missed else f"M{x - 5:.1f} 6l10 10m0 -10l-10 10"
        color = OUTCOME_COLORS[MISSED if missed else WRONG_MOTION]
        drawn.append(
            f'<path d="{shape}" fill="none" stroke="#000" stroke-width="4"/>'
            f'<path d="{shape}" fill="none" stroke="{color}" stroke-width="2.2"/>'
        )
    lead = "No pair is wrong or missed."
    if disagreements:
        num_missed = sum(outcome == MISSED for _, outcome in disagreements)
        rest = f"; the first {MOST_MARKS}" if len(disagreements) > MOST_MARKS else ""
        lead = (
            f"{len(disagreements) - num_missed:,} wrong (✕) and {num_missed:,} missed (◇){rest}. "
            "Click one to open it."
        )
    return (
        f'<div style="padding:0 .75em"><svg data-testid="disagreements" role="img" '
        f'aria-label="{escape(lead)}" viewBox="0 0 {WIDTH:g} {MARKS:g}" '
        f'data-marks="{_json(marks)}" style="width:100%;display:block" '
        f'onmousemove="gpgradScore.point(this,event)" onclick="gpgradScore.open(this,event)">'
        f'<rect width="{WIDTH:g}" height="{MARKS:g}" fill="#8882"/>{"".join(drawn)}</svg>'
        f"{_said(lead)}</div>"
    )


def _key(judged: JudgedPairs, histogram: ScoreHistogram) -> str:
    """Say what the colours of the bars mean, and by which rule."""
    lead, unknown = "", "not judged"
    if judged.check is not None:
        unknown = "left out"
        lead = f"By the rule {escape(judged.check.rule.name)}, whatever motion was found: "
    entries = "".join(
        f'<span style="white-space:nowrap;margin-right:.9em"><span style="color:{color}">■</span> '
        f"{unknown if truth == UNKNOWN else name} {int(histogram.counts[truth].sum()):,}</span> "
        for truth, name, color in TRUTHS
        if histogram.counts[truth].any()
    )
    return f'<div style="font-size:.85em;line-height:1.5">{lead}{entries}</div>'


def _bars(histogram: ScoreHistogram, base: float, axis: float) -> str:
    """Draw the bars: pairs that are apart below the line, all others above it.

    Their heights are logarithmic, because unrelated pairs are many times more.
    """
    tallest = np.log1p(max(1, *(int(counts.max()) for counts in histogram.counts.values())))
    width = (SHARES.end - SHARES.start) / NUM_BINS
    drawn: list[str] = []
    for truth, _, color in sorted(TRUTHS, key=lambda row: row[0] == APART):
        room = BELOW if truth == APART else -BARS
        path = "".join(
            f"M{SHARES.start + k * width:.1f} {base:g}v{room * np.log1p(count) / tallest:.1f}"
            f"h{width - 0.5:.1f}V{base:g}z"
            for k, count in enumerate(histogram.counts[truth])
            if count
        )
        opacity = 0.6 if truth == UNKNOWN else 1.0
        drawn.append(f'<path d="{path}" fill="{color}" fill-opacity="{opacity}"/>')
    step = int(round_step(histogram.high / 8))
    drawn += [
        text(histogram.axis(score), axis + 13, f"{score:g}", "middle")
        for score in range(0, int(histogram.high) + 1, step)
    ]
    line = grid_line(f"M{SHARES.start:g} {base:g}H{SHARES.end:g}")
    return "".join(drawn) + line + text(0, base - 4, "score")


def _curve_points(check: TruthCheck, top: float) -> list[tuple[float, float, float]]:
    """Place the curve's points: score, x and y; the highest scores come first."""
    if check.curve is None:
        return []
    finite = np.isfinite(check.curve.precision)
    points: Float[NDArray[np.float64], "n 3"] = np.column_stack(
        [
            check.curve.thresholds[finite],
            SHARES.places(check.curve.recall[finite]),
            top + (1.0 - check.curve.precision[finite]) * CURVE,
        ]
    )
    if len(points) > MOST_POINTS:
        points = points[np.linspace(0, len(points) - 1, MOST_POINTS).round().astype(np.intp)]
    return [(round(a, 3), round(x, 1), round(y, 1)) for a, x, y in points.tolist()]


def _curve(points: list[tuple[float, float, float]], top: float) -> str:
    """Draw the curve of precision over recall with its axes."""
    foot = top + CURVE
    drawn: list[str] = []
    for share in (0.0, 0.5, 1.0):
        x, y = SHARES(share), top + (1.0 - share) * CURVE
        drawn += [
            grid_line(f"M{SHARES.start:g} {y:g}H{SHARES.end:g}M{x:g} {top:g}V{foot:g}", 0.2),
            text(SHARES.start - 4, y + 3, f"{share:g}", "end"),
            text(x, foot + 12, f"{share:g}", "middle"),
        ]
    line = points_of((x, y) for _, x, y in points)
    return (
        f"{''.join(drawn)}{text(SHARES(0.5), foot + 23, 'recall', 'middle')}"
        f"{upright_text(9, top + 0.5 * CURVE, 'precision')}"
        f'<polyline data-testid="precision-recall" points="{line}" fill="none" '
        f'stroke="{CURVE_COLOR}" stroke-width="2" stroke-linejoin="round"/>'
    )


def _said(words: str, test_id: str = "") -> str:
    """Write the line that says what the mouse is on, and else some words."""
    name = f'data-testid="{test_id}" ' if test_id else ""
    return (
        f'<div {name}data-said="{escape(words)}" style="font-size:.85em;line-height:1.35;'
        f'height:2.7em;overflow:hidden;{FAINT}">{escape(words)}</div>'
    )


def _cut(name: str, longest: int) -> str:
    return name if len(name) <= longest else f"{name[: longest - 1]}…"


def _json(value: object) -> str:
    """Write data of a picture, for an attribute."""
    return escape(json.dumps(value, ensure_ascii=False, separators=(",", ":")))
