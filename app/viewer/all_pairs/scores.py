"""The scores of all pairs as a histogram, the curve of precision over recall, and one threshold.

The threshold is drawn by the page: it follows the hand at once, and the server's value later. The
picture itself does not depend on it, so that it is not drawn anew under the hand.
"""

import json
from dataclasses import dataclass
from html import escape

import numpy as np
from jaxtyping import Float

from app.viewer.all_pairs.judging import APART, TRUE, UNKNOWN, JudgedPairs, TruthCheck
from app.viewer.all_pairs.matrix import OUTCOME_COLORS
from app.viewer.decisions import MISSED, NO_OVERLAP, WRONG_MOTION
from app.viewer.widgets.bridge import run_when_shown
from app.viewer.widgets.html import FAINT
from gpgrad_core.arrays import NDArray
from gpgrad_core.loop_closure import ClosureParams
from gpgrad_core.params.fields import bounds_of

WIDTH = 300.0
LEFT, RIGHT = 30.0, 8.0
NUM_BINS = 50
BARS, BELOW = 64.0, 34.0
"""Height of the bars above and below the line of the histogram."""
CURVE, MARKS = 120.0, 24.0
"""Height of the curve, and of the strip of marks."""
TRUE_COLOR, APART_COLOR, UNKNOWN_COLOR = "#009e73", "#cc79a7", "#8a8a8a"
CURVE_COLOR, THRESHOLD_COLOR = "#1f77c8", "#ff00ff"
LEAST_HIGH = 6.0
"""The axis goes as far as this score at least: twice the default threshold."""
MOST_POINTS = 300
MOST_MARKS = 200
"""Of the curve, and of the pairs on which verdict and truth disagree: what a page draws well."""

SCRIPT = """
const state = window.gpgradScore = window.gpgradScore ||
  {value: null, dragging: null, sent: null, until: 0};
state.say = value => {
  state.value = state.sent = value;
  state.until = Date.now() + 2000;
  state.place();
  gpgrad.say('threshold', {score: value}, true);
};
state.rest = () => {
  if (state.sent !== null) gpgrad.say('threshold', {score: state.sent, rested: true});
};
state.place = () => {
  for (const svg of document.querySelectorAll('[data-scores]')) {
    const d = svg.dataset, points = svg.points || (svg.points = JSON.parse(d.points));
    const value = state.value ?? +d.value;
    const x = +d.left + Math.min(Math.max(value / d.high, 0), 1) * d.span;
    svg.querySelector('[data-threshold]').setAttribute('transform', `translate(${x} 0)`);
    const text = svg.querySelector('[data-number]');
    text.textContent = value.toFixed(1);
    text.setAttribute('text-anchor', value > d.high / 2 ? 'end' : 'start');
    text.setAttribute('x', value > d.high / 2 ? -5 : 5);
    svg.setAttribute('aria-valuenow', value);
    const dot = svg.querySelector('[data-dot]');
    if (!dot) continue;
    let last = null;
    for (const point of points) if (point[0] >= value) last = point;
    dot.setAttribute('visibility', last ? 'visible' : 'hidden');
    if (last) { dot.setAttribute('cx', last[1]); dot.setAttribute('cy', last[2]); }
  }
};
state.settle = value => {
  state.latest = value;
  if (state.dragging) return;
  if (Date.now() < state.until && Math.abs(value - state.sent) > 1e-6) {
    setTimeout(() => state.settle(state.latest), state.until - Date.now() + 10);
    return;
  }
  state.value = value;
  state.place();
};
state.read = event => {
  const svg = document.querySelector('[data-scores]');
  if (!svg) return;
  const d = svg.dataset, points = svg.points || (svg.points = JSON.parse(d.points));
  const at = new DOMPoint(event.clientX, event.clientY)
    .matrixTransform(svg.getScreenCTM().inverse());
  let value = (at.x - d.left) / d.span * d.high;
  if (state.dragging === 'curve' && points.length)
    value = points.reduce((a, b) => Math.abs(b[1] - at.x) < Math.abs(a[1] - at.x) ? b : a)[0];
  const step = +d.step;
  value = Math.min(Math.max(Math.floor(value / step + 1e-6) * step, +d.low), +d.most);
  if (state.dragging !== 'curve') value = Math.min(value, +d.high);
  state.say(+value.toFixed(6));
};
state.grab = event => {
  const svg = event.currentTarget;
  const at = new DOMPoint(event.clientX, event.clientY)
    .matrixTransform(svg.getScreenCTM().inverse());
  state.dragging = at.y > +svg.dataset.curve ? 'curve' : 'bars';
  event.preventDefault();
  svg.focus();
  const move = one => { if (state.dragging) state.read(one); };
  const up = () => {
    state.dragging = null;
    window.removeEventListener('pointermove', move);
    window.removeEventListener('pointerup', up);
    window.removeEventListener('pointercancel', up);
    state.rest();
  };
  window.addEventListener('pointermove', move);
  window.addEventListener('pointerup', up);
  window.addEventListener('pointercancel', up);
  state.read(event);
};
state.key = event => {
  const by = {ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1}[event.key];
  if (!by) return;
  event.preventDefault();
  event.stopPropagation();
  const d = event.currentTarget.dataset, now = state.value ?? +d.value;
  state.say(+Math.min(Math.max(now + by * d.step, +d.low), +d.most).toFixed(6));
  state.rest();
};
state.mark = (svg, event) => {
  const at = new DOMPoint(event.clientX, event.clientY)
    .matrixTransform(svg.getScreenCTM().inverse());
  const marks = svg.marks || (svg.marks = JSON.parse(svg.dataset.marks));
  let best = null;
  for (const mark of marks)
    if (!best || Math.abs(mark[0] - at.x) < Math.abs(best[0] - at.x)) best = mark;
  return best && Math.abs(best[0] - at.x) < 12 ? best : null;
};
state.place();
"""


@dataclass(frozen=True, eq=False)
class ScoreHistogram:
    """Compared pairs by score and by what the truth says of them.

    Attributes:
        high: The last score of the axis; higher ones count in the last bin.
        counts: Pairs in each bin, by `TRUE`, `APART` and `UNKNOWN`.
    """

    high: float
    counts: dict[str, NDArray[np.intp]]


def count_scores(judged: JudgedPairs) -> ScoreHistogram:
    """Count the compared pairs by score."""
    scores = np.array([one.registration.score for one in judged.closures], dtype=np.float64)
    top = float(np.quantile(scores, 0.995)) if len(scores) else 0.0
    high = float(np.ceil(max(1.05 * top, LEAST_HIGH)))
    places = np.clip(scores / high * NUM_BINS, 0, NUM_BINS - 1).astype(np.intp)
    truths = np.array(judged.truths, dtype=object)
    counts = {
        truth: np.bincount(places[truths == truth], minlength=NUM_BINS)
        for truth in (TRUE, APART, UNKNOWN)
    }
    return ScoreHistogram(high, counts)


def scores_html(judged: JudgedPairs, histogram: ScoreHistogram) -> str:
    """Draw the histogram, with the curve below where the truth is known.

    It does not depend on the threshold: `threshold_html` moves that.

    Args:
        judged: All pairs.
        histogram: Their scores.
    """
    if not judged.closures:
        return ""
    bounds, span = bounds_of(ClosureParams)["min_score"], WIDTH - LEFT - RIGHT
    has_apart = bool(histogram.counts[APART].any())
    base = 12.0 + BARS
    axis = base + (BELOW if has_apart else 0.0)
    top = axis + 30.0
    check = judged.check
    curve = None if check is None else check.curve
    points = [] if check is None else _curve_points(check, top)
    height = top if curve is None else top + CURVE + 26.0
    dot = (
        f'<circle data-dot="" data-testid="operating-point" r="5" fill="none" visibility="hidden" '
        f'stroke="{THRESHOLD_COLOR}" stroke-width="2.5"/>'
        if points
        else ""
    )
    drawn = _bars(histogram, base, axis) + ("" if curve is None else _curve(points, top))
    return (
        f'<div style="padding:.2em .75em">{_key(judged, histogram)}'
        f'<svg data-scores="" data-testid="scores" data-left="{LEFT:g}" data-span="{span:g}" '
        f'data-high="{histogram.high:g}" data-step="{bounds.step:g}" data-low="{bounds.low:g}" '
        f'data-most="{bounds.high:g}" data-value="{ClosureParams().min_score:g}" '
        f'data-curve="{top - 8:g}" '
        f'data-points="{escape(json.dumps(points, separators=(",", ":")))}" '
        f'role="slider" tabindex="0" aria-label="Minimum score" aria-valuemin="{bounds.low:g}" '
        f'aria-valuemax="{histogram.high:g}" aria-valuenow="0" '
        f'viewBox="0 0 {WIDTH:g} {height:g}" font-size="10" fill="currentColor" '
        f'style="width:100%;display:block;cursor:ew-resize;touch-action:none;user-select:none" '
        f'onpointerdown="gpgradScore.grab(event)" onkeydown="gpgradScore.key(event)">'
        f'{drawn}<g data-threshold="" transform="translate({LEFT:g} 0)">'
        f'<path d="M0 10V{axis:g}" stroke="{THRESHOLD_COLOR}" stroke-width="2"/>'
        f'<path d="M-5 {axis + 1:g}h10l-5 -7z" fill="{THRESHOLD_COLOR}"/>'
        f'<text data-number="" x="5" y="9" font-weight="600"></text></g>{dot}</svg></div>'
        f"{run_when_shown('(() => {' + SCRIPT + '})()')}"
    )


def threshold_html(value: float) -> str:
    """Bring the threshold of every page to a score, unless a hand holds it there."""
    return run_when_shown(
        f"window.gpgradScore ? gpgradScore.settle({value:.9g}) : "
        f"setTimeout(() => window.gpgradScore && gpgradScore.settle({value:.9g}), 500)"
    )


def disagreements_html(judged: JudgedPairs, histogram: ScoreHistogram) -> str:
    """Mark the wrong and the missed pairs below the axis of the scores; a click opens one."""
    found = [
        (closure, outcome)
        for closure, outcome in zip(judged.closures, judged.outcomes, strict=True)
        if outcome in (WRONG_MOTION, NO_OVERLAP, MISSED)
    ]
    if judged.check is None:
        return ""
    found.sort(key=lambda one: -one[0].registration.score)
    listed = found[:MOST_MARKS]
    marks: list[tuple[float, str, str, str]] = []
    drawn: list[str] = []
    for closure, outcome in listed:
        x = LEFT + min(closure.registration.score / histogram.high, 1.0) * (WIDTH - LEFT - RIGHT)
        said = (
            f"{closure.query_id} → {closure.database_id} · score "
            f"{closure.registration.score:.1f} · {outcome}"
        )
        marks.append((round(x, 1), closure.query_id, closure.database_id, said))
        shape = (
            f"M{x:.1f} 3l6 8l-6 8l-6 -8z"
            if outcome == MISSED
            else f"M{x - 5:.1f} 6l10 10m0 -10l-10 10"
        )
        color = OUTCOME_COLORS[MISSED if outcome == MISSED else WRONG_MOTION]
        drawn.append(
            f'<path d="{shape}" fill="none" stroke="#000" stroke-width="4"/>'
            f'<path d="{shape}" fill="none" stroke="{color}" stroke-width="2.2"/>'
        )
    rest = f"; the first {MOST_MARKS}" if len(found) > MOST_MARKS else ""
    wrong = sum(outcome != MISSED for _, outcome in found)
    lead = (
        f"{wrong:,} wrong (✕) and {len(found) - wrong:,} missed (◇){rest}. Click one to open it."
        if found
        else "No pair is wrong or missed."
    )
    move = (
        "const m=gpgradScore.mark(this,event);this.style.cursor=m?'pointer':'default';"
        "const s=this.nextElementSibling;s.textContent=m?m[3]:s.dataset.said"
    )
    click = (
        "const m=gpgradScore.mark(this,event);if(m)gpgrad.say('pair',{query:m[1],database:m[2]})"
    )
    return (
        f'<div style="padding:0 .75em"><svg data-testid="disagreements" role="img" '
        f'aria-label="{escape(lead)}" viewBox="0 0 {WIDTH:g} {MARKS:g}" '
        f'data-marks="{escape(json.dumps(marks, ensure_ascii=False))}" '
        f'style="width:100%;display:block" onmousemove="{escape(move)}" onclick="{escape(click)}">'
        f'<rect width="{WIDTH:g}" height="{MARKS:g}" fill="#8882"/>{"".join(drawn)}</svg>'
        f'<div data-said="{escape(lead)}" style="font-size:.85em;line-height:1.35;height:2.7em;'
        f'overflow:hidden;{FAINT}">{escape(lead)}</div></div>'
    )


def _key(judged: JudgedPairs, histogram: ScoreHistogram) -> str:
    """Say what the colours of the bars mean, and by which rule."""
    names = {TRUE: "the same place", APART: "apart", UNKNOWN: "not judged"}
    lead = ""
    if judged.check is not None:
        names[UNKNOWN] = "left out"
        lead = f"By the rule {escape(judged.check.rule.name)}, whatever motion was found: "
    colors = {TRUE: TRUE_COLOR, APART: APART_COLOR, UNKNOWN: UNKNOWN_COLOR}
    square = '<span style="color:{}">■</span> {} {:,}'
    entries = "".join(
        f'<span style="white-space:nowrap;margin-right:.9em">'
        f"{square.format(colors[truth], names[truth], int(counts.sum()))}</span> "
        for truth, counts in histogram.counts.items()
        if counts.any()
    )
    return f'<div style="font-size:.85em;line-height:1.5">{lead}{entries}</div>'


def _bars(histogram: ScoreHistogram, base: float, axis: float) -> str:
    """Draw the bars: pairs that are apart below the line, all others above it.

    Their heights are logarithmic, because unrelated pairs are many times more.
    """
    tallest = np.log1p(max(1, *(int(counts.max()) for counts in histogram.counts.values())))
    width = (WIDTH - LEFT - RIGHT) / NUM_BINS
    drawn: list[str] = []
    for truth, color in ((TRUE, TRUE_COLOR), (UNKNOWN, UNKNOWN_COLOR), (APART, APART_COLOR)):
        room = BELOW if truth == APART else BARS
        path = "".join(
            f"M{LEFT + k * width:.1f} {base:g}v{sign * room * np.log1p(count) / tallest:.1f}"
            f"h{width - 0.5:.1f}V{base:g}z"
            for k, count in enumerate(histogram.counts[truth])
            if count
            for sign in (1 if truth == APART else -1,)
        )
        opacity = 0.6 if truth == UNKNOWN else 1.0
        drawn.append(f'<path d="{path}" fill="{color}" fill-opacity="{opacity}"/>')
    for score in _ticks(histogram.high):
        x = LEFT + score / histogram.high * (WIDTH - LEFT - RIGHT)
        drawn.append(f'<text x="{x:.1f}" y="{axis + 13:g}" text-anchor="middle">{score:g}</text>')
    return (
        f'{"".join(drawn)}<path d="M{LEFT:g} {base:g}H{WIDTH - RIGHT:g}" stroke="currentColor" '
        f'stroke-opacity=".5"/><text x="0" y="{base - 4:g}">score'
        "</text>"
    )


def _ticks(high: float) -> list[float]:
    """Choose round scores for the axis.

    >>> _ticks(14.0)
    [0, 2, 4, 6, 8, 10, 12, 14]
    """
    steps = (scale * step for scale in (1, 10, 100, 1000, 10_000, 100_000) for step in (1, 2, 5))
    step = next((step for step in steps if high / step <= 8), 1_000_000)
    return [step * k for k in range(int(high / step) + 1)]


def _curve_points(check: TruthCheck, top: float) -> list[tuple[float, float, float]]:
    """Place the curve's points: score, x and y; the highest scores come first."""
    if check.curve is None:
        return []
    known = np.isfinite(check.curve.precision)
    points: Float[NDArray[np.float64], "n 3"] = np.column_stack(
        [
            check.curve.thresholds[known],
            LEFT + check.curve.recall[known] * (WIDTH - LEFT - RIGHT),
            top + (1.0 - check.curve.precision[known]) * CURVE,
        ]
    )
    if len(points) > MOST_POINTS:
        points = points[np.linspace(0, len(points) - 1, MOST_POINTS).round().astype(np.intp)]
    return [(round(a, 3), round(x, 1), round(y, 1)) for a, x, y in points.tolist()]


def _curve(points: list[tuple[float, float, float]], top: float) -> str:
    """Draw the curve of precision over recall with its axes."""
    lines: list[str] = []
    for share in (0.0, 0.5, 1.0):
        y, x = top + (1.0 - share) * CURVE, LEFT + share * (WIDTH - LEFT - RIGHT)
        lines += [
            f'<path d="M{LEFT:g} {y:g}H{WIDTH - RIGHT:g}M{x:g} {top:g}V{top + CURVE:g}" '
            f'stroke="currentColor" stroke-opacity=".2"/>',
            f'<text x="{LEFT - 4:g}" y="{y + 3:g}" text-anchor="end">{share:g}</text>',
            f'<text x="{x:g}" y="{top + CURVE + 12:g}" text-anchor="middle">{share:g}</text>',
        ]
    middle = LEFT + 0.5 * (WIDTH - LEFT - RIGHT)
    line = " ".join(f"{x:g},{y:g}" for _, x, y in points)
    return (
        f'{"".join(lines)}<text x="{middle:g}" y="{top + CURVE + 23:g}" text-anchor="middle">recall'
        f'</text><text transform="translate(9 {top + 0.5 * CURVE:g}) rotate(-90)" '
        f'text-anchor="middle">precision</text><polyline data-testid="precision-recall" '
        f'points="{line}" fill="none" stroke="{CURVE_COLOR}" stroke-width="2" '
        f'stroke-linejoin="round"/>'
    )
