import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.viewer.scene.picking import Ray, first_hit, height_at
from app.viewer.scene.placement import Placement
from app.viewer.session.state import open_dataset
from gpgrad_core.detection import PipelineParams
from tests.support.synthetic import make_dataset, make_map

STATE = open_dataset(make_dataset(num_points=300), PipelineParams())
MAP = make_map(STATE.query)
EVERYWHERE = np.ones(MAP.grid.shape, dtype=bool)
PLACE = Placement(3.0, -2.0, 0.7, yaw=2.1)


def looking_at(target: np.ndarray, origin: tuple[float, float, float]) -> Ray:
    eye = np.array(origin)
    return Ray(eye, target - eye)


@given(
    x=st.floats(-2.2, 2.2),
    y=st.floats(-2.2, 2.2),
    azimuth=st.floats(-np.pi, np.pi),
    tilt=st.floats(0.9, np.pi / 2),
)
def test_a_ray_through_a_point_of_the_surface_hits_there_or_before(
    x: float, y: float, azimuth: float, tilt: float
) -> None:
    height = height_at(MAP, MAP.grid.to_pixel(np.array([[x, y]])))[0]
    target = PLACE.apply(np.array([[x, y, height]]))[0]
    away = np.array([np.cos(azimuth) * np.cos(tilt), np.sin(azimuth) * np.cos(tilt), np.sin(tilt)])
    ray = Ray(target + 20.0 * away, -away)
    hit = first_hit(ray, MAP, PLACE, EVERYWHERE)
    assert hit is not None
    assert hit.distance <= 20.0 + 0.02
    # Wherever it hit, it is a point of the surface and of the ray.
    on_ray = ray.origin + hit.distance * ray.direction
    on_surface = np.array(
        [hit.x, hit.y, height_at(MAP, MAP.grid.to_pixel(np.array([[hit.x, hit.y]])))[0]]
    )
    np.testing.assert_allclose(PLACE.apply(on_surface[None])[0], on_ray, atol=0.01)


def test_straight_down_it_hits_the_very_place() -> None:
    target = PLACE.apply(np.array([[1.0, -0.5, 0.0]]))[0]
    hit = first_hit(
        Ray(target + np.array([0.0, 0.0, 30.0]), np.array([0.0, 0.0, -2.0])), MAP, PLACE, EVERYWHERE
    )
    assert hit is not None
    assert (hit.x, hit.y) == pytest.approx((1.0, -0.5))
    height = height_at(MAP, MAP.grid.to_pixel(np.array([[1.0, -0.5]])))[0]
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


def test_nothing_drawn_is_nothing_hit() -> None:
    ray = Ray(np.array([3.0, -2.0, 30.0]), np.array([0.0, 0.0, -1.0]))
    assert first_hit(ray, MAP, PLACE, ~EVERYWHERE) is None
