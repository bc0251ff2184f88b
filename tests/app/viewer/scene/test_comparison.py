from dataclasses import replace

import numpy as np
import pytest

from app.viewer.scene.comparison import compare, compared_cells, pixel_motion, resample
from app.viewer.scene.placement import Placement
from app.viewer.session.state import open_dataset
from gpgrad_core.detection import PipelineParams
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Grid
from tests.support.synthetic import T_DATABASE_QUERY, make_dataset, make_map

STATE = open_dataset(make_dataset(num_points=300), PipelineParams())
QUERY, DATABASE = make_map(STATE.query, 0.05), make_map(STATE.database, 0.05)


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
    for field in compare("difference", (lowered, DATABASE), T_DATABASE_QUERY, 0.7, 0.3):
        assert np.isfinite(field).sum() > 300
        assert np.nanmax(np.abs(field)) < 0.01


def test_a_bump_of_the_query_is_red_in_both_and_masked_cells_are_nothing() -> None:
    bumpy = QUERY.elevation.copy()
    rows, columns = bumpy.shape
    bumpy[rows // 2, columns // 2] += 0.2
    maps = replace(QUERY, elevation=bumpy), DATABASE
    at_query, at_database = compare("difference", maps, T_DATABASE_QUERY, 0.0, 0.3)
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
        compare("agreement", (query, DATABASE), T_DATABASE_QUERY, 0.0, 0.3)
        for query in (QUERY, replace(QUERY, elevation=changed))
    )
    for field, a_map in zip(as_it_was, (QUERY, DATABASE), strict=True):
        assert field.shape == a_map.grid.shape
        assert np.nanmean(field) > 0.3
    assert np.nanmean(after[0][middle]) < 0 < np.nanmean(as_it_was[0][middle])


def test_a_swipe_parts_the_scene_at_its_line() -> None:
    place = Placement(1.0, 2.0, 0.0, yaw=0.8)
    scene = place.apply(np.column_stack([QUERY.grid.positions, np.zeros(QUERY.grid.num_cells)]))
    right = compared_cells(QUERY.grid, place, "database", 1.2)
    left = compared_cells(QUERY.grid, place, "query", 1.2)
    np.testing.assert_array_equal(right.ravel(), scene[:, 0] > 1.2)
    np.testing.assert_array_equal(left, ~right)
    assert right.any()
    assert left.any()
