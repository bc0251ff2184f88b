"""One cloud and one map of all submaps: the ground itself, without a seam."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.errors import InputError
from gpgrad_core.mapping.gradient_map import TerrainParams, fit_terrain
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam.merged_map import (
    BLEND,
    MergedMap,
    MergeParams,
    TiledPoints,
    TileStore,
    gather,
    merge_clouds,
    merge_maps,
)
from gpgrad_core.types import Submap
from tests.support.ground import Ground

GROUND = Ground.random(7, shortest=1.0, std=0.2)
TERRAIN = TerrainParams(length_scale=0.15, noise_std=0.02)
PARAMS = MergeParams(resolution=0.1, voxel=0.1)
POSES = {f"{k:03d}": Pose.from_planar(SE2(4.5 + 1.5 * k, 1.5, 0.4 * k), 5.0 - k) for k in range(3)}


def submaps() -> Iterator[Submap]:
    """Squares of ground, each in its own turned frame; they overlap by half and more."""
    rng = np.random.default_rng(3)
    for name, pose in POSES.items():
        xy = rng.uniform(-1.2, 1.2, (1200, 2)) + pose.translation[:2]
        z = GROUND.height(xy) + 0.02 * rng.standard_normal(len(xy))
        yield Submap.from_points(pose.inverse().apply(np.column_stack([xy, z])), name)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("merged")


@pytest.fixture(scope="module")
def gathered(folder: Path) -> TiledPoints:
    (folder / "tiles").mkdir()
    return gather(submaps(), POSES, TERRAIN, folder / "tiles", count=3, voxel=PARAMS.voxel)


@pytest.fixture(scope="module")
def merged(gathered: TiledPoints, folder: Path) -> MergedMap:
    (folder / "layers").mkdir()
    return merge_maps(gathered, TERRAIN, PARAMS, folder / "layers")


def test_the_map_is_the_ground(merged: MergedMap) -> None:
    elevation = merged.layers["elevation"]
    seen = np.isfinite(elevation)
    assert seen.sum() * PARAMS.resolution**2 > 10  # of the 5.4 m x 2.4 m that the submaps cover
    true = GROUND.height(merged.grid.positions).reshape(merged.grid.shape)
    assert np.sqrt(np.mean((elevation - true)[seen] ** 2)) < 0.02
    for layer in merged.layers.values():
        np.testing.assert_array_equal(np.isfinite(layer), seen)
    assert not merged.notes
    for start in merged.grid.origin:
        assert start / PARAMS.resolution == pytest.approx(round(start / PARAMS.resolution))


def test_there_is_no_seam(merged: MergedMap, gathered: TiledPoints) -> None:
    """One GP over all points at once says the same, at the edges of the tiles and elsewhere."""
    assert len(gathered.store.tiles) == 2  # they meet at 6 m
    rows = np.concatenate([gathered.store.read(tile) for tile in gathered.store.tiles])
    known = replace(TERRAIN, signal_std=gathered.signal_std, noise_model="file")
    whole = Submap.from_points(rows[:, :3], "whole", noise_std=rows[:, 3])
    fields = fit_terrain(whole, known).sample(merged.grid)
    seen = np.isfinite(merged.layers["elevation"])
    layers = {"elevation": fields.elevation}
    layers |= {"slope_x": fields.slope[..., 0], "slope_y": fields.slope[..., 1]}
    x = merged.grid.x
    side = gathered.store.side
    from_edge = np.abs(x - side * np.round(x / side))
    at_edge = np.broadcast_to(from_edge < BLEND * TERRAIN.length_scale, seen.shape)
    assert (at_edge & seen).sum() > 50
    # Their means differ, which shows where the ground seen ends, and in no other place.
    unsure = float(np.sqrt(np.mean(fields.variance[seen])))
    for name, most in (("elevation", 0.05 * unsure), ("slope_x", 0.01), ("slope_y", 0.01)):
        difference = merged.layers[name] - layers[name]
        for where in (seen & at_edge, seen):
            assert np.sqrt(np.mean(difference[where] ** 2)) < 1.2 * most
    steps = np.diff(merged.layers["elevation"] - layers["elevation"], axis=1)
    assert np.nanmax(np.abs(steps[:, at_edge[0, 1:]])) < 0.1 * unsure


def test_the_cloud_has_one_mean_a_voxel(gathered: TiledPoints) -> None:
    points = np.concatenate(list(merge_clouds(gathered, 0.1)))
    voxels = np.floor(points / 0.1).astype(int)
    assert len(np.unique(voxels, axis=0)) == len(points)
    assert 1000 < len(points) < 3 * 1200
    assert np.std(points[:, 2] - GROUND.height(points[:, :2])) < 0.03


def test_far_from_the_origin_nothing_is_lost(merged: MergedMap, tmp_path: Path) -> None:
    # By whole tiles and voxels, so that the cells are the same.
    far = np.array([6.0 * 60_000, -6.0 * 80_000, 0.0])
    moved = {name: Pose(pose.translation + far, pose.quaternion) for name, pose in POSES.items()}
    for name in ("tiles", "layers"):
        (tmp_path / name).mkdir()
    gathered = gather(submaps(), moved, TERRAIN, tmp_path / "tiles", count=3, voxel=PARAMS.voxel)
    there = merge_maps(gathered, TERRAIN, PARAMS, tmp_path / "layers")
    assert there.grid.shape == merged.grid.shape
    np.testing.assert_allclose(
        there.layers["elevation"], merged.layers["elevation"], atol=1e-4, equal_nan=True
    )


def test_lonely_points_are_told_of(tmp_path: Path) -> None:
    (tmp_path / "tiles").mkdir()
    (tmp_path / "layers").mkdir()
    rng = np.random.default_rng(0)
    xy = np.vstack([rng.uniform(0, 1, (400, 2)), [[40.05 + 0.1 * k, 0.0] for k in range(4)]])
    points = np.column_stack([xy, GROUND.height(xy)])
    # The lonely ones would be left out of a cloud that is read.
    cloud = replace(Submap.from_points(points[:400], "000"), points=points)
    poses = {"000": Pose.from_planar(SE2())}
    gathered = gather([cloud], poses, TERRAIN, tmp_path / "tiles", count=1, voxel=0.1)
    merged = merge_maps(gathered, TERRAIN, PARAMS, tmp_path / "layers")
    assert any("4 points near x 40.2 m" in note for note in merged.notes)
    assert np.isfinite(merged.layers["elevation"]).any()


def test_what_cannot_be_merged_is_refused(gathered: TiledPoints, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="submap 000 has no pose"):
        gather(submaps(), {}, TERRAIN, tmp_path, count=3, voxel=0.1)
    with pytest.raises(InputError, match="no submaps"):
        gather([], {}, TERRAIN, tmp_path, count=0, voxel=0.1)
    wide = replace(gathered, high=gathered.low + 1e5)
    with pytest.raises(
        InputError,
        match=r"merged map.* cells at 0.1 m, more than .*raise the resolution to 5[.\d]* m",
    ):
        merge_maps(wide, TERRAIN, PARAMS, tmp_path)


def test_tiles_give_back_what_they_were_given(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = rng.uniform(-10, 10, (500, 3))
    store = TileStore(tmp_path, 4.0, 3)
    store.add(rows[:200])
    store.add(rows[200:])
    back = np.concatenate([store.read(tile) for tile in store.tiles])
    np.testing.assert_array_equal(np.sort(back, axis=0), np.sort(rows, axis=0))
    around = store.read_around((0, -1), 1.5)
    x, y = rows[:, :2].T
    inside = (x >= -1.5) & (x < 5.5) & (y >= -5.5) & (y < 1.5)
    assert len(around) == inside.sum() > 0
    assert len(list(tmp_path.iterdir())) == len(store.tiles) == 36
