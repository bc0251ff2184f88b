"""What other programs read in files with coordinates."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.io.georeference import Georeference, make_georeference
from gpgrad_core.io.records.georeferenced import (
    write_cloud_optimised,
    write_geojson,
    write_kml,
    write_laz,
)
from gpgrad_core.types import Grid

rasterio = pytest.importorskip("rasterio")
laspy = pytest.importorskip("laspy")
pyproj = pytest.importorskip("pyproj")
ETNA = make_georeference((37.75, 14.99, 2900.0))
MARS = make_georeference((-4.5, 137.4, -4500.0), "IAU_2015:49910")
GRID = Grid((499_100.0, 4_178_000.0), 0.5, (600, 400))


@pytest.mark.parametrize("georeference", [ETNA, MARS], ids=["Earth", "Mars"])
def test_a_raster_is_cloud_optimised_and_knows_its_place(
    tmp_path: Path, georeference: Georeference
) -> None:
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


@pytest.mark.parametrize("georeference", [ETNA, MARS], ids=["Earth", "Mars"])
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
    places = dict(zip(("a:0", "a:1", "<b>"), ETNA.geographic(np.eye(3) * 100), strict=True))
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
