"""Local frames on planets, against other computations, and what others read in files with them."""

import json
import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.io.georeference import Georeference, east_north_up, make_georeference, read_origin
from gpgrad_core.io.records.georeferenced import (
    write_cloud_optimised,
    write_geojson,
    write_kml,
    write_laz,
)
from gpgrad_core.types import Grid
from tests.support.refusal import assert_refused

pyproj = pytest.importorskip("pyproj")
rasterio = pytest.importorskip("rasterio")
laspy = pytest.importorskip("laspy")
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
def test_the_zone_is_that_of_the_origin(origin: tuple[float, float, float], name: str) -> None:
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


EARTH = make_georeference(ETNA)
MARS = make_georeference((-4.5, 137.4, -4500.0), "IAU_2015:49910")
GRID = Grid((499_100.0, 4_178_000.0), 0.5, (600, 400))


@pytest.mark.parametrize("georeference", [EARTH, MARS], ids=["Earth", "Mars"])
def test_a_raster_is_cloud_optimised_and_placed(tmp_path: Path, georeference: Georeference) -> None:
    x, y = np.meshgrid(GRID.x, GRID.y)
    elevation = (0.5 * (x - GRID.x[0]) - 0.2 * (y - GRID.y[0])).astype(np.float32)
    elevation[:10] = np.nan
    layers = {"elevation": elevation, "gradient": np.full(GRID.shape, 0.54, np.float32)}
    path = tmp_path / "map.tif"
    write_cloud_optimised(path, GRID, layers, georeference)
    with rasterio.open(path) as raster:
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert raster.overviews(1)
        assert raster.descriptions == ("elevation", "gradient")
        known = pyproj.CRS.from_wkt(raster.crs.to_wkt())
        assert known == pyproj.CRS.from_wkt(georeference.wkt)
        for row, column in ((50, 20), (599, 399)):
            place = GRID.x[column], GRID.y[row]
            found = next(raster.sample([place]))
            assert found[0] == pytest.approx(elevation[row, column], abs=1e-5)
            assert raster.xy(*raster.index(*place)) == pytest.approx(place, abs=1e-6)
        assert np.isnan(next(raster.sample([(GRID.x[5], GRID.y[5])]))[0])
    assert [file.name for file in tmp_path.iterdir()] == ["map.tif"]


@pytest.mark.parametrize("georeference", [EARTH, MARS], ids=["Earth", "Mars"])
def test_a_cloud_is_laz_with_its_system(tmp_path: Path, georeference: Georeference) -> None:
    rng = np.random.default_rng(1)
    local = rng.uniform(-50, 50, (1000, 3))
    points = georeference.apply(local)
    path = tmp_path / "cloud.laz"
    assert write_laz(path, (points[:400], points[400:]), georeference) == 1000
    cloud = laspy.read(path)
    assert cloud.header.are_points_compressed
    np.testing.assert_allclose(cloud.xyz, points, atol=0.0006)
    assert cloud.header.parse_crs().to_wkt() == georeference.wkt


def test_tracks_in_degrees(tmp_path: Path) -> None:
    places = dict(zip(("a:0", "a:1", "<b>"), EARTH.geographic(np.eye(3) * 100), strict=True))
    tracks = {"a": ("a:0", "a:1"), "b & c": ("<b>",)}
    write_geojson(tmp_path / "poses.geojson", tracks, places)
    write_kml(tmp_path / "poses.kml", tracks, places)
    features = json.loads((tmp_path / "poses.geojson").read_text())["features"]
    assert [one["geometry"]["type"] for one in features] == ["LineString", *3 * ["Point"]]
    assert features[-1]["properties"] == {"traverse": "b & c", "submap": "<b>"}
    found, expected = np.array(features[1]["geometry"]["coordinates"]), places["a:0"]
    np.testing.assert_allclose(found, expected, atol=1e-4)
    np.testing.assert_allclose(found[:2], expected[:2], atol=1e-9)
    kml = ET.parse(tmp_path / "poses.kml")
    names = [one.text for one in kml.iter("{http://www.opengis.net/kml/2.2}name")]
    assert names == ["a", "a", "a:0", "a:1", "b & c", "b & c", "<b>"]
