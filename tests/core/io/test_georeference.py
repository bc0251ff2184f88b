"""Local frames on planets, against geocentric coordinates computed another way."""

import math

import numpy as np
import pytest

from gpgrad_core.io.georeference import east_north_up, make_georeference, read_origin
from tests.support.refusal import assert_refused

pyproj = pytest.importorskip("pyproj")
ETNA = (37.75, 14.99, 2900.0)
POINTS = np.random.default_rng(3).uniform(-800.0, 800.0, (40, 3))


def test_a_place_on_the_earth_is_where_geodesy_has_it() -> None:
    found = make_georeference(ETNA)
    assert found.name == "EPSG:32633"
    places = found.geographic(POINTS)
    back = east_north_up(places[:, [1, 0, 2]], np.array(ETNA))
    np.testing.assert_allclose(back, POINTS, atol=1e-6)
    to_system = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32633", always_xy=True)
    x, y = to_system.transform(places[:, 0], places[:, 1])
    np.testing.assert_allclose(found.apply(POINTS), np.column_stack([x, y, places[:, 2]]))


@pytest.mark.parametrize(
    ("origin", "name"),
    [
        ((37.75, 14.99, 0.0), "EPSG:32633"),
        ((-37.0, 179.9, 5.0), "EPSG:32760"),
        ((0.0, -180.0, 0.0), "EPSG:32601"),
        ((10.0, 540.0 - 360.0, 0.0), "EPSG:32601"),
        ((88.0, 10.0, 0.0), "EPSG:5041"),
        ((-89.0, 10.0, 0.0), "EPSG:5042"),
    ],
)
def test_without_a_system_the_zone_is_that_of_the_origin(
    origin: tuple[float, float, float], name: str
) -> None:
    assert make_georeference(origin).name == name


@pytest.mark.parametrize(
    ("code", "radius"), [("IAU_2015:49910", 3_396_190.0), ("IAU_2015:30110", 1_737_400.0)]
)
def test_mars_and_the_moon_are_spheres_of_their_size(code: str, radius: float) -> None:
    latitude, longitude, height = -4.5, 137.4, -4500.0
    found = make_georeference((latitude, longitude, height), code)
    (start, north, east) = found.apply(np.array([[0.0, 0, 0], [0, 100, 0], [100, 0, 0]]))
    assert start[0] == pytest.approx(radius * math.radians(longitude), abs=0.01)
    assert start[1] == pytest.approx(radius * math.radians(latitude), abs=0.01)
    assert start[2] == pytest.approx(height, abs=1e-6)
    # A hundred metres at that height are more on the sphere's surface.
    on_sphere = 100.0 * radius / (radius + height)
    assert north[1] - start[1] == pytest.approx(on_sphere, abs=0.01)
    stretched = on_sphere / math.cos(math.radians(latitude))
    assert east[0] - start[0] == pytest.approx(stretched, abs=0.01)


def test_an_easting_and_northing_is_the_origin_itself() -> None:
    origin = (499_119.0, 4_178_000.0, 2900.0)
    found = make_georeference(origin, "EPSG:32633")
    np.testing.assert_allclose(found.apply(np.zeros((1, 3)))[0], origin, atol=1e-6)


@pytest.mark.parametrize(
    ("origin", "crs", "words"),
    [
        ((5e5, 4e6, 0.0), None, "needs the system"),
        ((37.0, 15.0, 1e6), None, "height lies within"),
        ((37.0, 15.0, 0.0), "EPSG:4326", "is Geographic 2D CRS in degree"),
        ((37.0, -74.0, 0.0), "EPSG:2263", "US survey foot"),
        ((37.0, 15.0, 0.0), "nonsense", "no coordinate system that PROJ knows"),
        ((-4.5, 137.4, 0.0), "EPSG:25832", "lies outside of EPSG:25832"),
        ((-4.5, 137.4, 0.0), "IAU_2015:49911", "counts to the west"),
        ((4e12, 4e6, 0.0), "EPSG:32633", "lie within"),
    ],
)
def test_what_cannot_be_is_refused(
    origin: tuple[float, float, float], crs: str | None, words: str
) -> None:
    assert_refused(lambda: make_georeference(origin, crs), words)


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "1;2;3", "a,b,c", "nan,1,2", "1,2,inf"])
def test_an_origin_is_three_numbers(text: str) -> None:
    assert_refused(lambda: read_origin(text), "LAT,LON,HEIGHT")
