"""Maps with coordinates, read by GDAL, laspy and PROJ, and placed by other equations than ours."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.cli import run
from gpgrad_core.io.clouds.ply import write_ply
from tests.end_to_end.process import gpgrad
from tests.end_to_end.test_slam import write_by_hand

rasterio = pytest.importorskip("rasterio")
laspy = pytest.importorskip("laspy")
pyproj = pytest.importorskip("pyproj")
LATITUDE, LONGITUDE, HEIGHT = 37.75, 14.99, 2900.0
ORIGIN = f"{LATITUDE},{LONGITUDE},{HEIGHT}"


def as_utm(degrees: np.ndarray) -> np.ndarray:
    """Turn longitude, latitude and height into UTM."""
    to_utm = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32633", always_xy=True)
    return np.column_stack([*to_utm.transform(degrees[:, 0], degrees[:, 1]), degrees[:, 2]])


def in_utm(local: np.ndarray) -> np.ndarray:
    """Place points east, north and up of the origin in UTM, by way of geocentric coordinates."""
    to_geocentric = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    start = np.array(to_geocentric.transform(LONGITUDE, LATITUDE, HEIGHT))
    longitude, latitude = np.radians([LONGITUDE, LATITUDE])
    s, c, t, d = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    turn = np.array([[-t, d, 0.0], [-s * d, -s * t, c], [c * d, c * t, s]])
    places = to_geocentric.transform(*(start + local @ turn).T, direction="INVERSE")
    return as_utm(np.column_stack(places))


def height_at(raster: Any, place: np.ndarray) -> float:
    """Interpolate the elevation between the four cells around a place."""
    cell = raster.transform
    column, row = (place[0] - cell.c) / cell.a - 0.5, (place[1] - cell.f) / cell.e - 0.5
    left, top = int(np.floor(column)), int(np.floor(row))
    cells = raster.read(1)[top : top + 2, left : left + 2]
    across, down = column - left, row - top
    upper, lower = cells @ [1 - across, across]
    return float((1 - down) * upper + down * lower)


@pytest.fixture
def slope(tmp_path: Path) -> Path:
    """A plane so steep that a place that is 1 cm off is 1 cm too high or too low."""
    xy = np.random.default_rng(0).uniform(-6.0, 6.0, (9000, 2))
    z = 0.8 * xy[:, 0] - 0.6 * xy[:, 1] + np.random.default_rng(1).normal(0, 0.002, 9000)
    np.save(tmp_path / "slope.npy", np.column_stack([xy, z]))
    return tmp_path / "slope.npy"


@pytest.mark.slow
def test_a_map_lies_within_a_centimetre_of_its_place(slope: Path, tmp_path: Path) -> None:
    out = tmp_path / "map.tif"
    flags = ["--map.resolution", "0.1", "--map.noise-std", "0.01", "--map.length-scale", "0.5"]
    assert run(["map", str(slope), "--out", str(out), "--origin", ORIGIN, *flags]) == 0
    xy = np.array([(0.0, 0.0), (3.0, 1.0), (-2.0, -4.0), (-3.5, 2.5)])
    places = in_utm(np.column_stack([xy, xy @ [0.8, -0.6]]))
    with rasterio.open(out) as raster:
        assert raster.crs.to_epsg() == 32633
        for place in places:
            assert height_at(raster, place) == pytest.approx(place[2], abs=0.01)


@pytest.mark.slow
def test_noise_that_grows_with_the_range_is_the_same_in_coordinates(
    slope: Path, tmp_path: Path
) -> None:
    flags = ["--map.resolution", "0.1", "--map.length-scale", "0.5", "--map.noise-std", "0.01"]
    flags += ["--map.noise-model", "range", "--map.noise-growth", "0.005"]
    points = np.load(slope)
    ranged = tmp_path / "slope.ply"
    write_ply(ranged, points, extras={"range": np.linalg.norm(points, axis=1)})
    variances: list[float] = []
    for name, placed in (("local.tif", []), ("placed.tif", ["--origin", ORIGIN])):
        out = tmp_path / name
        assert run(["map", str(ranged), "--out", str(out), *placed, *flags]) == 0
        with rasterio.open(out) as raster:
            variances.append(float(np.nanmedian(raster.read(2))))
    assert variances[1] == pytest.approx(variances[0], rel=0.05)


@pytest.mark.slow
def test_a_traverse_lies_where_its_true_positions_are(
    traverse: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / "traverse"
    shutil.copytree(traverse, data)
    rows = np.loadtxt(data / "poses_odom.txt")
    turn, offset = 0.7, np.array([120.0, -80.0, 5.0])
    c, s = np.cos(turn), np.sin(turn)
    true = rows[:, 1:4] @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]) + offset
    (data / "positions_gt.txt").write_text(
        "".join(f"{k} {x} {y} {z}\n" for k, (x, y, z) in enumerate(true))
    )
    about = data / "dataset.toml"
    about.write_text(f"origin = [{ORIGIN}]\n{about.read_text()}")
    closures = write_by_hand(tmp_path / "mine.json", accepted=True)
    out = tmp_path / "map"
    flags = ["--closures", str(closures), "--merged.resolution", "0.2", "--crs", "UTM"]
    assert run(["slam", str(data), "--out", str(out), *flags]) == 0
    assert "in EPSG:32633, origin 37.75" in capsys.readouterr().out
    wanted = in_utm(true)
    features = json.loads((out / "poses.geojson").read_text())["features"]
    degrees = np.array([place["geometry"]["coordinates"] for place in features[1:]])
    np.testing.assert_allclose(as_utm(degrees), wanted, atol=0.1)  # the closure moved them a little
    with rasterio.open(out / "map.tif") as raster:
        assert raster.crs.to_epsg() == 32633
        left, bottom, right, top = raster.bounds
    assert left < wanted[:, 0].min() < wanted[:, 0].max() < right
    assert bottom < wanted[:, 1].min() < wanted[:, 1].max() < top
    cloud = laspy.read(out / "cloud.laz")
    assert cloud.header.parse_crs().to_epsg() == 32633
    assert left - 0.2 <= cloud.x.min() <= cloud.x.max() <= right + 0.2
    assert (out / "poses.kml").read_text().count("<Point>") == 4
    assert json.loads((out / "report.json").read_text())["coordinates"]["placed_by_truth"]


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("--crs", "EPSG:32633"), "does not say where it lies; give --origin"),
        (("--origin", "1,2"), "an origin is LAT,LON,HEIGHT"),
        (("--origin", ORIGIN, "--crs", "EPSG:4326"), "needs a projection in metres"),
    ],
)
def test_what_cannot_be_is_told_before_the_work(
    traverse: Path, tmp_path: Path, flags: tuple[str, ...], words: str
) -> None:
    assert words in gpgrad("slam", traverse, "--out", tmp_path / "map", *flags).refusal
    assert not (tmp_path / "map").exists()


def test_only_a_raster_has_coordinates(slope: Path, tmp_path: Path) -> None:
    line = gpgrad("map", slope, "--out", tmp_path / "m.png", "--origin", ORIGIN).refusal
    assert "name a file that ends in .tif" in line


@pytest.mark.slow
def test_several_traverses_are_placed_by_the_first(traverse: Path, tmp_path: Path) -> None:
    rows = np.loadtxt(traverse / "poses_odom.txt")
    for name, offset, origin in (("first", 120.0, ORIGIN), ("later", -4000.0, "10.0,20.0,0.0")):
        data = shutil.copytree(traverse, tmp_path / name)
        true = rows[:, 1:4] + np.array([offset, 0.0, 0.0])
        (data / "positions_gt.txt").write_text(
            "".join(f"{k} {x} {y} {z}\n" for k, (x, y, z) in enumerate(true))
        )
        about = (data / "dataset.toml").read_text().replace("small traverse", name)
        (data / "dataset.toml").write_text(f"origin = [{origin}]\n{about}")
    same = {"num_inliers": 20, "score": 9.0, "dissimilarity": 1.0, "overlap_area": 40.0}
    same |= {"accepted": True, "reason": "", "T_database_query": {"x": 0.0, "y": 0.0, "yaw": 0.0}}
    file = write_by_hand(tmp_path / "mine.json", accepted=True)
    content = json.loads(file.read_text())
    content["pairs"] = [
        {"query": f"later:00{k}", "database": f"first:00{k}"} | same for k in range(4)
    ]
    file.write_text(json.dumps(content))
    out = tmp_path / "map"
    both = [str(tmp_path / "first"), str(tmp_path / "later")]
    flags = ["--closures", str(file), "--no-merge", "--crs", "UTM"]
    assert run(["slam", *both, "--out", str(out), *flags]) == 0
    features = json.loads((out / "poses.geojson").read_text())["features"]
    places = [feature["geometry"] for feature in features]
    degrees = np.array([place["coordinates"] for place in places if place["type"] == "Point"])
    wanted = in_utm(rows[:, 1:4] + np.array([120.0, 0.0, 0.0]))
    np.testing.assert_allclose(as_utm(degrees), np.vstack([wanted, wanted]), atol=0.1)
