"""The pipeline on other maps: blurred mean heights of cells, and the elevation as an image.

The smoothed grid is the strongest baseline without a GP. Both maps go through the same keypoints,
matching and check as the gradient map.
"""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.detection import PipelineParams
from gpgrad_core.features import DetectorParams
from gpgrad_core.mapping.gradient_map import map_grid
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import GradientMap, Grid, Submap

BLUR = 0.4
"""Standard deviation of the blur [length-scales]."""
WIDER = 4.0
"""If no point is near, a blur that is this many times as wide fills the cell."""
FILLED_BELOW = 0.05
"""If the sum of weights around a cell is below this, the wider blur dominates."""
MIN_SUPPORT = 0.5
"""A cell's height counts as measured if the weights around it add up to this."""


def memoised_smoothed_map(
    submap: Submap, params: PipelineParams, memo: Memo, progress: Progress = silent
) -> GradientMap:
    """Make a submap's smoothed map, and keep it in the memo."""
    smoothed = memo(smoothed_map, submap, params)
    progress(1.0)
    return smoothed


def smoothed_map(submap: Submap, params: PipelineParams) -> GradientMap:
    """Make the map of a submap: see `smooth`."""
    return smooth(submap, params)[0]


def smooth(
    submap: Submap, params: PipelineParams
) -> tuple[GradientMap, Float[Array, "rows columns"]]:
    """Bin, blur and differentiate a submap's heights.

    The blur is a normalised convolution: with Gaussian weights g of the points around a cell,
    ``elevation = Σ g z / Σ g``. The variance of the elevation is the scatter of the heights around
    it, the second result [m²], divided by the effective number of points, ``(Σ g)² / Σ g²``.
    """
    grid = map_grid(submap, params.map.resolution)
    mean = float(submap.points[:, 2].mean())
    z = submap.points[:, 2] - mean
    count, height, square = (_binned(grid, submap.points, values) for values in (None, z, z * z))
    blur = BLUR * params.map.terrain.length_scale
    weight, weighted = _blurred(count, blur, grid), _blurred(height, blur, grid)
    wide_weight = _blurred(count, WIDER * blur, grid)
    wide = _blurred(height, WIDER * blur, grid) / (wide_weight + FILLED_BELOW)
    elevation = (weighted + FILLED_BELOW * wide) / (weight + FILLED_BELOW)

    signal_std = params.map.signal_std or max(float(z.std()), 0.01 * params.map.terrain.noise_std)
    sure = np.maximum(weight, 1e-12)
    scatter = np.maximum(_blurred(square, blur, grid) / sure - (weighted / sure) ** 2, 0.0)
    # g² is a Gaussian of 1/√2 the width.
    effective = weight**2 / np.maximum(_blurred(count, blur / np.sqrt(2), grid), 1e-12)
    variance = np.maximum(scatter, params.map.terrain.noise_std**2) / np.maximum(effective, 1e-12)
    variance = np.where(weight >= MIN_SUPPORT, np.minimum(variance, signal_std**2), signal_std**2)
    scale = params.map.terrain.length_scale
    smoothed = _as_map(grid, elevation + mean, variance, signal_std, scale)
    return smoothed, scatter


def _as_map(
    grid: Grid,
    elevation: Float[Array, "rows columns"],
    variance: Float[Array, "rows columns"],
    signal_std: float,
    length_scale: float,
) -> GradientMap:
    slope_y, slope_x = np.gradient(elevation, grid.resolution)
    slope = np.stack([slope_x, slope_y], axis=-1)
    return GradientMap(grid, elevation, variance, slope, signal_std, length_scale)


def _binned(
    grid: Grid, points: Float[Array, "n 3"], values: Float[Array, "n"] | None
) -> Float[Array, "rows columns"]:
    """Sum values, or count points, in the cells in which they lie."""
    column, row = np.rint(grid.to_pixel(points[:, :2])).astype(np.intp).T
    sums = np.bincount(row * grid.shape[1] + column, values, grid.num_cells)
    return sums.astype(np.float64).reshape(grid.shape)


def _blurred(
    image: Float[Array, "rows columns"], std: float, grid: Grid
) -> Float[Array, "rows columns"]:
    """Sum with weights ``exp(-d² / (2 std²))``, 1 at the cell itself; nothing lies outside."""
    sigma = std / grid.resolution
    blurred = cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    # OpenCV's weights add up to one along each axis.
    width = cv2.getGaussianKernel(2 * round(4 * sigma) + 1, sigma).max()
    return blurred.astype(np.float64) / width**2


def elevation_params(params: PipelineParams) -> PipelineParams:
    """Replace the detector for slope vectors by AKAZE, which ranks pairs best on images."""
    if params.features.detector.name != "slope":
        return params
    return replace(params, features=replace(params.features, detector=DetectorParams("akaze")))


def elevation_as_image(gradient_map: GradientMap) -> GradientMap:
    """Make a map whose gradient image is the height above the lowest cell."""
    height = gradient_map.elevation - gradient_map.elevation.min()
    return replace(gradient_map, slope=np.stack([height, np.zeros_like(height)], axis=-1))
