"""Maps and fits as files, whole or not at all: numbers come back, pictures show what is where."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
import trimesh
from PIL import Image, ImageSequence

from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.records.files import check_output, replacing
from gpgrad_core.io.records.maps import draw_map, layers_of, write_fitted, write_map
from gpgrad_core.mapping.fitting import FitResult
from gpgrad_core.mapping.gradient_map import TerrainParams
from gpgrad_core.params import read_parameters
from gpgrad_core.types import GradientMap, Grid
from tests.support.refusal import assert_refused


@pytest.fixture
def gradient_map() -> GradientMap:
    """Plane z = 0.5 x - 0.25 y of 30 x 20 cells, unseen on its right."""
    grid = Grid((-1.0, 2.0), 0.1, (20, 30))
    x, y = np.meshgrid(grid.x, grid.y)
    slope = np.broadcast_to([0.5, -0.25], (20, 30, 2)).copy()
    variance = np.where(x < 1.0, 0.0001, 0.36)
    return GradientMap(grid, 0.5 * x - 0.25 * y, variance, slope, 0.6, 0.3)


def test_arrays_come_back_exactly(gradient_map: GradientMap, tmp_path: Path) -> None:
    write_map(tmp_path / "map.npz", gradient_map)
    with np.load(tmp_path / "map.npz") as back:
        np.testing.assert_equal(
            dict(back), layers_of(gradient_map) | {"origin": [-1.0, 2.0], "resolution": 0.1}
        )
        np.testing.assert_array_equal(back["slope_y"], gradient_map.slope[..., 1])


def test_the_same_map_is_the_same_file(gradient_map: GradientMap, tmp_path: Path) -> None:
    for ending in ("npz", "tif", "png"):
        first, second = (tmp_path / f"{name}.{ending}" for name in ("a", "b"))
        write_map(first, gradient_map)
        write_map(second, gradient_map)
        assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("ending", [".tif", ".tiff", ".TIF"])
def test_a_raster_is_placed_north_up(
    gradient_map: GradientMap, tmp_path: Path, ending: str
) -> None:
    path = tmp_path / f"map{ending}"
    write_map(path, gradient_map)
    # Pillow is another's reader: it knows the tags, and of separate planes the first.
    with Image.open(path) as image:
        assert len(list(ImageSequence.Iterator(image))) == 1  # bands of one image, not pages
    with rasterio.open(path) as raster:
        assert raster.descriptions == tuple(layers_of(gradient_map))
        assert raster.dtypes == ("float32",) * 5
        for band, layer in zip(raster.read(), layers_of(gradient_map).values(), strict=True):
            np.testing.assert_array_equal(band, layer[::-1].astype(np.float32))
        # The outer corner of the top left cell.
        assert raster.transform == pytest.approx((0.1, 0, -1.05, 0, -0.1, 3.95, 0, 0, 1))


def test_a_picture_shows_the_terrain_and_leaves_the_unseen_grey(
    gradient_map: GradientMap, tmp_path: Path
) -> None:
    write_map(tmp_path / "map.png", gradient_map, name="000")
    picture = cv2.imread(str(tmp_path / "map.png"))
    np.testing.assert_array_equal(picture, draw_map(gradient_map, "000"))
    # All is seen if the mask lets all pass, and nothing is grey then.
    grey = np.array([205, 205, 205])
    all_seen = draw_map(gradient_map, "000", max_std_ratio=1.0)
    masked_cells = np.sum(np.all(picture == grey, axis=-1))
    assert masked_cells > 5 * 1000
    assert np.sum(np.all(all_seen == grey, axis=-1)) < masked_cells / 100
    # The plane rises along x, and viridis is brighter where it is higher.
    elevation_panel = all_seen[42 + 30 :, picture.shape[1] // 3 + 12 :][:300, :460].astype(int)
    brightness = elevation_panel.sum(axis=(0, 2))
    assert brightness[440] > brightness[20]


def test_a_picture_has_the_lowest_y_at_the_bottom() -> None:
    grid = Grid((0.0, 0.0), 0.1, (20, 20))
    _, y = np.meshgrid(grid.x, grid.y)
    slope = np.stack([np.zeros_like(y), np.ones_like(y)], axis=-1)
    picture = draw_map(GradientMap(grid, y, np.full_like(y, 1e-4), slope, 1.0, 0.3))
    panel = picture[42 + 30 : 42 + 30 + 460, picture.shape[1] // 3 + 12 :][:, :460].astype(int)
    assert panel[10].sum() > panel[450].sum()  # viridis: high is bright


def flat(rows: int, columns: int) -> GradientMap:
    shape = (rows, columns)
    grid = Grid((0.0, 0.0), 0.1, shape)
    return GradientMap(grid, np.zeros(shape), np.ones(shape), np.zeros((*shape, 2)), 1.0, 0.3)


@pytest.mark.parametrize("ending", ["ply", "glb", "obj"])
def test_a_mesh_is_what_is_trusted(gradient_map: GradientMap, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"map.{ending}"
    write_map(path, gradient_map, max_std_ratio=1.0)
    mesh = trimesh.load_mesh(path)
    grid = gradient_map.grid
    rows, columns = grid.shape
    assert len(mesh.faces) == 2 * (rows - 1) * (columns - 1)
    heights = dict(
        zip(map(tuple, np.round(grid.positions, 4)), gradient_map.elevation.ravel(), strict=True)
    )
    for x, y, z in mesh.vertices[::7]:
        assert z == pytest.approx(heights[round(x, 4), round(y, 4)], abs=1e-4)
    assert (mesh.face_normals[:, 2] > 0).all()


def test_what_cannot_be_drawn_is_refused(gradient_map: GradientMap, tmp_path: Path) -> None:
    assert draw_map(flat(5, 8)).dtype == np.uint8
    for name, drawn, ratio, rule in (
        ("map.ply", gradient_map, 1e-6, "nowhere on the map is the standard deviation"),
        ("map.png", flat(1, 2000), 0.3, "too long and thin"),
        ("map.jpg", gradient_map, 0.3, "the ending must be one of .npz"),
    ):
        path = tmp_path / name
        assert_refused(lambda: write_map(path, drawn, max_std_ratio=ratio), rule)  # noqa: B023
    assert not list(tmp_path.iterdir())


def fitted(params: TerrainParams) -> FitResult:
    return FitResult(params, 1.0, 2.0, 8000, 12, ("000", "001"))


@pytest.mark.parametrize(
    "params",
    [
        TerrainParams(2.0, 0.0123456, signal_std=1e-3),
        TerrainParams(0.4, noise_model="measured", noise_factor=1.25, signal_std=0.2),
        TerrainParams(0.4, 0.01, noise_model="range", noise_growth=5e-5, signal_std=0.2),
        TerrainParams(0.4, 0.01, noise_model="file"),
    ],
)
def test_what_a_fit_found_is_read_as_parameters(tmp_path: Path, params: TerrainParams) -> None:
    write_fitted(tmp_path / "fit.toml", fitted(params))
    read = read_parameters(tmp_path / "fit.toml", PipelineParams()).map.guessed.terrain
    for name in ("length_scale", "noise_model", "noise_growth", "noise_factor", "signal_std"):
        assert getattr(read, name) == getattr(params, name), name
    if params.noise_model in ("constant", "range"):
        assert read.noise_std == params.noise_std
    assert "8000 points of submaps 000, 001" in (tmp_path / "fit.toml").read_text()


def test_a_file_is_replaced_when_the_block_has_succeeded(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with replacing(path) as unfinished:
        unfinished.write_text("old")
        assert unfinished.suffix == path.suffix
        assert not path.exists()
    assert path.read_text() == "old"

    def fail() -> None:
        with replacing(path) as unfinished:
            unfinished.write_text("half")
            raise RuntimeError("full disk")

    with pytest.raises(RuntimeError, match="full disk"):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_where_no_file_can_be_is_said(tmp_path: Path) -> None:
    for path, endings, rule in (
        (tmp_path / "missing" / "a.json", (), "missing; make it first"),
        (tmp_path, (), "is a folder"),
        (tmp_path / "a.txt", (".npz", ".png"), "a.txt: the ending must be one of .npz, .png"),
    ):
        assert_refused(lambda: check_output(path, endings), rule)  # noqa: B023
    assert check_output(tmp_path / "a.PNG", (".png",)) == tmp_path / "a.PNG"


def test_a_mesh_far_from_its_origin_is_refused_where_numbers_have_32_bits(
    gradient_map: GradientMap, tmp_path: Path
) -> None:
    far = replace(gradient_map.grid, origin=(5e5, 4.2e6))
    gradient_map = replace(gradient_map, grid=far)
    for ending in (".ply", ".glb"):
        path = tmp_path / f"map{ending}"
        assert_refused(partial(write_map, path, gradient_map), "32 bits", "to 0.5 m only")
        assert not path.exists()
    write_map(tmp_path / "map.obj", gradient_map)
    first = trimesh.load(tmp_path / "map.obj", process=False).vertices[0]
    np.testing.assert_allclose(first[:2], far.origin, atol=1e-6)
