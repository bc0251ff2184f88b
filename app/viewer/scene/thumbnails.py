"""Small pictures of submaps from above: of one, and of both of a pair beside each other."""

import numpy as np
from jaxtyping import Bool, Float, UInt8

from app.viewer.scene.colors import colorize, hillshade, shade
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection import PipelineParams
from gpgrad_core.mapping.gradient_map import LENGTH_SCALE, MapParams
from gpgrad_core.methods.smoothed import smoothed_map
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, Submap

SIDE = 72
"""Of the picture of one map of a pair [pixels]."""
GAP = 4
PORTRAIT = 40
"""Side of the picture of one submap [pixels], and the cells of its grid."""


def portrait(submap: Submap) -> UInt8[NDArray[np.uint8], "rows columns 4"]:
    """Draw a submap in the colours of the gradient over relief; an InputError without a grid."""
    side = float(np.ptp(submap.corners, axis=0).max())
    resolution = min(max(side / PORTRAIT, 0.005), 10.0)  # [m]; those of a map lie between these
    length_scale = min(max(2.5 * resolution, LENGTH_SCALE.low), LENGTH_SCALE.high)
    numbers = MapParams(resolution=resolution, length_scale=length_scale, noise_std=0.01)
    made = smoothed_map(submap, PipelineParams(map=numbers))
    inside, cells = _cells(made, _window(made.grid.corners, PORTRAIT), 0.999)
    slopes, gradient = made.slope[cells].astype(np.float64), made.gradient[cells]
    picture = np.zeros((PORTRAIT * PORTRAIT, 4), np.uint8)
    if len(gradient):
        steep = max(float(np.quantile(gradient, 0.98)), 1e-9)
        colors = colorize(gradient.astype(np.float64), 0.0, steep, "ember")
        picture[inside, :3] = shade(colors, hillshade(slopes))
        picture[inside, 3] = 255
    return picture.reshape(PORTRAIT, PORTRAIT, 4)[::-1]


def thumbnail(
    query: GradientMap, database: GradientMap, T_database_query: SE2 | None, max_std_ratio: float
) -> UInt8[NDArray[np.uint8], "rows columns 4"]:
    """Draw the query's gradient on the left and the database's on the right.

    With a motion both show one window, in the database's frame; without one each has
    its own. What the variance mask rejects stays transparent.
    """
    if T_database_query is None:
        left = _sample(query, _window(query.grid.corners, SIDE), max_std_ratio)
        window = _window(database.grid.corners, SIDE)
    else:
        # Over both, so that neither is cut however little they have in common.
        laid = T_database_query.apply(query.grid.corners)
        window = _window(np.concatenate([laid, database.grid.corners]), SIDE)
        left = _sample(query, T_database_query.inverse().apply(window), max_std_ratio)
    right = _sample(database, window, max_std_ratio)
    slopes = np.concatenate([left[np.isfinite(left)], right[np.isfinite(right)]])
    high = float(np.quantile(slopes, 0.98)) if len(slopes) else 1.0
    picture = np.zeros((SIDE, 2 * SIDE + GAP, 4), np.uint8)
    for values, start in ((left, 0), (right, SIDE + GAP)):
        tile = np.zeros((SIDE * SIDE, 4), np.uint8)
        seen = np.isfinite(values)
        tile[seen, :3] = colorize(values[seen], 0.0, max(high, 1e-9), "ember")
        tile[seen, 3] = 255
        # North is up: the first row of a picture has the highest y.
        picture[:, start : start + SIDE] = tile.reshape(SIDE, SIDE, 4)[::-1]
    return picture


def _window(corners: Float[Array, "k 2"], side: int) -> Float[Array, "n 2"]:
    """Place the pixels of a square over points (n, 2) [m]: rows of rising y, as wide as needed."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    steps = ((np.arange(side) + 0.5) / side - 0.5) * float((high - low).max())
    x, y = np.meshgrid(*(steps + 0.5 * (low + high)[k] for k in (0, 1)))
    return np.column_stack([x.ravel(), y.ravel()])


def _cells(
    gradient_map: GradientMap, positions: Float[Array, "n 2"], max_std_ratio: float
) -> tuple[Bool[NDArray[np.bool_], "n"], tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Find the nearest cell of each position: where there is one that is trusted, and which."""
    row, column, inside = gradient_map.grid.nearest_cells(positions)
    known = inside & gradient_map.trusted(max_std_ratio)[row, column]
    return known, (row[known], column[known])


def _sample(
    gradient_map: GradientMap, positions: Float[Array, "n 2"], max_std_ratio: float
) -> Float[NDArray[np.float64], "n"]:
    """Read the gradient [m/m] in the nearest cell; NaN outside and where it is not trusted."""
    inside, cells = _cells(gradient_map, positions, max_std_ratio)
    values = np.full(len(positions), np.nan)
    values[inside] = gradient_map.gradient[cells]
    return values
