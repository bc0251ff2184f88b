import numpy as np
import pytest

from app.viewer.scene.layers import STYLES, layer_values, shared_scale
from app.viewer.session.state import LAYERS
from tests.support.synthetic import make_dataset, make_map

MAPS = tuple(make_map(submap) for submap in make_dataset().submaps[:2])


@pytest.mark.parametrize("layer", LAYERS)
def test_every_layer_has_values_a_name_and_a_unit(layer: str) -> None:
    assert layer_values(MAPS[0], layer).shape == MAPS[0].grid.shape
    assert STYLES[layer].label
    assert STYLES[layer].unit


def test_slopes_are_shown_symmetrically_and_steepness_from_zero() -> None:
    slopes = shared_scale(MAPS, "slope_x", "automatic", 1.0, (0.0, 0.0))
    assert slopes.low == -slopes.high
    assert slopes.color_map == "blue-white-red"
    assert shared_scale(MAPS, "gradient", "automatic", 1.0, (0.0, 0.0)).low == 0.0


def test_the_users_colour_map_is_taken() -> None:
    assert shared_scale(MAPS, "std", "turbo", 1.0, (0.0, 0.0)).color_map == "turbo"


def test_only_trusted_cells_make_the_range() -> None:
    everything = shared_scale(MAPS, "std", "automatic", 1.0, (0.0, 0.0))
    trusted = shared_scale(MAPS, "std", "automatic", 0.2, (0.0, 0.0))
    assert trusted.high < everything.high
    assert trusted.high <= 0.2 * MAPS[0].signal_std


def test_with_nothing_trusted_there_is_still_a_range() -> None:
    scale = shared_scale(MAPS, "elevation", "automatic", 0.0, (0.0, 0.0))
    assert np.isfinite([scale.low, scale.high]).all()
    assert scale.low < scale.high


def test_an_offset_moves_the_range() -> None:
    plain = shared_scale(MAPS[:1], "elevation", "automatic", 1.0, (0.0,))
    lifted = shared_scale(MAPS[:1], "elevation", "automatic", 1.0, (5.0,))
    assert lifted.low == pytest.approx(plain.low + 5.0)
