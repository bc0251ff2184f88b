from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.viewer.scene.placement import Placement
from app.viewer.scene.probing import (
    Ray,
    first_hit,
    label_text,
    measure,
    places_of,
    read,
    read_both,
    sample,
)
from app.viewer.session.state import Probe, open_dataset
from gpgrad_core.detection import PipelineParams
from gpgrad_core.types import GradientMap, Grid
from tests.support.synthetic import T_DATABASE_QUERY, height, make_dataset, make_map, make_result

STATE = open_dataset(make_dataset(), PipelineParams())
MAP = make_map(STATE.query)
EVERYWHERE = np.ones(MAP.grid.shape, dtype=bool)
PLACE = Placement(3.0, -2.0, 0.7, yaw=2.1)
RESULT = make_result(STATE)
MAPS = RESULT.query_map, RESULT.database_map
RATIO = 0.5


def looking_at(target: np.ndarray, origin: tuple[float, float, float]) -> Ray:
    eye = np.array(origin)
    return Ray(eye, target - eye)


@given(
    x=st.floats(-2.2, 2.2),
    y=st.floats(-2.2, 2.2),
    azimuth=st.floats(-np.pi, np.pi),
    tilt=st.floats(0.9, np.pi / 2),
)
def test_a_ray_through_ground_hits_it(x: float, y: float, azimuth: float, tilt: float) -> None:
    height = sample(MAP.elevation, MAP.grid.to_pixel(np.array([[x, y]])))[0]
    target = PLACE.apply(np.array([[x, y, height]]))[0]
    away = np.array([np.cos(azimuth) * np.cos(tilt), np.sin(azimuth) * np.cos(tilt), np.sin(tilt)])
    ray = Ray(target + 20.0 * away, -away)
    hit = first_hit(ray, MAP, PLACE, EVERYWHERE)
    assert hit is not None
    assert hit.distance <= 20.0 + 0.02
    # Wherever it hit, it is a point of the surface and of the ray.
    on_ray = ray.origin + hit.distance * ray.direction
    on_surface = np.array(
        [hit.x, hit.y, sample(MAP.elevation, MAP.grid.to_pixel(np.array([[hit.x, hit.y]])))[0]]
    )
    np.testing.assert_allclose(PLACE.apply(on_surface[None])[0], on_ray, atol=0.01)


def test_straight_down_it_hits_the_very_place() -> None:
    target = PLACE.apply(np.array([[1.0, -0.5, 0.0]]))[0]
    hit = first_hit(
        Ray(target + np.array([0.0, 0.0, 30.0]), np.array([0.0, 0.0, -2.0])), MAP, PLACE, EVERYWHERE
    )
    assert hit is not None
    assert (hit.x, hit.y) == pytest.approx((1.0, -0.5))
    height = sample(MAP.elevation, MAP.grid.to_pixel(np.array([[1.0, -0.5]])))[0]
    assert 2.0 * hit.distance == pytest.approx(30.0 - height, abs=1e-6)


def test_it_passes_through_cells_that_are_not_drawn() -> None:
    ray = looking_at(PLACE.apply(np.zeros((1, 3)))[0], (3.0, -12.0, 4.0))
    seen = first_hit(ray, MAP, PLACE, EVERYWHERE)
    assert seen is not None
    column, row = np.rint(MAP.grid.to_pixel(np.array([[seen.x, seen.y]])))[0].astype(int)
    hole = EVERYWHERE.copy()
    hole[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4] = False
    beyond = first_hit(ray, MAP, PLACE, hole)
    assert beyond is None or beyond.distance > seen.distance


@pytest.mark.parametrize(
    ("origin", "direction"),
    [
        ((3.0, -2.0, 30.0), (0.0, 0.0, 1.0)),  # away from it
        ((300.0, -2.0, 30.0), (0.0, 0.0, -1.0)),  # beside it
        ((300.0, -2.0, 50.0), (-1.0, 0.0, 0.0)),  # above it
    ],
)
def test_a_ray_that_misses_hits_nothing(
    origin: tuple[float, float, float], direction: tuple[float, float, float]
) -> None:
    assert first_hit(Ray(np.array(origin), np.array(direction)), MAP, PLACE, EVERYWHERE) is None
    down = Ray(np.array([3.0, -2.0, 30.0]), np.array([0.0, 0.0, -1.0]))
    assert first_hit(down, MAP, PLACE, ~EVERYWHERE) is None  # nothing is drawn


def plane(slope_x: float, slope_y: float) -> GradientMap:
    """A tilted plane, 1 m high at the origin, known to 2 cm."""
    grid = Grid((-1.0, -1.0), 0.1, (21, 21))
    x, y = np.meshgrid(grid.x, grid.y)
    shape = grid.shape
    return GradientMap(
        grid,
        1.0 + slope_x * x + slope_y * y,
        np.full(shape, 0.02**2),
        np.broadcast_to([slope_x, slope_y], (*shape, 2)).copy(),
        signal_std=0.1,
        length_scale=0.3,
    )


@pytest.mark.parametrize(
    ("slope", "steepness", "aspect"),
    [
        ((-1.0, 0.0), 45.0, 90.0),  # falls towards +x: east
        ((0.0, -1.0), 45.0, 0.0),  # towards +y: north
        ((0.0, 1.0), 45.0, 180.0),
        ((1.0, 0.0), 45.0, 270.0),
        ((-0.1, -0.1), 8.05, 45.0),
        ((0.0, 0.0), 0.0, None),
    ],
)
def test_slope_and_aspect_of_a_plane(
    slope: tuple[float, float], steepness: float, aspect: float | None
) -> None:
    reading = read(plane(*slope), 0.234, -0.567, 0.3)
    assert reading is not None
    assert reading.elevation == pytest.approx(1.0 + slope[0] * 0.234 - slope[1] * 0.567)
    assert reading.std == pytest.approx(0.02)
    assert reading.trusted
    assert reading.slope == pytest.approx(steepness, abs=0.01)
    assert reading.aspect == (None if aspect is None else pytest.approx(aspect, abs=0.01))


def test_a_masked_place_says_so_and_beyond_the_rim_there_is_nothing() -> None:
    terrain = plane(0.1, 0.1)
    masked = read(terrain, 0.0, 0.0, 0.1)  # 0.02 m is 0.2 of the signal
    assert masked is not None
    assert not masked.trusted
    assert read(terrain, 1.2, 0.0, 0.3) is None


def test_the_same_place_in_the_other_submap_has_the_same_height() -> None:
    query, database = make_map(STATE.query, 0.05), make_map(STATE.database, 0.05)
    probe = Probe("query", 0.4, -0.8)
    here, there = read_both((query, database), probe, T_DATABASE_QUERY, 0.3)
    assert here == read(query, 0.4, -0.8, 0.3)
    assert here is not None
    assert there is not None
    assert here.elevation == pytest.approx(there.elevation, abs=2e-3)
    back = places_of(Probe("database", there.x, there.y), T_DATABASE_QUERY)
    assert back["query"] == pytest.approx((0.4, -0.8))
    assert read_both((query, database), probe, None, 0.3) == (here, None)
    assert read_both((query, database), None, T_DATABASE_QUERY, 0.3) == (None, None)


@pytest.mark.parametrize(
    ("std", "text"),
    [(0.0123, "1.235 ± 0.012 m"), (0.5, "1.23 ± 0.50 m"), (0.00012, "1.23457 ± 0.00012 m")],
)
def test_a_height_is_given_as_many_digits_as_it_deserves(std: float, text: str) -> None:
    reading = read(plane(0.1, 0.0), 0.0, 0.0, 0.3)
    assert reading is not None
    assert label_text(replace(reading, elevation=1.2345678, std=std)).startswith(text)


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
