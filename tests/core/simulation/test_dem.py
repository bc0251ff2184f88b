"""Elevation models written by rasterio become the ground of a simulation, where they should."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from app.cli import run
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.io.rasters import read_elevation_model
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.simulate import simulate_dataset
from gpgrad_core.simulation.terrain import RESOLUTION, ElevationModel, ground_of
from tests.support.refusal import assert_refused

rasterio = pytest.importorskip("rasterio", reason="rasterio is not installed")
SIDE = 80
SMALL = SimulationParams(num_submaps=2, extent=30.0, rock_density=0.0, max_points=2000)


def hill(east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """Height [m] by metres from the middle of the model."""
    return 500.0 + 0.05 * east + 1.5 * np.sin(0.3 * north) + 0.6 * np.cos(0.4 * east)


def write_dem(path: Path, cell: float = 1.0, **changed: Any) -> Path:
    """Write a model with rasterio; row 0 is in the north."""
    along = cell * (np.arange(SIDE) - 0.5 * (SIDE - 1))
    east, north = np.meshgrid(along, -along)
    heights = changed.pop("heights", hill(east, north)).astype("float32")
    profile: dict[str, Any] = {
        "driver": "GTiff",
        "width": SIDE,
        "height": SIDE,
        "count": 1,
        "dtype": "float32",
        "crs": "EPSG:32633",
        "transform": rasterio.transform.Affine(cell, 0.0, 3e5, 0.0, -cell, 4e6),
    }
    with rasterio.open(path, "w", **(profile | changed)) as file:
        file.write(heights, 1)
    return path


def made(model: ElevationModel) -> tuple[np.ndarray, np.ndarray]:
    """The ground of a model, and the places of its columns from the middle [m]."""
    ground = ground_of(model, SMALL, np.array([[15.0, 15.0]])).elevation
    return ground, RESOLUTION * (np.arange(len(ground)) - 0.5 * (len(ground) - 1))


def test_the_ground_is_the_model(tmp_path: Path) -> None:
    ground, along = made(ElevationModel(write_dem(tmp_path / "dem.tif")))
    true = hill(*np.meshgrid(along, along))
    np.testing.assert_allclose(ground, true - np.median(true), atol=0.01)


def test_scale_and_exaggeration(tmp_path: Path) -> None:
    path = write_dem(tmp_path / "dem.tif", cell=10.0)
    ground, along = made(ElevationModel(path, 0.1, 2.0))
    coarse = 0.2 * hill(*np.meshgrid(10 * along, 10 * along))
    # Of the waves little is left in cells of 10 m: the slope of the whole tells the scale.
    slopes = [np.polyfit(along, one.mean(axis=0), 1)[0] for one in (ground, coarse)]
    assert slopes[0] == pytest.approx(slopes[1], abs=0.01)
    read = read_elevation_model(path)
    assert read.cell == (10.0, 10.0)
    assert read.heights[0, 0] == pytest.approx(hill(np.array(-395.0), np.array(-395.0)), abs=1e-3)


@pytest.mark.parametrize("middles", [False, True])
def test_where_it_lies(middles: bool, tmp_path: Path) -> None:
    path = write_dem(tmp_path / "dem.tif", cell=2.0)
    if middles:
        with rasterio.open(path, "r+") as file:
            file.update_tags(AREA_OR_POINT="Point")
    read = read_elevation_model(path)
    assert read.system == "EPSG:32633"
    with rasterio.open(path) as file:
        assert read.corner == pytest.approx(file.xy(SIDE - 1, 0), abs=1e-6)


def test_a_model_without_a_place_begins_at_zero(tmp_path: Path) -> None:
    path = write_dem(tmp_path / "dem.tif", crs=None)
    with tifffile.TiffFile(path) as file:
        heights = file.pages[0].asarray()
    tag = (33550, "d", 3, (2.0, 2.0, 0.0), True)
    tifffile.imwrite(tmp_path / "bare.tif", heights, extratags=[tag])
    read = read_elevation_model(tmp_path / "bare.tif")
    assert (read.corner, read.system) == ((0.0, 0.0), "")


@pytest.mark.slow
def test_a_rover_drives_over_it(tmp_path: Path) -> None:
    path = write_dem(tmp_path / "dem.tif")
    dataset = simulate_dataset(SMALL, terrain=ElevationModel(path))
    assert "Ground of dem.tif" in dataset.description
    middle = np.array([15.0, 15.0])
    offset = None
    for submap in dataset.submaps:
        world = submap.pose_true.apply(submap.points)
        off = world[:, 2] - hill(*(world[:, :2] - middle).T)
        offset = np.median(off) if offset is None else offset
        assert np.median(np.abs(off - offset)) < 0.05
    out = tmp_path / "out"
    flags = ["--num-submaps", "2", "--extent", "30", "--max-points", "2000"]
    assert run(["simulate", str(out), "--terrain", str(path), *flags]) == 0
    assert len(load_dataset(out).submaps) == 2
    drive = tmp_path / "drive"
    assert run(["simulate", str(drive), "--terrain", str(path), "--scans", "3", *flags]) == 0
    assert len(list((drive / "scans").iterdir())) == 3


def test_models_that_cannot_be_used(tmp_path: Path) -> None:
    path = tmp_path / "dem.tif"

    def drive(params: SimulationParams = SMALL, scale: float = 1.0) -> None:
        simulate_dataset(params, terrain=ElevationModel(path, scale))

    assert_refused(drive, str(path), "no such file")
    write_dem(path, crs="EPSG:4326")
    assert_refused(drive, str(path), "is in degrees", "gdalwarp")
    write_dem(path)
    assert_refused(lambda: drive(scale=0.1), str(path), "covers 7.9 m x 7.9 m", "--terrain-scale")
    assert_refused(lambda: drive(scale=0.0), "scale must be from 0.0001")
    roaming = SimulationParams(num_submaps=2, route="roaming")
    assert_refused(lambda: drive(roaming), str(path), "choose another route")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert_refused(drive, str(path), "is no GeoTIFF that can be read")
    gaps = np.full((SIDE, SIDE), 5.0)
    gaps[40, 40] = -9999.0
    write_dem(path, heights=gaps, nodata=-9999.0)
    assert_refused(drive, str(path), "has no height at 1 of")
    turned = rasterio.transform.Affine(1.0, 0.2, 3e5, 0.2, -1.0, 4e6)
    write_dem(path, transform=turned)
    assert_refused(drive, str(path), "is turned or mirrored")


def test_cells_that_gdal_left_out_are_no_heights(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Without a number for no height they were read as heights of zero."""
    heights = np.full((SIDE, SIDE), -9999.0)
    heights[:16] = 5.0
    path = tmp_path / "dem.tif"
    sparse: dict[str, Any] = {"blockysize": 16, "sparse_ok": True, "nodata": -9999.0}
    write_dem(path, heights=heights, **sparse)
    read = read_elevation_model(path).heights
    np.testing.assert_array_equal(np.isfinite(read[::-1]), heights > 0)
    write_dem(path, heights=np.where(heights > 0, heights, 0.0), **(sparse | {"nodata": None}))
    assert_refused(lambda: read_elevation_model(path), str(path), "strip 2 of 5 lies outside")
    # A number for no height that no cell can hold is no damage, and nobody need hear of it.
    write_dem(path, heights=np.full((SIDE, SIDE), 5.0), dtype="int16")
    content = path.read_bytes()
    tagged = tmp_path / "tagged.tif"
    with tifffile.TiffFile(path) as file:
        cell = (33550, "d", 3, (1.0, 1.0, 0.0), True)
        unheld = (42113, "s", 0, "1e9", True)
        tifffile.imwrite(tagged, file.pages[0].asarray(), extratags=[cell, unheld])
    assert np.isfinite(read_elevation_model(tagged).heights).all()
    path.write_bytes(content[:4] + bytes(len(content) - 4))
    assert_refused(lambda: read_elevation_model(path), str(path), "is no GeoTIFF")
    assert capfd.readouterr() == ("", "")
