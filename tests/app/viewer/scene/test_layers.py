from dataclasses import replace

import cv2
import numpy as np
import pytest

from app.viewer.scene.colors import BRIGHTNESS, UNTRUSTED_GREY
from app.viewer.scene.colors import QUERY as QUERY_COLOR
from app.viewer.scene.layers import (
    NUM_BINS,
    Paint,
    Scale,
    Surfels,
    make_surfels,
    shape_light,
    stride_for,
)
from app.viewer.session.layers import LAYERS, HeightFrame, pixel_motion, resample
from app.viewer.session.state import open_dataset
from gpgrad_core.detection import PipelineParams
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, Grid
from tests.support.synthetic import T_DATABASE_QUERY, make_dataset, make_map

MAPS = tuple(make_map(submap) for submap in make_dataset().submaps[:2])
MAP = MAPS[0]
RATIO = 0.3
STATE = open_dataset(make_dataset(num_points=300), PipelineParams())
QUERY, DATABASE = make_map(STATE.query, 0.05), make_map(STATE.database, 0.05)


@pytest.mark.parametrize("layer", LAYERS)
def test_every_layer_has_values_a_name_and_a_unit(layer: str) -> None:
    style = LAYERS[layer]
    assert style.of_map(MAPS[0]).shape == MAPS[0].grid.shape
    assert style.label
    assert style.unit


def test_slopes_are_shown_symmetrically_and_steepness_from_zero() -> None:
    slopes = Paint(MAPS, "slope_x", 1.0).scale
    assert slopes.low == -slopes.high
    assert slopes.color_map == "blue-white-red"
    assert Paint(MAPS, "gradient", 1.0).scale.low == 0.0


def test_only_trusted_cells_make_the_range_and_there_is_always_one() -> None:
    everything, trusted = Paint(MAPS, "std", 1.0, "turbo").scale, Paint(MAPS, "std", 0.2).scale
    assert everything.color_map == "turbo"  # the user's
    assert trusted.high < everything.high
    assert trusted.high <= 0.2 * MAPS[0].signal_std
    nothing = Paint(MAPS, "elevation", 0.0).scale
    assert np.isfinite([nothing.low, nothing.high]).all()
    assert nothing.low < nothing.high
    plain = Paint(MAPS[:1], "elevation", 1.0).scale
    lifted = Paint(MAPS[:1], "elevation", 1.0, levels=(HeightFrame(5.0),)).scale
    assert lifted.low == pytest.approx(plain.low + 5.0)


def test_a_steep_rim_makes_no_range_and_ends_are_round() -> None:
    inner, slope = QUERY.trusted(RATIO), QUERY.slope.copy()
    slope[~cv2.erode(inner.astype(np.uint8), np.ones((5, 5))).astype(bool)] = 50.0
    usual, rimmed = (
        Paint((of,), "gradient", RATIO).scale.high for of in (QUERY, replace(QUERY, slope=slope))
    )
    assert usual == rimmed == pytest.approx(float(f"{usual:.2g}"))
    assert Paint((QUERY,), "gradient", RATIO, ends=(0.2, 0.4)).scale.low == 0.2


def test_crests_are_lighter_than_hollows_and_edges_dark() -> None:
    light = shape_light(QUERY)
    assert shape_light(QUERY) is light  # made once for a map
    crest = light > np.percentile(light, 90)
    assert QUERY.elevation[crest].mean() > QUERY.elevation[light < np.percentile(light, 10)].mean()
    paint = Paint((QUERY,), "elevation", RATIO)
    lit, trusted = make_surfels(paint), QUERY.trusted(RATIO)
    edge = trusted & ~cv2.erode(trusted.astype(np.uint8), np.ones((3, 3))).astype(bool)
    light = lit.colors @ np.array(BRIGHTNESS)
    assert light[edge[trusted]].mean() < 0.7 * light[~edge[trusted]].mean()


def test_a_level_turns_and_tilts_slopes_and_raises_heights() -> None:
    level = HeightFrame(2.0, (0.1, -0.2), np.pi / 2)
    raised = LAYERS["elevation"].of_map(MAP, level) - MAP.elevation
    x, y = MAP.grid.x[3], MAP.grid.y[5]
    assert raised[5, 3] == pytest.approx(2.0 + 0.1 * x - 0.2 * y)
    tilted = MAP.slope + np.array([0.1, -0.2])
    # What the submap has along its x, the other frame has along y.
    np.testing.assert_allclose(LAYERS["slope_y"].of_map(MAP, level), tilted[..., 0], atol=1e-9)
    np.testing.assert_allclose(LAYERS["slope_x"].of_map(MAP, level), -tilted[..., 1], atol=1e-9)
    np.testing.assert_allclose(
        LAYERS["gradient"].of_map(MAP, level), np.hypot(tilted[..., 0], tilted[..., 1])
    )


def test_a_slope_that_faces_away_is_lit_as_level_ground_is() -> None:
    slope = MAP.slope + np.array([0.6, -0.4])
    inclined, gentle = replace(MAP, slope=slope), replace(MAP, slope=0.1 * MAP.slope)
    level, leaning, low = (Paint((of,), "gradient", RATIO) for of in (MAP, inclined, gentle))
    np.testing.assert_allclose(np.subtract(leaning.relief.lean, level.relief.lean), (0.6, -0.4))
    assert leaning.relief.times == pytest.approx(level.relief.times)
    assert low.relief.times > level.relief.times
    lit = [surfels(of=of).colors.astype(int) for of in (MAP, inclined)]
    assert np.abs(lit[0] - lit[1]).max() <= 1


def test_a_tint_keeps_what_is_light_light() -> None:
    plain, blue = (
        surfels(layer="gradient", hillshaded=False, hue=hue) for hue in (None, QUERY_COLOR)
    )
    assert (np.diff(blue.colors.astype(int), axis=1) >= 0).all()  # blue over green over red
    light = plain.colors @ np.array(BRIGHTNESS)
    order = np.argsort(light)
    assert (np.diff(blue.colors[order, 2].astype(int)) >= 0).all()


def test_a_motion_of_pixels_is_the_motion_of_their_positions() -> None:
    source, target = Grid((1.0, -2.0), 0.1, (30, 40)), Grid((-3.0, 0.5), 0.25, (50, 20))
    pixels = np.random.default_rng(0).uniform(0, 30, (20, 2))
    wanted = target.to_pixel(T_DATABASE_QUERY.apply(source.to_position(pixels)))
    motion = pixel_motion(T_DATABASE_QUERY, source, target)
    np.testing.assert_allclose(pixels @ motion[:, :2].T + motion[:, 2], wanted)


def test_resampling_onto_itself_changes_nothing_and_beyond_the_rim_is_nothing() -> None:
    values = QUERY.elevation.astype(np.float32)
    # A cell at the rim may be mixed with what is not there.
    same = resample(values, QUERY.grid, QUERY.grid, SE2())
    np.testing.assert_allclose(same[:-1, :-1], values[:-1, :-1])
    far = resample(values, QUERY.grid, QUERY.grid, SE2(100.0, 0.0, 0.0))
    assert np.isnan(far).all()


def test_registered_ground_differs_by_next_to_nothing() -> None:
    lowered = replace(QUERY, elevation=QUERY.elevation - 0.7)
    for field in Paint(
        (lowered, DATABASE), "difference", 0.3, motion=T_DATABASE_QUERY, z_offset=0.7
    ).fields:
        assert np.isfinite(field).sum() > 300
        assert np.nanmax(np.abs(field)) < 0.01


def test_a_bump_of_the_query_is_red_in_both_and_masked_cells_are_nothing() -> None:
    bumpy = QUERY.elevation.copy()
    rows, columns = bumpy.shape
    bumpy[rows // 2, columns // 2] += 0.2
    maps = replace(QUERY, elevation=bumpy), DATABASE
    at_query, at_database = Paint(
        maps, "difference", 0.3, motion=T_DATABASE_QUERY, z_offset=0.0
    ).fields
    assert at_query[rows // 2, columns // 2] == pytest.approx(0.2, abs=0.01)
    assert 0.05 < np.nanmax(at_database) < 0.21  # between cells it is read lower
    assert np.isnan(at_query[~QUERY.trusted(0.3)]).all()
    assert np.isnan(at_database[~DATABASE.trusted(0.3)]).all()


def test_agreement_is_above_zero_but_where_the_ground_has_changed() -> None:
    changed = QUERY.elevation.copy()
    rows, columns = changed.shape
    middle = slice(rows // 2 - 5, rows // 2 + 5), slice(columns // 2 - 5, columns // 2 + 5)
    changed[middle] += 0.3
    as_it_was, after = (
        Paint((query, DATABASE), "agreement", 0.3, motion=T_DATABASE_QUERY, z_offset=0.0).fields
        for query in (QUERY, replace(QUERY, elevation=changed))
    )
    for field, a_map in zip(as_it_was, (QUERY, DATABASE), strict=True):
        assert field.shape == a_map.grid.shape
        assert np.nanmean(field) > 0.3
    assert np.nanmean(after[0][middle]) < 0 < np.nanmean(as_it_was[0][middle])


def surfels(of: GradientMap = MAP, layer: str = "elevation", **changes: object) -> Surfels:
    return make_surfels(Paint((of,), layer, changes.pop("max_std_ratio", RATIO)), **changes)


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
    for hillshaded in (False, True):  # only elevation and gradient are ever lit
        std = surfels(layer="std", hillshaded=hillshaded)
        assert len(np.unique(std.colors, axis=0)) <= 256


def test_what_is_not_picked_out_of_the_values_is_grey() -> None:
    paint = Paint((MAP,), "gradient", RATIO)
    low, high = 0.2 * paint.scale.high, 0.5 * paint.scale.high
    lit, picked = make_surfels(paint), make_surfels(paint, picked=(low, high))
    values = MAP.gradient[MAP.trusted(RATIO)]
    inside = (values >= low) & (values <= high)
    assert 0 < inside.sum() < len(inside)
    np.testing.assert_array_equal(lit.colors[inside], picked.colors[inside])
    assert (np.ptp(picked.colors[~inside].astype(int), axis=1) == 0).all()


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


def test_cells_count_in_the_bin_of_their_colour() -> None:
    values = np.array([[0.01, 0.01, 0.51], [-3.0, 7.0, np.nan]])
    trusted = np.array([[True, False, True], [True, False, True]])
    grid = Grid((0.0, 0.0), 1.0, values.shape)
    slope = np.zeros((*values.shape, 2))
    a_map = GradientMap(grid, values, np.where(trusted, 0.0, 1.0), slope, 1.0, 1.0)
    paint = Paint((a_map, a_map), "elevation", RATIO)
    vars(paint)["scale"] = Scale("Elevation", "m", "viridis", 0.0, 1.0)  # in place of a cached one
    counted = paint.counted
    assert counted.trusted[0] == 4  # 0.01, and -3.0 with the end's colour; in both maps
    assert counted.trusted[NUM_BINS // 2] == 2
    assert counted.num_trusted == 6  # the one that is not a number is nowhere
    assert counted.masked[0] == 2
    assert counted.masked.sum() == 2
    assert counted.num_masked == 4
    # It agrees with NumPy on many cells.
    paint = Paint(MAPS, "mask", 1.0)
    expected, _ = np.histogram(np.concatenate([f.ravel() for f in paint.fields]), NUM_BINS, (0, 1))
    np.testing.assert_array_equal(paint.counted.trusted[:-1], expected[:-1])
    assert paint.counted.num_trusted == 2 * MAP.grid.num_cells
