"""Maps as files: numbers come back as they went, pictures show what is where."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from PIL import Image, ImageSequence

from gpgrad_core.errors import InputError
from gpgrad_core.io.records.maps import draw_map, write_map
from gpgrad_core.types import GradientMap, Grid


def test_arrays_come_back_exactly(gradient_map: GradientMap, tmp_path: Path) -> None:
    write_map(tmp_path / "map.npz", gradient_map)
    with np.load(tmp_path / "map.npz") as back:
        assert set(back) == {
            "elevation",
            "variance",
            "slope_x",
            "slope_y",
            "gradient",
            "origin",
            "resolution",
        }
        np.testing.assert_array_equal(back["elevation"], gradient_map.elevation)
        np.testing.assert_array_equal(back["variance"], gradient_map.variance)
        np.testing.assert_array_equal(back["slope_x"], gradient_map.slope[..., 0])
        np.testing.assert_array_equal(back["slope_y"], gradient_map.slope[..., 1])
        np.testing.assert_array_equal(back["gradient"], gradient_map.gradient)
        np.testing.assert_array_equal(back["origin"], [-1.0, 2.0])
        assert back["resolution"] == 0.1


def test_the_same_map_is_the_same_file(gradient_map: GradientMap, tmp_path: Path) -> None:
    for ending in ("npz", "tif", "png"):
        for name in ("a", "b"):
            write_map(tmp_path / f"{name}.{ending}", gradient_map)
        first, second = (tmp_path / f"{name}.{ending}" for name in ("a", "b"))
        assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("ending", [".tif", ".tiff", ".TIF"])
def test_a_raster_is_north_up_with_its_place(
    gradient_map: GradientMap, tmp_path: Path, ending: str
) -> None:
    path = tmp_path / f"map{ending}"
    write_map(path, gradient_map)
    # Pillow is another's reader: it knows the tags, and of separate planes the first.
    with Image.open(path) as image:
        tags = dict(image.tag_v2)
        np.testing.assert_array_equal(
            np.asarray(image), gradient_map.elevation[::-1].astype(np.float32)
        )
        assert len(list(ImageSequence.Iterator(image))) == 1  # bands of one image, not pages
    assert tags[277] == 5  # samples a pixel
    assert tags[33550] == (0.1, 0.1, 0.0)
    # The outer corner of the top left cell.
    assert tags[33922] == pytest.approx((0.0, 0.0, 0.0, -1.05, 3.95, 0.0))
    names = re.findall(r'role="description">(\w+)<', tags[42112])
    assert names == ["elevation", "variance", "slope_x", "slope_y", "gradient"]


def test_a_raster_has_every_layer(gradient_map: GradientMap, tmp_path: Path) -> None:
    import tifffile  # noqa: PLC0415 - nothing else here reads separate planes

    write_map(tmp_path / "map.tif", gradient_map)
    bands = tifffile.imread(tmp_path / "map.tif")
    assert bands.dtype == np.float32
    assert bands.shape == (5, 20, 30)
    np.testing.assert_allclose(bands[1][::-1], gradient_map.variance, rtol=1e-6)
    np.testing.assert_allclose(bands[2], 0.5)
    np.testing.assert_allclose(bands[3], -0.25)


def test_a_picture_shows_the_terrain_and_leaves_the_unseen_grey(
    gradient_map: GradientMap, tmp_path: Path
) -> None:
    write_map(tmp_path / "map.png", gradient_map, name="000")
    picture = cv2.imread(str(tmp_path / "map.png"))
    assert picture is not None
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
    rising = GradientMap(grid, y, np.full_like(y, 1e-4), slope, 1.0, 0.3)
    picture = draw_map(rising)
    panel = picture[42 + 30 : 42 + 30 + 460, picture.shape[1] // 3 + 12 :][:, :460].astype(int)
    assert panel[10].sum() > panel[450].sum()  # viridis: high is bright


def test_flat_ground_can_be_drawn() -> None:
    grid = Grid((0.0, 0.0), 0.1, (5, 8))
    flat = GradientMap(grid, np.zeros((5, 8)), np.ones((5, 8)), np.zeros((5, 8, 2)), 1.0, 0.3)
    assert draw_map(flat).dtype == np.uint8


@pytest.mark.parametrize("ending", ["ply", "glb", "obj"])
def test_a_mesh_is_the_trusted_surface(
    gradient_map: GradientMap, tmp_path: Path, ending: str
) -> None:
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


def test_a_mesh_of_nothing_is_refused(gradient_map: GradientMap, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere on the map is the standard deviation"):
        write_map(tmp_path / "map.ply", gradient_map, max_std_ratio=1e-6)
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_drawn_or_named_is_refused(
    gradient_map: GradientMap, tmp_path: Path
) -> None:
    thin = GradientMap(
        Grid((0.0, 0.0), 0.1, (1, 2000)),
        np.zeros((1, 2000)),
        np.ones((1, 2000)),
        np.zeros((1, 2000, 2)),
        1.0,
        0.3,
    )
    with pytest.raises(InputError, match="too long and thin"):
        write_map(tmp_path / "map.png", thin)
    with pytest.raises(InputError, match=r"the ending must be one of \.npz"):
        write_map(tmp_path / "map.jpg", gradient_map)
    assert not list(tmp_path.iterdir())
