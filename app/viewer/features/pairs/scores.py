"""All pairs by their scores: a histogram, a curve of both errors, and where verdicts are wrong.

The page itself finds the mark under the mouse: a picture carries its texts along. The threshold is
drawn by the page too: it follows the hand at once, and the server's value later. So no picture
depends on it, and none is drawn anew under the hand.
"""

from dataclasses import dataclass
from html import escape

import numpy as np
from jaxtyping import Float

from app.viewer.charts import Axis, grid_line, points_of, round_step, text, upright_text
from app.viewer.features.pairs.matrix import (
    OUTCOME_COLORS,
    WIDTH,
    as_attribute,
    hover_line,
)
from app.viewer.features.pairs.model import APART, TRUE, UNKNOWN, JudgedPairs, TruthCheck
from app.viewer.session.decisions import MISSED, NO_OVERLAP, WRONG_MOTION
from app.viewer.widgets.bridge import page_script
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.errors import score_in_words
from gpgrad_core.params import bounds_of

TRUTHS = (
    (TRUE, "the same place", "#009e73"),
    (APART, "apart", "#cc79a7"),
    (UNKNOWN, "not judged", "#8a8a8a"),
)
"""What the truth says of pairs, with its name and its colour."""
CURVE_COLOR, THRESHOLD_COLOR = "#1f77c8", "#ff00ff"
NUM_BINS = 50
BARS, BELOW, CURVE, MARKS = 64.0, 34.0, 120.0, 24.0
"""Heights of the bars above and below their line, of the curve, and of the strip of marks."""
LEAST_HIGH = 6.0
"""The axis goes as far as this score at least: twice the default threshold."""
MOST_POINTS, MOST_MARKS = 300, 200
"""Of the curve, and of the pairs on which verdict and truth disagree: what a page draws well."""
SHARES = Axis(0.0, 1.0, 30.0, WIDTH - 8.0)
"""Across the histogram and the curve."""


@dataclass(frozen=True, eq=False)
class ScoreHistogram:
    """Compared pairs by score and by what the truth says of them."""

    high: float  # the last score of the axis; higher ones count in the last bin
    counts: dict[str, NDArray[np.intp]]  # pairs in each bin, by `TRUE`, `APART` and `UNKNOWN`

    @property
    def axis(self) -> Axis:
        return Axis(0.0, self.high, SHARES.start, SHARES.end)


def count_scores(judged: JudgedPairs) -> ScoreHistogram:
    """Count the compared pairs by score."""
    high = float(np.ceil(max(1.05 * judged.top_score, LEAST_HIGH)))
    places = np.clip(judged.scores / high * NUM_BINS, 0, NUM_BINS - 1).astype(np.intp)
    truths = np.array([judged.truths.get(one.pair, UNKNOWN) for one in judged.closures], object)
    counts = {
        truth: np.bincount(places[truths == truth], minlength=NUM_BINS) for truth, *_ in TRUTHS
    }
    return ScoreHistogram(high, counts)


def scores_html(judged: JudgedPairs, histogram: ScoreHistogram) -> str:
    """Draw the histogram, above the curve if there is a truth; `threshold_html` moves the line."""
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
        f'data-curve="{top - 8:g}" data-points="{as_attribute(points)}" '
        f'role="slider" tabindex="0" aria-label="Minimum score" aria-valuemin="{bounds.low:g}" '
        f'aria-valuemax="{histogram.high:g}" aria-valuenow="0" '
        f'viewBox="0 0 {WIDTH:g} {height:g}" font-size="10" fill="currentColor" '
        f'style="width:100%;display:block;cursor:ew-resize;touch-action:none;user-select:none" '
        f'onpointerdown="gpgradScore.grab(event)" onkeydown="gpgradScore.key(event)">'
        f'{drawn}<g data-threshold="" transform="translate({left:g} 0)">'
        f'<path d="M0 10V{axis:g}" stroke="{THRESHOLD_COLOR}" stroke-width="2"/>'
        f'<path d="M-5 {axis + 1:g}h10l-5 -7z" fill="{THRESHOLD_COLOR}"/>'
        f'<text data-number="" x="5" y="9" font-weight="600"></text></g>{dot if points else ""}'
        f"</svg></div>{page_script('scores.js')}"
    )


def threshold_html(value: float) -> str:
    """Move the threshold of every page to a score, unless a hand holds it there."""
    return page_script("threshold.js", VALUE=value)


def disagreements_html(judged: JudgedPairs, histogram: ScoreHistogram) -> str:
    """Mark the wrong and the missed pairs below the axis of the scores; a click opens one."""
    if judged.check is None:
        return ""
    outcomes = judged.outcomes
    disagreements = [
        closure
        for closure in judged.ranked
        if outcomes[closure.pair] in (WRONG_MOTION, NO_OVERLAP, MISSED)
    ]
    marks: list[tuple[float, str, str, str]] = []
    drawn: list[str] = []
    for closure in disagreements[:MOST_MARKS]:
        pair, score = closure.pair, closure.registration.score
        x, outcome = histogram.axis(score), outcomes[pair]
        words = f"{' → '.join(pair)} · score {score_in_words(score)} · {outcome}"
        marks.append((round(x, 1), *pair, words))
        missed = outcome == MISSED
        shape = f"M{x:.1f} 3l6 8l-6 8l-6 -8z" if missed else f"M{x - 5:.1f} 6l10 10m0 -10l-10 10"
        color = OUTCOME_COLORS[MISSED if missed else WRONG_MOTION]
        drawn += [
            f'<path d="{shape}" fill="none" stroke="{stroke}" stroke-width="{width}"/>'
            for stroke, width in (("#000", 4), (color, 2.2))
        ]
    lead = "No pair is wrong or missed."
    if disagreements:
        num_missed = sum(outcomes[closure.pair] == MISSED for closure in disagreements)
        rest = f"; the first {MOST_MARKS}" if len(disagreements) > MOST_MARKS else ""
        lead = (
            f"{len(disagreements) - num_missed:,} wrong (✕) and {num_missed:,} missed (◇){rest}. "
            "Click one to open it."
        )
    return (
        f'<div style="padding:0 .75em"><svg data-testid="disagreements" role="img" '
        f'aria-label="{escape(lead)}" viewBox="0 0 {WIDTH:g} {MARKS:g}" '
        f'data-marks="{as_attribute(marks)}" style="width:100%;display:block" '
        f'onmousemove="gpgradScore.point(this,event)" onclick="gpgradScore.open(this,event)">'
        f'<rect width="{WIDTH:g}" height="{MARKS:g}" fill="#8882"/>{"".join(drawn)}</svg>'
        f"{hover_line(lead)}</div>"
    )


def _key(judged: JudgedPairs, histogram: ScoreHistogram) -> str:
    """What the colours of the bars mean, and by which rule."""
    lead, unknown = "", "not judged"
    if judged.check is not None:
        unknown = "left out"
        lead = f"By the rule {escape(judged.rule.name)}, whatever motion was found: "
    entries = "".join(
        f'<span style="white-space:nowrap;margin-right:.9em"><span style="color:{color}">■</span> '
        f"{unknown if truth == UNKNOWN else name} {int(histogram.counts[truth].sum()):,}</span> "
        for truth, name, color in TRUTHS
        if histogram.counts[truth].any()
    )
    return f'<div style="font-size:.85em;line-height:1.5">{lead}{entries}</div>'


def _bars(histogram: ScoreHistogram, base: float, axis: float) -> str:
    """Draw logarithmic bars, for unrelated pairs are many: those apart below the line."""
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
