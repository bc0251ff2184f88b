import numpy as np
import pytest

from app.viewer.scene.ruler import measure
from app.viewer.session.state import Probe, open_dataset
from gpgrad_core.detection import PipelineParams
from tests.support.synthetic import T_DATABASE_QUERY, height, make_dataset, make_result

STATE = open_dataset(make_dataset(), PipelineParams())
RESULT = make_result(STATE)
MAPS = RESULT.query_map, RESULT.database_map
RATIO = 0.5


def test_a_line_has_the_length_rise_and_slope_of_the_ground() -> None:
    ends = Probe("database", -0.6, 0.1), Probe("database", 0.9, 0.4)
    ruler = measure(MAPS, ends, T_DATABASE_QUERY, 0.0, RATIO)
    assert ruler is not None
    assert ruler.length == pytest.approx(np.hypot(1.5, 0.3))
    truth = height(np.array([[0.9, 0.4]])) - height(np.array([[-0.6, 0.1]]))
    assert ruler.rise == pytest.approx(float(truth[0]), abs=0.08)
    assert ruler.slope == pytest.approx(np.degrees(np.arctan2(ruler.rise, ruler.length)))
    assert ruler.rise_std > 0
    assert ruler.query is not None
    assert ruler.database is not None
    both = np.isfinite(ruler.query.elevation) & np.isfinite(ruler.database.elevation)
    assert both.mean() > 0.5
    missed = ruler.query.elevation[both] - ruler.database.elevation[both]
    assert np.abs(missed).max() < 0.25  # both saw the same ground


def test_ends_on_both_submaps_are_joined_by_the_motion() -> None:
    place = np.array([[0.3, -0.2]])
    x, y = T_DATABASE_QUERY.inverse().apply(place)[0]
    ends = Probe("query", float(x), float(y)), Probe("database", 0.3, -0.2)
    same = measure(MAPS, ends, T_DATABASE_QUERY, 0.0, RATIO)
    assert same is not None
    assert same.length == pytest.approx(0.0, abs=1e-9)
    assert measure(MAPS, ends, None, 0.0, RATIO) is None


def test_without_a_motion_only_its_own_submap_is_read() -> None:
    ends = Probe("query", -0.5, 0.0), Probe("query", 0.5, 0.0)
    ruler = measure(MAPS, ends, None, 0.0, RATIO)
    assert ruler is not None
    assert ruler.database is None
    assert ruler.query is not None
    assert ruler.query.is_known


def test_a_higher_query_is_lifted_onto_the_database() -> None:
    ends = Probe("query", -0.5, 0.0), Probe("query", 0.5, 0.0)
    level, lifted = (measure(MAPS, ends, T_DATABASE_QUERY, z, RATIO) for z in (0.0, 2.0))
    assert level is not None
    assert lifted is not None
    assert level.query is not None
    assert lifted.query is not None
    np.testing.assert_allclose(lifted.query.elevation - level.query.elevation, 2.0)
    assert lifted.rise == pytest.approx(level.rise)


def test_beyond_the_map_nothing_is_known() -> None:
    ends = Probe("database", 0.0, 0.0), Probe("database", 90.0, 0.0)
    ruler = measure(MAPS, ends, None, 0.0, RATIO)
    assert ruler is not None
    assert np.isnan(ruler.rise)
    assert ruler.database is not None
    assert np.isnan(ruler.database.elevation[-1])
