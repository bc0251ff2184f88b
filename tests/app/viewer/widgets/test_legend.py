import numpy as np
import pytest

from app.viewer.charts import round_marks
from app.viewer.scene.colors import lookup_table
from app.viewer.scene.layers import NUM_BINS, Histogram, Scale
from app.viewer.widgets.legend import (
    canvas_legend,
    histogram_svg,
    summary,
)

SCALE = Scale("Elevation", "m", "viridis", 0.0, 1.0)


def test_the_picture_has_the_legends_colours_and_the_masks_threshold() -> None:
    trusted, masked = np.zeros((2, NUM_BINS))
    trusted[[0, 25]], masked[40] = 1.0, 2.0
    counted = Histogram(trusted, masked, num_masked=2)
    assert summary(counted) == "2 cells; 50 % masked"
    svg = histogram_svg(counted, SCALE, ((0.25, None), (0.5, (31, 119, 200)), (7.0, None)))
    assert svg.count('data-testid="mask-threshold"') == 2  # one lies beyond the colours
    assert "M25.00 0" in svg
    assert 'stroke="rgb(31,119,200)"' in svg
    assert "rgb(186,186,186)" in svg  # what is masked
    assert svg.count("<rect") == 4  # three bars, and the band of what is picked
    dark, light = lookup_table("viridis")[[2, 130]]
    assert f"rgb({dark[0]},{dark[1]},{dark[2]})" in svg
    assert f"rgb({light[0]},{light[1]},{light[2]})" in svg


def test_nothing_to_count_is_no_error() -> None:
    nothing = Histogram(np.zeros(NUM_BINS), np.zeros(NUM_BINS), 0)
    assert histogram_svg(nothing, SCALE).count("<rect") == 1  # no bars
    assert summary(nothing) == "No cell has a value."


def test_the_legend_on_the_canvas_has_round_marks_unit_and_an_escaped_note() -> None:
    scale = Scale("Gradient", "m/m", "ember", 0.0, 0.53, tints=((0, 0, 255), (255, 128, 0)))
    html = canvas_legend(scale, "<query> turned")
    assert "Gradient [m/m]" in html
    for tick in (0, 0.1, 0.5):
        assert f"</span>{tick:g}</span>" in html
    assert "&lt;query&gt; turned" in html
    assert scale.bars.shape == (2, 256, 3)
    assert canvas_legend(None, "anything") == ""


@pytest.mark.parametrize(
    ("low", "high"), [(0.0, 1e-9), (0.0, 0.3), (-1.2, 1.04), (3.0, 3.0), (-5e3, 2e4)]
)
def test_ticks_lie_between_the_ends(low: float, high: float) -> None:
    ticks = round_marks(low, high)
    assert all(low - 1e-6 <= tick <= high + max(1e-6, 1e-6 * abs(high)) for tick in ticks)
    assert len(ticks) <= 8
    if high - low > 1e-6:
        assert len(ticks) >= 3
