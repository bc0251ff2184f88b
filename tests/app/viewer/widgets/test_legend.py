import numpy as np
import pytest

from app.viewer.scene.colors import lookup_table
from app.viewer.scene.layers import Scale
from app.viewer.widgets.legend import (
    NUM_BINS,
    canvas_legend,
    count_values,
    histogram_svg,
    round_ticks,
    summary,
)

SCALE = Scale("Elevation", "m", "viridis", 0.0, 1.0)
VALUES = np.array([[0.01, 0.01, 0.51], [-3.0, 7.0, np.nan]])
TRUSTED = np.array([[True, False, True], [True, False, True]])


def test_cells_count_in_the_bin_of_their_colour() -> None:
    counted = count_values((VALUES, VALUES), (TRUSTED, TRUSTED), SCALE)
    assert counted.trusted[0] == 4  # 0.01, and -3.0 with the end's colour; in both maps
    assert counted.trusted[NUM_BINS // 2] == 2
    assert counted.num_trusted == 6  # the one that is not a number is nowhere
    assert counted.masked[0] == 2
    assert counted.masked.sum() == 2
    assert counted.num_masked == 4
    assert summary(counted) == "6 cells; 40 % masked"


def test_it_agrees_with_numpy_on_many_cells() -> None:
    values = np.random.default_rng(0).uniform(0, 1, (60, 70))
    counted = count_values((values,), (np.ones(values.shape, bool),), SCALE)
    expected, _ = np.histogram(values, NUM_BINS, (0.0, 1.0))
    np.testing.assert_array_equal(counted.trusted, expected)


def test_the_picture_has_the_legends_colours_and_the_masks_threshold() -> None:
    values = VALUES.copy()
    values[0, 1] = 0.8  # is masked
    counted = count_values((values,), (TRUSTED,), SCALE)
    svg = histogram_svg(counted, SCALE, ((0.25, None), (0.5, (31, 119, 200)), (7.0, None)))
    assert svg.count('data-testid="mask-threshold"') == 2  # one lies beyond the colours
    assert "M25.00 0" in svg
    assert 'stroke="rgb(31,119,200)"' in svg
    assert "rgb(186,186,186)" in svg  # what is masked
    assert svg.count("<rect") == 3
    dark, light = lookup_table("viridis")[2], lookup_table("viridis")[130]
    assert f"rgb({dark[0]},{dark[1]},{dark[2]})" in svg
    assert f"rgb({light[0]},{light[1]},{light[2]})" in svg


def test_nothing_to_count_is_no_error() -> None:
    nothing = count_values((np.full((2, 2), np.nan),), (np.ones((2, 2), bool),), SCALE)
    assert "<rect" not in histogram_svg(nothing, SCALE)
    assert summary(nothing) == "No cell has a value."


def test_the_legend_on_the_canvas_has_round_ticks_unit_and_an_escaped_note() -> None:
    scale = Scale("Gradient", "m/m", "ember", 0.0, 0.53, tints=((0, 0, 255), (255, 128, 0)))
    html = canvas_legend(scale, "<query> turned")
    assert "Gradient [m/m]" in html
    for tick in (0, 0.1, 0.5):
        assert f"</span>{tick:g}</span>" in html
    assert "&lt;query&gt; turned" in html
    assert scale.bars.shape == (2, 256, 3)
    assert canvas_legend(None, "anything") == ""


@pytest.mark.parametrize(("low", "high"), [(0.0, 1e-9), (-1.2, 1.04), (3.0, 3.0), (-5e3, 2e4)])
def test_ticks_lie_between_the_ends(low: float, high: float) -> None:
    ticks = round_ticks(low, high)
    assert all(low - 1e-6 <= tick <= high + max(1e-6, 1e-6 * abs(high)) for tick in ticks)
    assert len(ticks) <= 8
    if high - low > 1e-6:
        assert len(ticks) >= 3
