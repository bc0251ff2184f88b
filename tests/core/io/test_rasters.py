"""Elevation models have the heights that rasterio writes: of all packings, units and masks."""

import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import tifffile

from gpgrad_core.io.rasters import read_elevation_model
from gpgrad_core.io.records.maps import write_raster
from gpgrad_core.types import Grid
from tests.support.refusal import assert_refused

SIDE = 40
RAW = (np.arange(SIDE * SIDE).reshape(SIDE, SIDE) * 7919 % 1000).astype(np.int16)
FOOT, SURVEY_FOOT = 0.3048, 1200 / 3937


def write(
    path: Path, heights: np.ndarray = RAW, *, count: int = 1, band: int = 1, **given: Any
) -> Path:
    """Write heights into a band; `scales`, `offsets`, `units`, `descriptions` are each band's."""
    of_bands = {name: given.pop(name) for name in ("scales", "offsets", "units", "descriptions")
                if name in given}  # fmt: skip
    profile: dict[str, Any] = {
        "driver": "GTiff", "width": SIDE, "height": SIDE, "count": count, "dtype": "float32",
        "crs": "EPSG:32633", "transform": rasterio.Affine(1.0, 0.0, 3e5, 0.0, -1.0, 4e6),
    }  # fmt: skip
    profile |= given
    with rasterio.open(path, "w", **profile) as file:
        for number in range(1, count + 1 if band else 1):  # band 0: nothing is written
            file.write(
                (heights if number == band else 0 * heights).astype(profile["dtype"]), number
            )
        for name, values in of_bands.items():
            setattr(file, name, values)
    return path


@pytest.mark.parametrize(
    ("dtype", "how"),
    [
        ("int16", {"compress": "lzw", "predictor": 2}),
        ("float32", {"compress": "lzw", "predictor": 3}),
        ("float64", {"compress": "deflate", "predictor": 3}),
        ("int32", {"compress": "zstd", "predictor": 2}),
        ("float32", {"compress": "lerc"}),
        ("uint16", {"compress": "lerc_zstd"}),
        ("float32", {"driver": "COG", "compress": "zstd"}),
        ("float32", {"BIGTIFF": "YES", "tiled": True, "blockxsize": 16, "blockysize": 16}),
    ],
)
def test_every_compression_is_read(dtype: str, how: dict[str, Any], tmp_path: Path) -> None:
    read = read_elevation_model(write(tmp_path / "dem.tif", dtype=dtype, **how))
    np.testing.assert_array_equal(read.heights, RAW[::-1])


@pytest.mark.parametrize(
    ("how", "scale", "offset"),
    [
        ({"dtype": "int16", "scales": (0.01,)}, 0.01, 0.0),
        ({"dtype": "int16", "scales": (0.05,), "offsets": (1_737_400.0,)}, 0.05, 1_737_400.0),
        ({"units": ("ft",)}, FOOT, 0.0),
        ({"units": ("US survey foot",)}, SURVEY_FOOT, 0.0),
        ({"units": ("cm",), "scales": (2.0,), "offsets": (50.0,)}, 0.02, 0.5),
        ({"units": ("Metres",)}, 1.0, 0.0),
        ({"crs": "EPSG:26917+6360"}, SURVEY_FOOT, 0.0),
        ({"crs": "EPSG:26917+5703"}, 1.0, 0.0),
    ],
)
def test_scale_offset_and_unit_are_applied(
    how: dict[str, Any], scale: float, offset: float, tmp_path: Path
) -> None:
    read = read_elevation_model(write(tmp_path / "dem.tif", **how))
    np.testing.assert_allclose(read.heights, (scale * RAW + offset)[::-1], rtol=1e-12)
    assert read.system == how.get("crs", "EPSG:32633").split("+")[0]


@pytest.mark.parametrize("offset", [0.0, -1_737_400.0, -3_396_190.0])
@pytest.mark.parametrize("radius", [1_737_400.0, 3_396_190.0])
@pytest.mark.parametrize("dtype", ["float32", "float64", "int32"])
def test_radii_are_heights(dtype: str, radius: float, offset: float, tmp_path: Path) -> None:
    stored = (radius + RAW / 8).astype(dtype)
    stored[0, 0] = -2_000_000_000  # stands for no height, but no tag says so
    path = write(tmp_path / "dem.tif", stored, dtype=dtype, offsets=(offset,))
    with rasterio.open(path) as file:
        expected = file.read(1).astype(np.float64) + file.offsets[0]
    expected[0, 0] = np.nan
    read = read_elevation_model(path)
    assert read.heights.dtype == np.float64
    np.testing.assert_array_equal(read.heights, expected[::-1])


@pytest.mark.parametrize("kind", ["inside", "beside", "alpha", "number", "nan"])
def test_cells_without_a_height(kind: str, tmp_path: Path) -> None:
    path, known = tmp_path / "dem.tif", RAW[3, 4] != RAW
    match kind:
        case "alpha":
            write(path, count=2, photometric="minisblack", alpha="yes")
            with rasterio.open(path, "r+") as file:
                file.write(255.0 * known, 2)
        case "number":
            write(path, nodata=float(RAW[3, 4]), dtype="int16", scales=(0.5,))
        case "nan":
            write(path, np.where(known, RAW, np.nan), nodata=np.nan)
        case _:
            write(path)
            with (
                rasterio.Env(GDAL_TIFF_INTERNAL_MASK=kind == "inside"),
                rasterio.open(path, "r+") as file,
            ):
                file.write_mask(known)
    read = read_elevation_model(path).heights
    np.testing.assert_array_equal(np.isfinite(read), known[::-1])
    assert np.nanmax(read) == (0.5 if kind == "number" else 1.0) * RAW[known].max()


def test_the_band_of_heights(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "dem.tif"
    write(path, count=3, band=2, descriptions=("slope", "Elevation", None))
    np.testing.assert_array_equal(read_elevation_model(path).heights, RAW[::-1])
    write(path, count=3, band=1)
    np.testing.assert_array_equal(read_elevation_model(path).heights, RAW[::-1])
    layer = np.random.default_rng(0).normal(size=(300, 20)).astype(np.float32)
    layer[7, 3] = np.nan
    grid = Grid((-4.25, 1000.5), 0.05, layer.shape)
    write_raster(path, grid, {"variance": 0 * layer, "elevation": layer})
    own = read_elevation_model(path)
    np.testing.assert_array_equal(own.heights, layer)
    assert (own.cell, own.system) == ((0.05, 0.05), "")
    assert own.corner == pytest.approx(grid.origin, abs=1e-9)
    assert capfd.readouterr() == ("", "")


FINE = rasterio.Affine(1e-5, 0.0, 14.3, 0.0, -1e-5, 36.1)


def test_what_is_no_elevation_model(tmp_path: Path) -> None:
    path = tmp_path / "dem.tif"
    for how, said in (
        ({"crs": "EPSG:2264+6360"}, "is not in metres (unit US survey foot)"),
        ({"crs": 'LOCAL_CS["site",UNIT["foot",0.3048]]'}, "is not in metres (unit foot)"),
        (
            {"crs": "EPSG:4326", "transform": FINE},
            "is in degrees; project it to metres first: gdal",
        ),
        ({"crs": "EPSG:4978"}, "is in geocentric coordinates"),
        ({"crs": "EPSG:3857"}, "is in Mercator, whose metres are not those of the ground"),
        ({"crs": "EPSG:32633+5715"}, "has depths, which count downwards"),
        ({"crs": "EPSG:26917+6358"}, "has depths, which count downwards"),
        ({"units": ("degrees Celsius",)}, "is in 'degrees Celsius', which is no known unit"),
        ({"scales": (0.0,)}, "the scale 0"),
        ({"count": 3, "dtype": "uint8"}, "has no heights: red"),
        ({"dtype": "complex64"}, "has no heights: complex64"),
    ):
        write(path, **how)
        assert_refused(lambda: read_elevation_model(path), str(path), said)
    huge = {"width": 60_000, "height": 60_000, "SPARSE_OK": True, "tiled": True, "BIGTIFF": "YES"}
    write(path, band=0, **huge)
    assert path.stat().st_size < 2_000_000
    assert_refused(lambda: read_elevation_model(path), str(path), "has 60000 x 60000 cells")
    cell, unread = (33550, "d", 3, (1.0, 1.0, 0.0), True), (42113, "s", 0, "none", True)
    tifffile.imwrite(path, RAW, metadata=None, extratags=[cell, unread])
    assert_refused(lambda: read_elevation_model(path), str(path), "no data is no number: 'none'")
    # What names other files is no GeoTIFF.
    path.write_text('<VRTDataset rasterXSize="2" rasterYSize="2"></VRTDataset>')
    assert_refused(lambda: read_elevation_model(path), str(path), "is no GeoTIFF that can be read")


def test_strips_that_unpack_to_too_much(tmp_path: Path) -> None:
    """GDAL makes cells of memory that nobody wrote of them."""
    path, rows = tmp_path / "dem.tif", np.random.default_rng(0).random((19, 8), np.float32)
    cell = (33550, "d", 3, (1.0, 1.0, 0.0), True)
    for number, padding in enumerate((0, 13)):
        unpacked = (rows[:16].tobytes(), rows[16:].tobytes() + bytes(32 * padding))
        strips = [zlib.compress(one, 0) for one in unpacked]
        tifffile.imwrite(
            path, iter(strips), shape=rows.shape, dtype=rows.dtype, rowsperstrip=16,
            compression="zlib", metadata=None, extratags=[cell],
        )  # fmt: skip
        if number == 0:
            np.testing.assert_array_equal(read_elevation_model(path).heights, rows[::-1])
        else:
            assert_refused(lambda: read_elevation_model(path), "strip 2 of 2 lies outside")
