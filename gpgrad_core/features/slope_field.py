"""A detector for terrain: keypoints of its curvature, described by the slope *vectors* around them.

A gradient image says how steep the ground is, but not in which direction it falls. The GP knows
both, exact and smooth, and how far to trust them. So this detector differs from those made for
photographs:

- There are few sizes, and they are physical: a map has no unknown zoom, and its scale of comparison
  says which detail it holds. Nothing depends on the map's resolution.
- Keypoints are extrema of the determinant of the elevation's Hessian: hills, pits and saddles. The
  second derivatives are differences of the exact slopes over a fifth of the scale of comparison.
- A keypoint's heading is the direction in which the ground around it rises.
- The descriptor is the slope itself on rings around the keypoint, rotated to the heading. It is not
  normalised: the steepness of the ground is a fact, not a matter of lighting.
- Each slope is weighted by how well the points determine the elevation there. Beyond the edge of
  what was seen, the descriptor is 0 for "unknown", not for "flat".
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import Array, Indices, Mask, Singles
from gpgrad_core.features.detection import Detection, interpolate
from gpgrad_core.types import GradientMap

SCALES = (0.5, 1.0)
"""Widths of the Gaussians under which keypoints are searched [scales of comparison]. The first also
serves the descriptors, and the last the headings."""
RINGS = (0.8, 1.7, 2.9, 4.5)
"""Radii of the descriptor's rings around its centre [scales of comparison]."""
SPOKES = 12
"""Number of samples on each ring; every other ring is rotated by half a step."""
LEAST_WEIGHT = 1e-3
"""Slopes are divided by no smaller weight, so that unknown ones fade to 0."""
LEAST_RESPONSE = 1e-4
"""Smallest response, relative to the steepest slope; less is a rounding error."""
CELLS = 5
"""Smallest number of cells of the working grid along a scale of comparison."""
CELLS_AT_ONCE = 50_000
"""Number of cells that keypoints are searched in at once, in a processor's cache."""

Layer = Float[Singles, "rows columns"]
Slopes = Float[Singles, "rows columns 3"]  # weighted slope (x, y), and the weight
Points = Float[Singles, "k 2"]  # (column, row) of the working grid


@dataclass(frozen=True, eq=False)
class _Keypoints:
    cells: Points
    sigmas: Float[Array, "k"]  # [cells]
    responses: Float[Array, "k"]


def detect_slope_field(gradient_map: GradientMap) -> Detection:
    """Detect hills, pits and saddles, and describe the slope vectors around them.

    The descriptors have 2 (1 + 12 · 4) values: the slopes along and across the keypoint's heading
    [m/m]. The gradient image is not used.
    """
    length = gradient_map.scale / gradient_map.grid.resolution  # [pixels]
    stride = max(1, int(length / CELLS))
    slopes = _weighted_slopes(gradient_map, stride)
    unit = length / stride  # the scale of comparison in cells
    smoothed = [_smooth(slopes, scale * unit) for scale in SCALES]
    of_scales = [
        _find_keypoints(field, scale * unit) for field, scale in zip(smoothed, SCALES, strict=True)
    ]
    cells = np.concatenate([keypoints.cells for keypoints in of_scales])
    last = np.array(gradient_map.grid.shape[::-1]) - 1.0
    return Detection(
        # The centre of a cell of stride x stride pixels; the last cells reach beyond the image.
        pixels=np.clip(stride * cells.astype(np.float64) + (stride - 1) / 2, 0.0, last),
        diameters=2 * stride * np.concatenate([keypoints.sigmas for keypoints in of_scales]),
        responses=np.concatenate([keypoints.responses for keypoints in of_scales]),
        descriptors=_describe(cells, smoothed[0], smoothed[-1], unit),
    )


def _weighted_slopes(gradient_map: GradientMap, stride: int) -> Slopes:
    """Average the weighted slopes over cells of stride x stride pixels."""
    rows, columns = gradient_map.grid.shape
    whole = gradient_map.detail_std**2
    weighted = np.zeros((rows + -rows % stride, columns + -columns % stride, 3), np.float32)
    for band in _bands(gradient_map.grid.shape):
        weight = 1 - np.clip(gradient_map.variance[band] / whole, 0.0, 1.0)
        weighted[band, :columns, :2] = gradient_map.slope[band] * weight[..., None]
        weighted[band, :columns, 2] = weight
    if stride == 1:
        return weighted
    size = (weighted.shape[1] // stride, weighted.shape[0] // stride)
    return np.asarray(cv2.resize(weighted, size, interpolation=cv2.INTER_AREA), np.float32)


def _bands(shape: tuple[int, ...]) -> list[slice]:
    """Divide the rows of an image into bands, which bounds the memory."""
    height = max(1, CELLS_AT_ONCE // shape[1])
    return [slice(row, min(row + height, shape[0])) for row in range(0, shape[0], height)]


def _smooth(slopes: Slopes, sigma: float) -> Slopes:
    """Smooth slopes and weights in the same way; their ratio is the weighted average."""
    side = 2 * int(np.ceil(3 * sigma)) + 1
    smoothed = cv2.GaussianBlur(slopes, (side, side), sigma, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(smoothed, np.float32)


def _find_keypoints(smoothed: Slopes, sigma: float) -> _Keypoints:
    """Find the extrema of the Hessian's determinant; the response is sigma √|det|, a slope."""
    steepest, peaks_by_sign = 0.0, dict[int, list[tuple[Points, Singles]]]()
    for band in _bands(smoothed.shape):
        # A peak depends on two rows on either side.
        first = max(band.start - 2, 0)
        along_x, along_y = _slope(smoothed[first : band.stop + 2])
        steepest = max(steepest, *(float(np.abs(one).max()) for one in (along_x, along_y)))
        xx, xy = _derivatives(along_x)
        yx, yy = _derivatives(along_y)
        # The two mixed derivatives differ where the weights differ.
        determinant = xx * yy - ((xy + yx) / 2) ** 2
        for sign in (1, -1):  # hills and pits, then saddles
            strength = np.sqrt(np.maximum(sign * determinant, 0))
            peaks = _peaks(strength) & (strength > 0)
            row, column = np.nonzero(peaks[band.start - first : band.stop - first])
            row += band.start - first
            offset = [_peak_offset(strength, row, column, axis) for axis in (1, 0)]
            where = np.column_stack([column, row + first])
            where = where + np.column_stack(offset).astype(np.float32)
            peaks_by_sign.setdefault(sign, []).append((where, strength[row, column]))
    cells, strengths = zip(*peaks_by_sign[1], *peaks_by_sign[-1], strict=True)
    where, strength = np.concatenate(cells).astype(np.float32), np.concatenate(strengths)
    strong = sigma * strength > LEAST_RESPONSE * steepest
    where, strength = where[strong], strength[strong].astype(np.float64)
    return _Keypoints(where, np.full(len(where), sigma), sigma * strength)


def _slope(smoothed: Slopes) -> tuple[Layer, Layer]:
    along_x, along_y, weight = cv2.split(smoothed)
    weight = np.maximum(weight, np.float32(LEAST_WEIGHT))
    return np.asarray(along_x / weight, np.float32), np.asarray(along_y / weight, np.float32)


def _derivatives(layer: Layer) -> tuple[Layer, Layer]:
    """Compute central differences along x and y, slightly smoothed across."""
    along_x = cv2.Sobel(layer, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    along_y = cv2.Sobel(layer, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    return np.asarray(along_x, np.float32), np.asarray(along_y, np.float32)


def _peaks(strength: Layer) -> Bool[Mask, "rows columns"]:
    """Find the cells that are not below any of their eight neighbours; none at the border."""
    peaks = strength >= cv2.dilate(strength, np.ones((3, 3), np.uint8))
    peaks[[0, -1]] = False
    peaks[:, [0, -1]] = False
    return peaks


def _peak_offset(strength: Layer, row: Indices, column: Indices, axis: int) -> Float[Singles, "k"]:
    """Find the peak of the parabola through a cell and its two neighbours [cells]."""
    down, right = (1, 0) if axis == 0 else (0, 1)
    before = strength[row - down, column - right]
    after = strength[row + down, column + right]
    bend = np.maximum(2 * strength[row, column] - before - after, np.finfo(np.float32).tiny)
    return np.clip((after - before) / (2 * bend), -0.5, 0.5).astype(np.float32)


def _describe(cells: Points, fine: Slopes, coarse: Slopes, unit: float) -> Float[Singles, "k d"]:
    """Sample the weighted slopes on rings around each keypoint [cells], in its own frame."""
    uphill = interpolate(coarse, cells[:, None])[:, 0]
    heading = np.arctan2(uphill[:, 1], uphill[:, 0])
    radius, angle = _rings()
    around = heading[:, None] + angle
    reach = (unit * radius)[:, None] * np.stack([np.cos(around), np.sin(around)], axis=-1)
    slopes = interpolate(fine, cells[:, None] + reach)
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    along = c * slopes[..., 0] + s * slopes[..., 1]
    across = c * slopes[..., 1] - s * slopes[..., 0]
    return np.hstack([along, across]).astype(np.float32)


def _rings() -> tuple[Float[Singles, "n"], Float[Singles, "n"]]:
    """List the radius [scales of comparison] and angle [rad] of each sample, the centre first."""
    spoke = np.arange(SPOKES)
    radius = np.concatenate([[0.0], *(np.full(SPOKES, ring) for ring in RINGS)])
    turned = [(spoke + (k % 2) / 2) * 2 * np.pi / SPOKES for k in range(len(RINGS))]
    return radius.astype(np.float32), np.concatenate([[0.0], *turned]).astype(np.float32)
