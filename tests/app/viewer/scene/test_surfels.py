import numpy as np
import pytest

from app.viewer.scene.colors import UNTRUSTED_GREY
from app.viewer.scene.layers import shared_scale
from app.viewer.scene.surfels import Surfels, make_surfels, stride_for
from tests.support.synthetic import make_dataset, make_map

MAP = make_map(make_dataset().submaps[0])
RATIO = 0.3


def surfels(**changes: object) -> Surfels:
    scale = shared_scale((MAP,), "elevation", "automatic", RATIO, (0.0,))
    settings = {"layer": "elevation", "max_std_ratio": RATIO} | changes
    return make_surfels(MAP, scale, **settings)


def test_masked_cells_are_hidden_greyed_or_shown() -> None:
    trusted = MAP.trusted(RATIO).ravel()
    hidden = surfels(untrusted="hidden")
    grey = surfels(untrusted="grey", hillshaded=False)
    shown = surfels(untrusted="shown", hillshaded=False)
    assert 0 < trusted.sum() < trusted.size
    assert len(hidden.positions) == trusted.sum()
    assert len(grey.positions) == len(shown.positions) == trusted.size
    assert (grey.colors[~trusted] == UNTRUSTED_GREY).all()
    np.testing.assert_array_equal(grey.colors[trusted], shown.colors[trusted])


def test_a_surfel_stands_on_its_cell() -> None:
    everything = surfels(untrusted="shown")
    np.testing.assert_allclose(everything.positions[:, :2], MAP.grid.positions, atol=1e-5)
    np.testing.assert_allclose(everything.positions[:, 2], MAP.elevation.ravel(), atol=1e-5)
    assert everything.positions.dtype == np.float32
    assert everything.colors.dtype == np.uint8


def test_a_wider_mask_only_adds_surfels() -> None:
    narrow, wide = surfels(max_std_ratio=0.1), surfels(max_std_ratio=0.6)
    assert {tuple(p) for p in narrow.positions} < {tuple(p) for p in wide.positions}


def test_without_light_the_colours_are_the_legends() -> None:
    flat = surfels(hillshaded=False)
    lit = surfels(hillshaded=True)
    assert (flat.colors != lit.colors).any()
    scale = shared_scale((MAP,), "std", "automatic", RATIO, (0.0,))
    for hillshaded in (False, True):  # only elevation is ever lit
        std = make_surfels(MAP, scale, layer="std", max_std_ratio=RATIO, hillshaded=hillshaded)
        assert len(np.unique(std.colors, axis=0)) <= 256


def test_a_stride_draws_fewer_and_larger() -> None:
    fine, coarse = surfels(untrusted="shown"), surfels(untrusted="shown", stride=3)
    assert coarse.size == pytest.approx(3 * fine.size)
    assert len(coarse.positions) == len(range(0, MAP.grid.shape[0], 3)) * len(
        range(0, MAP.grid.shape[1], 3)
    )


@pytest.mark.parametrize("num_cells", [1, 100, 200_000, 200_001, 5_000_000])
def test_the_stride_keeps_to_the_limit(num_cells: int) -> None:
    stride = stride_for(num_cells, 200_000)
    assert num_cells / stride**2 <= 200_000
    assert stride == 1 or num_cells / (stride - 1) ** 2 > 200_000
