from dataclasses import replace

import numpy as np
import pytest

from app.viewer.scene.readout import label_text, other_place, read
from app.viewer.session.state import open_dataset
from gpgrad_core.detection import PipelineParams
from gpgrad_core.types import GradientMap, Grid
from tests.support.synthetic import T_DATABASE_QUERY, make_dataset, make_map

STATE = open_dataset(make_dataset(num_points=300), PipelineParams())


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
    here = read(query, 0.4, -0.8, 0.3)
    there = read(database, *other_place(T_DATABASE_QUERY, 0.4, -0.8, of_query=True), 0.3)
    assert here is not None
    assert there is not None
    assert here.elevation == pytest.approx(there.elevation, abs=2e-3)
    back = other_place(T_DATABASE_QUERY, there.x, there.y, of_query=False)
    assert back == pytest.approx((0.4, -0.8))


@pytest.mark.parametrize(
    ("std", "text"),
    [(0.0123, "1.235 ± 0.012 m"), (0.5, "1.23 ± 0.50 m"), (0.00012, "1.23457 ± 0.00012 m")],
)
def test_a_height_is_given_as_many_digits_as_it_deserves(std: float, text: str) -> None:
    reading = read(plane(0.1, 0.0), 0.0, 0.0, 0.3)
    assert reading is not None
    assert label_text(replace(reading, elevation=1.2345678, std=std)).startswith(text)
