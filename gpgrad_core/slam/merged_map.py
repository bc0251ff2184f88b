"""One cloud and one elevation map of all submaps in bounded memory: one file per tile of ground."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from typing_extensions import Doc

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.gp.cloud import thin_dense
from gpgrad_core.ground import submap_of_cloud
from gpgrad_core.io.clouds import voxel_means
from gpgrad_core.mapping.gradient_map import TerrainParams, fit_terrain, sample_rows, signal_std_of
from gpgrad_core.params import Bounds, check_bounds
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Array, Grid, Submap

Floats = NDArray[np.float32]
Tile = tuple[int, int]
"""Index of a square of ground along x and y."""
AROUND = tuple(product((-1, 0, 1), repeat=2))

TILE_SIDE = 40.0
"""Side of a tile, in length-scales."""
BLEND = 2.0
"""Width on either side of an edge over which the maps of two tiles blend, in length-scales."""
HALO = 6.0
"""Width [length-scales] beyond the blend over which a tile has points; those further away do not
matter."""
MAX_CELLS = 400_000_000
"""Largest number of cells of a merged map; its layers lie on disk, up to 1.6 GB each."""
LAYERS = ("elevation", "variance", "slope_x", "slope_y")
ROWS_AT_ONCE = 256


@dataclass(frozen=True)
class MergeParams:
    """How all submaps become one cloud and one map."""

    resolution: Annotated[
        float,
        Bounds(0.005, 10.0, 0.005, "m", slider=(0.02, 0.5)),
        Doc("Side of a cell of the merged map."),
    ] = 0.05
    voxel: Annotated[
        float,
        Bounds(0.001, 10.0, 0.005, "m", slider=(0.01, 0.5)),
        Doc(
            "All points of the merged cloud within one cube of this side are replaced by their "
            "mean."
        ),
    ] = 0.05
    max_std_ratio: Annotated[
        float,
        Bounds(0.001, 1.0, 0.01, "", slider=(0.05, 1.0)),
        Doc("Cells whose standard deviation is above this share of signal_std are left empty."),
    ] = 0.3

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, eq=False)
class TileStore:
    """Rows of numbers that begin with x and y [m], one file per square tile."""

    folder: Path  # where the files are; the caller removes it
    side: float  # side of a tile [m]
    columns: int  # number of values in a row

    def add(self, rows: Float[Array, "n columns"]) -> None:
        tiles = np.floor(rows[:, :2] / self.side).astype(np.int64)
        order = np.lexsort((tiles[:, 0], tiles[:, 1]))
        rows, tiles = rows[order], tiles[order]
        starts = np.flatnonzero(np.r_[True, np.any(np.diff(tiles, axis=0) != 0, axis=1)])
        for start, stop in zip(starts, [*starts[1:], len(rows)], strict=True):
            with self._file((int(tiles[start, 0]), int(tiles[start, 1]))).open("ab") as file:
                file.write(np.ascontiguousarray(rows[start:stop]).tobytes())

    @property
    def tiles(self) -> list[Tile]:
        """The tiles that hold rows, sorted by y and then by x."""
        names = [file.stem.split("_") for file in self.folder.glob("*.rows")]
        return sorted(((int(x), int(y)) for x, y in names), key=_by_row)

    def read(self, tile: Tile) -> Float[Array, "n columns"]:
        """Read a tile's rows, in the order in which they were added."""
        file = self._file(tile)
        if not file.exists():
            return np.empty((0, self.columns))
        return np.fromfile(file, dtype=np.float64).reshape(-1, self.columns)

    def read_around(self, tile: Tile, margin: float) -> Float[Array, "n columns"]:
        """Read the rows in a tile and within a margin [m] around it, at most a tile's side."""
        x, y = tile
        low = np.array([x, y]) * self.side - margin
        high = (np.array([x, y]) + 1) * self.side + margin
        rows = np.concatenate([self.read((x + i, y + j)) for i, j in AROUND])
        inside = np.all((rows[:, :2] >= low) & (rows[:, :2] < high), axis=1)
        return rows[inside]

    def neighbourhoods(self) -> Iterator[Tile]:
        """Yield the tiles that hold rows, and all tiles next to them."""
        yield from sorted({(x + i, y + j) for x, y in self.tiles for i, j in AROUND}, key=_by_row)

    def _file(self, tile: Tile) -> Path:
        return self.folder / f"{tile[0]}_{tile[1]}.rows"


def _by_row(tile: Tile) -> Tile:
    return tile[1], tile[0]


@dataclass(frozen=True, eq=False)
class TiledPoints:
    """The points of all submaps in the world, sorted into tiles."""

    store: TileStore  # rows of x, y, z and the standard deviation of z [m]
    low: Float[Array, "2"]  # lowest x and y of all points [m]
    high: Float[Array, "2"]  # highest x and y of all points [m]
    # prior standard deviation of the terrain [m]: the median over the submaps, unless the
    # parameters give it
    signal_std: float


@dataclass(frozen=True, eq=False)
class MergedMap:
    """An elevation map of all submaps; its layers are memory-mapped files."""

    grid: Grid  # the cells in the world; their centres lie on whole multiples of the resolution
    # ``elevation`` [m], ``variance`` [m²], ``slope_x``, ``slope_y`` and ``gradient`` [m/m], each
    # (rows, columns), as in a `GradientMap`; NaN where the elevation is not known
    layers: Mapping[str, Floats]
    notes: tuple[str, ...] = ()  # what had to be left out, one line each


def gather(
    submaps: Iterable[Submap],
    poses: Mapping[str, Pose],
    terrain: TerrainParams,
    folder: Path,
    *,
    count: int,
    voxel: float,
    georeference: Callable[[Float[Array, "n 3"]], Float[Array, "n 3"]] | None = None,
    progress: Progress = silent,
) -> TiledPoints:
    """Sort the points of all submaps into tiles of the world, iterating the submaps once.

    Poses are ``T_world_submap`` by id. Tiles are a whole number of voxels [m], sized by the
    length-scale. `georeference` turns points of the world (n, 3) into the map coordinates [m] of
    cloud and map. The caller removes the folder, which must be empty.

    Raises:
        InputError: If there are no submaps, one has no pose, or its noise is not known.
    """
    side = voxel * np.ceil(TILE_SIDE * terrain.length_scale / voxel)
    store = TileStore(folder, float(side), 4)
    low, high, signals = np.full(2, np.inf), np.full(2, -np.inf), list[float]()
    for k, submap in enumerate(submaps):
        if submap.id not in poses:
            raise InputError(f"submap {submap.id} has no pose: it cannot be put into the map")
        rows = sample_rows(submap, terrain.max_points)
        points = poses[submap.id].apply(submap.points[rows])
        if georeference is not None:
            points = georeference(points)
        noise = terrain.noise.ordinary(submap)[rows]
        store.add(np.column_stack([points, noise]))
        low = np.minimum(low, points[:, :2].min(axis=0))
        high = np.maximum(high, points[:, :2].max(axis=0))
        signals.append(signal_std_of(submap.points, terrain))
        progress((k + 1) / count)
    if not signals:
        raise InputError("there are no submaps to make a map of")
    return TiledPoints(store, low, high, float(np.median(signals)))


def merge_clouds(
    gathered: TiledPoints, voxel: float, progress: Progress = silent
) -> Iterable[Float[Array, "n 3"]]:
    """Yield the means of all voxels [m], tile by tile; no voxel lies in two tiles."""
    tiles = gathered.store.tiles
    for k, tile in enumerate(tiles):
        yield voxel_means(gathered.store.read(tile)[:, :3], voxel)
        progress((k + 1) / len(tiles))


def merge_maps(
    gathered: TiledPoints,
    terrain: TerrainParams,
    params: MergeParams,
    folder: Path,
    progress: Progress = silent,
) -> MergedMap:
    """Infer the elevation of all the ground, Eqs. (2)-(5), tile by tile without seams.

    The GP of each tile also sees points around the tile, and its map blends into its neighbours',
    so the elevation is smooth across an edge. The caller removes the folder with the layers' files.

    Raises:
        InputError: If the map would be too large.
    """
    grid = Grid.covering(
        np.stack([gathered.low, gathered.high]),
        params.resolution,
        name="the merged map",
        max_cells=MAX_CELLS,
        on_multiples=True,
    )
    sums = {name: _on_disk(folder / f"{name}.npy", grid.shape) for name in (*LAYERS, "weight")}
    fixed = replace(
        terrain,
        signal_std=gathered.signal_std,
        noise_model="file",
        noise_factor=1.0,
        max_points=None,
    )
    notes: list[str] = []
    store = _thinned(gathered, terrain.length_scale, folder / "means")
    tiles = list(store.neighbourhoods())
    for k, tile in enumerate(tiles):
        report = part(progress, 0.95 * k / len(tiles), 0.95 * (k + 1) / len(tiles))
        notes += _add_tile(store, tile, grid, fixed, sums, report)
        report(1.0)
    _settle(sums, params.max_std_ratio * gathered.signal_std)
    progress(1.0)
    layers = {name: sums[name] for name in LAYERS} | {"gradient": sums["weight"]}
    return MergedMap(grid, layers, tuple(notes))


def _thinned(gathered: TiledPoints, length_scale: float, folder: Path) -> TileStore:
    """Replace points by the means of small cells in all tiles that this at least halves."""
    folder.mkdir()
    thinned = TileStore(folder, gathered.store.side, gathered.store.columns)
    for tile in gathered.store.tiles:
        rows = gathered.store.read(tile)
        means, noise_std = thin_dense(rows[:, :3], rows[:, 3], length_scale, gathered.signal_std)
        thinned.add(np.column_stack([means, noise_std]))
    return thinned


def _on_disk(path: Path, shape: tuple[int, int]) -> Floats:
    layer = np.lib.format.open_memmap(path, mode="w+", dtype=np.float32, shape=shape)
    if hasattr(os, "posix_fallocate"):
        # Without it a full disk would end the process by a signal when a page is written to.
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
    return layer


def _add_tile(
    store: TileStore,
    tile: Tile,
    grid: Grid,
    terrain: TerrainParams,
    sums: Mapping[str, Floats],
    progress: Progress,
) -> list[str]:
    """Fit one tile and add its map with fading edges; gives a note if nothing can be inferred."""
    blend = BLEND * terrain.length_scale
    low = np.array(tile) * store.side
    window = [_cells(grid, axis, low[axis], low[axis] + store.side, blend) for axis in (0, 1)]
    columns, rows = window
    if columns.start >= columns.stop or rows.start >= rows.stop:
        return []
    near = store.read_around(tile, blend)
    if not len(near):
        return []
    nearby = store.read_around(tile, blend + HALO * terrain.length_scale)
    # In the tile's own frame: with the large coordinates of a national grid, sums lose digits.
    points = nearby[:, :3] - np.array([*low, 0.0])
    try:
        submap = submap_of_cloud(points, "the merged map", noise_std=nearby[:, 3], ground="all")
    except InputError:  # fewer than three points, or all on one line
        middle = near[:, :2].mean(axis=0)
        return [
            f"{len(near)} point{'' if len(near) == 1 else 's'} near x {middle[0]:z.1f} m, "
            f"y {middle[1]:z.1f} m span no ground: there the merged map is empty"
        ]
    posterior = fit_terrain(submap, terrain, progress)
    origin = (float(grid.x[columns.start] - low[0]), float(grid.y[rows.start] - low[1]))
    shape = (rows.stop - rows.start, columns.stop - columns.start)
    fields = posterior.sample(Grid(origin, grid.resolution, shape))
    weight = np.outer(
        _fading(grid.y[rows], low[1], store.side, blend),
        _fading(grid.x[columns], low[0], store.side, blend),
    )
    layers = (fields.elevation, fields.variance, fields.slope[..., 0], fields.slope[..., 1])
    for name, layer in zip(LAYERS, layers, strict=True):
        sums[name][rows, columns] += (weight * layer).astype(np.float32)
    sums["weight"][rows, columns] += weight.astype(np.float32)
    return []


def _cells(grid: Grid, axis: int, low: float, high: float, margin: float) -> slice:
    """Find columns (axis 0) or rows (axis 1) with centres from low to high, and a margin [m]."""
    start = np.ceil((low - margin - grid.origin[axis]) / grid.resolution)
    stop = np.floor((high + margin - grid.origin[axis]) / grid.resolution) + 1
    count = grid.shape[1 - axis]
    return slice(int(np.clip(start, 0, count)), int(np.clip(stop, 0, count)))


def _fading(
    positions: Float[Array, "n"], low: float, side: float, blend: float
) -> Float[Array, "n"]:
    """The weight of a tile along one axis; those of neighbouring tiles add up to 1."""
    rising, falling = (
        np.clip((distance + blend) / (2 * blend), 0.0, 1.0)
        for distance in (positions - low, low + side - positions)
    )
    # Level at both ends, so that the slope has no seam either.
    rising, falling = (share * share * (3 - 2 * share) for share in (rising, falling))
    return rising * falling


def _settle(sums: Mapping[str, Floats], most_std: float) -> None:
    """Turn weighted sums into means, by rows, and empty the unknown cells."""
    weight = sums["weight"]
    for start in range(0, len(weight), ROWS_AT_ONCE):
        rows = slice(start, start + ROWS_AT_ONCE)
        total = weight[rows]
        with np.errstate(divide="ignore", invalid="ignore"):
            means = {name: sums[name][rows] / total for name in LAYERS}
            empty = ~(np.sqrt(means["variance"]) <= most_std)
        for name in LAYERS:
            means[name][empty] = np.nan
            sums[name][rows] = means[name]
        weight[rows] = np.hypot(means["slope_x"], means["slope_y"])
