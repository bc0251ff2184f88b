"""The curve of precision over recall as a picture, and the point where the thresholds stand."""

import numpy as np

from app.viewer.all_pairs.judging import TruthCheck

WIDTH, HEIGHT = 240.0, 150.0
LEFT, BOTTOM, TOP, RIGHT = 30.0, 28.0, 8.0, 8.0
CURVE_COLOR, POINT_COLOR = "#1f77c8", "#ff00ff"


def curve_svg(check: TruthCheck) -> str:
    """Draw the curve with its axes; empty if there is no pair to find."""
    if check.curve is None:
        return ""
    points = [
        _at(float(recall), float(precision))
        for recall, precision in zip(check.curve.recall, check.curve.precision, strict=True)
        if np.isfinite(precision)
    ]
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    mark = ""
    if np.isfinite(check.precision):
        x, y = _at(check.recall, check.precision)
        mark = (
            f'<circle data-testid="operating-point" cx="{x:.1f}" cy="{y:.1f}" r="5" fill="none" '
            f'stroke="{POINT_COLOR}" stroke-width="2.5"/>'
        )
    return (
        f'<svg data-testid="precision-recall" role="img" aria-label="precision over recall" '
        f'viewBox="0 0 {WIDTH:g} {HEIGHT:g}" style="width:100%;display:block;overflow:visible" '
        f'font-size="9" fill="currentColor">{_axes()}'
        f'<polyline points="{line}" fill="none" stroke="{CURVE_COLOR}" stroke-width="2" '
        f'stroke-linejoin="round"/>{mark}</svg>'
    )


def _at(recall: float, precision: float) -> tuple[float, float]:
    """Place a point of the curve on the picture."""
    return (
        LEFT + recall * (WIDTH - LEFT - RIGHT),
        HEIGHT - BOTTOM - precision * (HEIGHT - BOTTOM - TOP),
    )


def _axes() -> str:
    lines: list[str] = []
    for share in (0.0, 0.5, 1.0):
        (x0, y), (x1, _) = _at(0.0, share), _at(1.0, share)
        (x, y0), (_, y1) = _at(share, 0.0), _at(share, 1.0)
        lines += [
            f'<path d="M{x0} {y}H{x1}M{x} {y0}V{y1}" stroke="currentColor" stroke-opacity=".2"/>',
            f'<text x="{x0 - 4}" y="{y + 3}" text-anchor="end">{share:g}</text>',
            f'<text x="{x}" y="{y0 + 11}" text-anchor="middle">{share:g}</text>',
        ]
    (x, y) = _at(0.5, 0.0)
    lines.append(f'<text x="{x}" y="{y + 22}" text-anchor="middle">recall</text>')
    _, y = _at(0.0, 0.5)
    lines.append(
        f'<text transform="translate(8 {y}) rotate(-90)" text-anchor="middle">precision</text>'
    )
    return "".join(lines)
