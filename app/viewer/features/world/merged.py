"""One terrain of all submaps: their maps, resampled on one lattice of the world and averaged.

Where several submaps see a cell of ground, its height is their mean with the weights of Kalman,
the inverse variances, which fall to zero where the mask of a map ends. So there is one height
everywhere: nothing lies in front of anything else, and no rim shows where the poses are right.
Tracks and outlines run over it, so that no hill hides them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import sqrt

import cv2
import numpy as np
from jaxtyping import Float, Int

from app.viewer.features.world.submaps import Terrain, WorldColor, submap_color
from app.viewer.scene.colors import Colors, colorize, hillshade, shade
from app.viewer.scene.layers import OVERLAP, Scale, Surfels, light_slopes
from app.viewer.scene.nodes import LinePoints
from app.viewer.session.layers import LAYERS, Layer
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.se2 import Pose

MAX_CELLS = 200_000
"""Of the whole terrain: what a browser draws and a network carries in a moment."""
FADE = 2.0
"""Width over which the weight of a map rises from its rim, in its length-scales."""
SEEN_FROM = 0.99999
"""A cell of the world counts if all four cells round it are trusted, but for rounding."""
LAYER_OF: dict[WorldColor, Layer] = {
    "elevation": "elevation",
    "gradient": "gradient",
    "deviation": "std",
}
ROW = np.int64(2**32)
"""Numbers of cells in one row of the lattice of the world."""
MOST_PIECES = 1500
"""Straight pieces of one way."""
REACH = 3
"""A way is level over so many of its pieces at either side, so that no bump pierces it."""
NOTHING_SEEN = np.zeros(0, np.int64), np.zeros((0, 9))


@dataclass(frozen=True, eq=False)
class MergedTerrain:
    """The ground that all submaps saw, as cells of a lattice of the world.

    A cell has one sighting of each submap that saw it, the owner's first. With its owner a cell
    moves when the poses change.
    """

    surfaces: Mapping[str, Terrain]  # what it was merged of, by the submaps' ids
    poses: Mapping[str, Pose]  # and at which poses
    resolution: float  # side of a cell [m]
    positions: Float[Array, "n 3"]  # middles of the cells in the world [m]
    std: Float[Array, "n"]  # standard deviation of their heights [m]
    slope: Float[Array, "n 2"]  # dz/dx and dz/dy in the world [m/m]
    # place among the names of the submap whose middle is nearest of those that saw the cell
    owner: Int[NDArray[np.intp], "n"]
    first: Int[NDArray[np.intp], "m"]  # where the sightings of each cell begin, and the last end
    seen_by: Int[NDArray[np.intp], "k"]  # which submap each sighting is of
    heights: Float[Array, "k"]  # what it alone says of the cell's height [m]
    deviations: Float[Array, "k"]  # with which standard deviation [m]

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(self.surfaces)

    def is_of(self, surfaces: Mapping[str, Terrain], poses: Mapping[str, Pose]) -> bool:
        """Whether the same surfaces, in the same order, at the same poses yield the same."""
        return list(self.surfaces.items()) == list(surfaces.items()) and all(
            self.poses[name].row == poses[name].row for name in surfaces
        )

    @property
    def area(self) -> float:
        return len(self.positions) * self.resolution**2

    @cached_property
    def disagreement(self) -> float:
        """Median range of the heights that submaps give the same cell [m]; NaN without any."""
        counts = np.diff(self.first)
        shared = counts > 1
        if not shared.any():
            return float("nan")
        starts = self.first[:-1]
        highest = np.maximum.reduceat(self.heights, starts)
        lowest = np.minimum.reduceat(self.heights, starts)
        return float(np.median((highest - lowest)[shared]))

    def cell_at(self, place: Float[Array, "2"]) -> int | None:
        """The cell at a place of the world [m]; None where there is none."""
        if not len(self.positions):
            return None
        off = np.abs(self.positions[:, :2] - place).max(axis=1)
        cell = int(np.argmin(off))
        return cell if off[cell] <= 0.51 * self.resolution else None  # a rounding beyond its half

    @cached_property
    def _numbers(self) -> Int[NDArray[np.int64], "n"]:
        column, row = np.rint(self.positions[:, :2] / self.resolution).astype(np.int64).T
        return row * ROW + column  # in order: `merge_at` sorts the cells

    def heights_near(self, places: Float[Array, "k 2"]) -> Float[Array, "k"]:
        """The highest of the nine cells round each place [m]; NaN where there is none."""
        column, row = np.rint(places / self.resolution).astype(np.int64).T
        highest, numbers = np.full(len(places), -np.inf), self._numbers
        for step_x, step_y in product((-1, 0, 1), repeat=2) if len(numbers) else ():
            wanted = (row + step_y) * ROW + column + step_x
            cells = np.minimum(np.searchsorted(numbers, wanted), len(numbers) - 1)
            heights = np.where(numbers[cells] == wanted, self.positions[cells, 2], -np.inf)
            highest = np.maximum(highest, heights)
        return np.where(np.isfinite(highest), highest, np.nan)

    def hit(self, origin: Float[Array, "3"], direction: Float[Array, "3"]) -> int | None:
        """The cell that a ray of the world hits first, from its origin [m] in any direction."""
        toward = direction / np.linalg.norm(direction)
        arm = self.positions - origin
        depth = arm @ toward
        aside = np.sum(arm * arm, axis=1) - depth**2
        hits = np.flatnonzero((aside < self.resolution**2) & (depth > 0))
        return int(hits[np.argmin(depth[hits])]) if len(hits) else None


def merge(surfaces: Mapping[str, Terrain], poses: Mapping[str, Pose]) -> MergedTerrain:
    """Merge the surfaces of all submaps that have a pose, on at most `MAX_CELLS` cells."""
    placed = {name: surface for name, surface in surfaces.items() if name in poses}
    sides = [surface.gradient_map.grid.resolution for surface in placed.values()]
    resolution = float(np.median(sides)) if sides else 1.0
    while True:
        merged = merge_at(placed, poses, resolution)
        excess = len(merged.positions) / MAX_CELLS
        if excess <= 1.0:
            return merged
        resolution *= 1.01 * sqrt(excess)


def merge_at(
    surfaces: Mapping[str, Terrain], poses: Mapping[str, Pose], resolution: float
) -> MergedTerrain:
    """Merge surfaces on a lattice of cells of such a side [m]."""
    sighted = [
        _sight(place, surface, poses[name], resolution)
        for place, (name, surface) in enumerate(surfaces.items())
    ]
    cells, rows = (np.concatenate(parts) for parts in zip(NOTHING_SEEN, *sighted, strict=True))
    order = np.lexsort((rows[:, 7], cells))
    rows, cells = rows[order], cells[order]
    starts = np.flatnonzero(np.r_[True, np.diff(cells) != 0]) if len(cells) else np.zeros(0, int)
    weight, precision = rows[:, 4], 1.0 / rows[:, 1]
    parts = np.column_stack([weight, precision, weight[:, None] * rows[:, [0, 2, 3]]])
    sums = np.add.reduceat(parts, starts, axis=0) if len(starts) else np.zeros((0, 5))
    height, slope_x, slope_y = sums[:, 2:].T / sums[:, 0]
    return MergedTerrain(
        surfaces,
        poses,
        resolution,
        np.column_stack([rows[starts][:, 5:7], height]),
        1.0 / np.sqrt(sums[:, 1]),
        np.column_stack([slope_x, slope_y]),
        rows[starts, 8].astype(np.intp),
        np.append(starts, len(rows)).astype(np.intp),
        rows[:, 8].astype(np.intp),
        rows[:, 0],
        np.sqrt(rows[:, 1]),
    )


def _sight(
    place: int, surface: Terrain, pose: Pose, resolution: float
) -> tuple[Int[NDArray[np.int64], "k"], Float[Array, "k 9"]]:
    """What one submap observed: the number of each cell on the lattice, and rows of values.

    These are height, variance, slope along x and y, weight, x, y, squared distance from the
    submap's middle, and the submap's place.
    """
    gradient_map, grid = surface.gradient_map, surface.gradient_map.grid
    trusted = gradient_map.trusted(surface.max_std_ratio) & np.isfinite(gradient_map.elevation)
    if not trusted.any():
        return NOTHING_SEEN
    # A tilted map is sheared by what its ground differs from level: some millimetres.
    middle = float(np.median(gradient_map.elevation[trusted]))
    turn = pose.rotation
    across = turn[:2, :2]
    shift = pose.translation[:2] + turn[:2, 2] * middle
    y, x = np.nonzero(trusted)
    rim = np.array([(grid.x[k], grid.y[m]) for k in (x.min(), x.max()) for m in (y.min(), y.max())])
    corners = (rim @ across.T + shift) / resolution
    low = np.floor(corners.min(axis=0)).astype(np.int64)
    columns, rows = (np.ceil(corners.max(axis=0)).astype(np.int64) - low + 1).tolist()
    back = np.linalg.inv(across)
    motion = np.column_stack(
        [
            back * (resolution / grid.resolution),
            (back @ (low * resolution - shift) - np.asarray(grid.origin)) / grid.resolution,
        ]
    )
    # With a rim of untrusted cells, so that the weight falls towards the edge of the grid too.
    depth = cv2.distanceTransform(np.pad(trusted, 1).astype(np.uint8), cv2.DIST_L2, 3)[1:-1, 1:-1]
    fade = np.minimum(depth * grid.resolution / (FADE * gradient_map.length_scale), 1.0)
    variance = np.maximum(gradient_map.variance, 1e-12)
    weight = np.where(trusted, fade / variance, 0.0)
    fields = (gradient_map.elevation - middle, variance, *np.moveaxis(gradient_map.slope, -1, 0))
    layers = np.stack([np.where(trusted, field, 0.0) for field in fields], axis=-1)

    def onto(layer: NDArray[np.floating]) -> NDArray[np.float32]:
        laid = cv2.warpAffine(
            layer.astype(np.float32),
            motion,
            (columns, rows),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=0.0,
        )
        return np.asarray(laid, dtype=np.float32)

    weights = onto(weight)
    seen = (onto(trusted.astype(np.float32)) >= SEEN_FROM) & (weights > 0)
    if not seen.any():
        return NOTHING_SEEN
    row, column = np.nonzero(seen)
    weights = weights[seen].astype(np.float64)
    height, variances, slope_x, slope_y = onto(layers)[seen].astype(np.float64).T
    world = (np.column_stack([column, row]) + low) * resolution
    local = (world - shift) @ back.T
    height = np.column_stack([local, height + middle]) @ turn[2] + pose.translation[2]
    normals = np.column_stack([-slope_x, -slope_y, np.ones_like(slope_x)]) @ turn.T
    slopes = -normals[:, :2] / normals[:, 2:]
    off = world - world.mean(axis=0)
    cells = (row + low[1]) * ROW + (column + low[0])
    return cells, np.column_stack(
        [height, variances, slopes, weights, world, (off**2).sum(axis=1), np.full(len(row), place)]
    )


def world_scale(terrain: MergedTerrain, color: WorldColor) -> Scale | None:
    """Choose the range of the colours; None where each submap has its own colour."""
    if color == "submap" or not len(terrain.positions):
        return None
    style = LAYERS[LAYER_OF[color]]
    # The outermost hundredth at either side, such as a single stone, takes the end colours.
    low, high = (float(end) for end in np.percentile(_values(terrain, color), (1, 99)))
    low = 0.0 if style.from_zero else low
    # Muted ground, from which the colours of tracks and closures stand out.
    color_map = "regolith" if color == "elevation" else style.color_map
    return Scale(style.label, style.unit, color_map, low, high)


def pieces(
    terrain: MergedTerrain, color: WorldColor, scale: Scale | None, first: int = 0
) -> dict[str, Surfels]:
    """Colour the cells, and give each submap those that it owns, in its own frame: they move."""
    colors = _colors(terrain, color, scale, first)
    order = np.argsort(terrain.owner, kind="stable")
    ends = np.searchsorted(terrain.owner[order], np.arange(len(terrain.names) + 1))
    made: dict[str, Surfels] = {}
    for name, start, stop in zip(terrain.names, ends[:-1], ends[1:], strict=True):
        own, pose = order[start:stop], terrain.poses[name]
        local = (terrain.positions[own] - pose.translation) @ pose.rotation
        made[name] = Surfels(local.astype(np.float32), colors[own], OVERLAP * terrain.resolution)
    return made


def _colors(terrain: MergedTerrain, color: WorldColor, scale: Scale | None, first: int) -> Colors:
    if scale is None:
        tints = [submap_color(first + place) for place in range(len(terrain.names))]
        colors = np.array(tints, dtype=np.uint8).reshape(-1, 3)[terrain.owner]
    else:
        colors = colorize(_values(terrain, color), scale.low, scale.high, scale.color_map)
    if color == "deviation":
        return colors
    relief = light_slopes(terrain.slope)
    return shade(colors, hillshade((terrain.slope - np.array(relief.lean)) * relief.times))


def _values(terrain: MergedTerrain, color: WorldColor) -> Float[Array, "n"]:
    """The value that the colours show, by cell, in the unit of the layer's style."""
    if color == "gradient":
        return np.hypot(terrain.slope[:, 0], terrain.slope[:, 1])
    return terrain.std if color == "deviation" else terrain.positions[:, 2]


@dataclass(frozen=True, eq=False)
class Drape:
    """How a way lies on the ground; 2.5 is halfway between the third and the fourth vertex."""

    at: Float[Array, "m"]
    rise: Float[Array, "m"]  # above the straight way there [m]
    num_places: int

    def over(self, places: Float[Array, "n 3"]) -> Float[Array, "m 3"]:
        """The way through the same places, wherever they have moved since [m]."""
        return _along(places, self.at) + self.rise[:, None] * np.array([0.0, 0.0, 1.0])


def drape(places: Float[Array, "n 3"], terrain: MergedTerrain | None, margin: float) -> Drape:
    """Drape the way through places of the world over its ground, with a margin above it [m].

    Where there is no ground, it goes on as far above or below the places as beside it.
    """
    if terrain is None or len(places) < 2:
        return Drape(np.arange(float(len(places))), np.full(len(places), margin), len(places))
    steps = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1)
    step = max(2 * terrain.resolution, float(steps.sum()) / MOST_PIECES)
    counts = np.maximum(np.ceil(steps / step).astype(int), 1)
    at = np.concatenate([k + np.arange(count) / count for k, count in enumerate(counts)])
    at = np.append(at, len(places) - 1.0)
    straight = _along(places, at)
    rise = terrain.heights_near(straight[:, :2]) - straight[:, 2]
    seen = np.flatnonzero(np.isfinite(rise))
    rise = np.interp(np.arange(len(at)), seen, rise[seen]) if len(seen) else 0.0 * at
    # The highest near each place, and of those the mean: smooth, and nowhere below the ground.
    near = np.lib.stride_tricks.sliding_window_view
    for reduce in (np.max, np.mean):
        rise = reduce(near(np.pad(rise, REACH, mode="edge"), 2 * REACH + 1), axis=1)
    return Drape(at, rise + margin, len(places))


def _along(places: Float[Array, "n 3"], at: Float[Array, "m"]) -> Float[Array, "m 3"]:
    numbers = np.arange(len(places))
    return np.column_stack([np.interp(at, numbers, column) for column in places.T])


def lines_of(way: Float[Array, "m 3"], dash: float = 0.0) -> LinePoints:
    """Join a way's places, all of them or as dashes of a length [m]."""
    lines = np.stack([way[:-1], way[1:]], axis=1).astype(np.float32)
    if dash <= 0.0 or not len(lines):
        return lines
    lengths = np.linalg.norm(lines[:, 1, :2] - lines[:, 0, :2], axis=1)
    middles = np.cumsum(lengths) - lengths / 2
    return lines[(middles % (1.6 * dash)) < dash]
