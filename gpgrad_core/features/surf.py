"""SURF, the paper's choice: blobs of a box-filtered Hessian, described by Haar wavelets.

Bay et al., *SURF: Speeded Up Robust Features*, ECCV 2006. OpenCV contains SURF too, but it is
disabled in all packaged builds. A box filter of any size costs the same few differences of an
integral image; it is that of the float image, so gradient maps need no conversion to 8 bits.

Two things differ from Bay. The cells of the descriptor overlap, as in Agrawal et al., *CenSurE*,
ECCV 2008, so that samples do not jump between cells when the keypoint rotates. And headings are
computed from more and finer wavelets, over half a turn. On twelve grounds rotated by 37 degrees,
97.4 % of the mutual associations are right; with SIFT 97.0 %
(``pytest tests/long/quality -k turned``).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, Indices, NDArray, Singles
from gpgrad_core.features.detection import Detection, Image, interpolate

OCTAVES = LAYERS = 4
"""Number of octaves, and of layers of each; keypoints are maxima in the inner layers."""
XY_WEIGHT = 0.9
"""Corrects Dxy for boxes in place of Gaussians: the determinant is Dxx Dyy - (0.9 Dxy)²."""
LEAST_RESPONSE = 1e-8
"""Smallest response, relative to the square of the image's peak."""
SIGMA_OF_SIDE = 1.2 / 9
"""Width of the Gaussian that a box filter approximates, in sides of the filter."""
HEADINGS = 72
"""Number of steps of the window that slides over all headings; it is half of them wide."""
HEADING_RADIUS, HEADING_WIDTH = 10, 4.0
"""Reach of the wavelets for a heading, and width of their Gaussian weight [sigma]."""
CELL_WIDTH, SQUARE_WIDTH = 2.5, 6.0
"""Widths of the Gaussian weights of a sample in a cell, and in the whole square [sigma]."""
SAMPLES = 20
"""Number of Haar responses along each side of the square, one sigma apart."""
BLOCK = 4096
"""Number of keypoints described at a time, which bounds the memory."""
SIGN_DISTANCE = 3.0
"""Distance between descriptors whose signs differ: above that of any two of length 1."""

Integral = Float[Array, "corner_rows corner_columns"]
Layer = Float[Array, "rows columns"]
Corners = dict[int, int]
"""Weights of the corners of an integral image, by their distance from the pixel's first corner."""
Points = Float[Array, "k 2"]  # (column, row) [pixels]
Responses = Float[Singles, "k n 2"]  # along (column, row)


def detect_surf(image: Image) -> Detection:
    """Detect and describe SURF keypoints in a gradient image [m/m].

    The descriptor has Bay's 64 numbers, of length 1. The 65th is the sign of the Laplacian, so
    large that bright blobs are associated only with bright ones: Bay's indexing by the sign, as a
    distance.
    """
    blobs = find_blobs(image)
    integral = integral_image(image)
    sigmas = SIGMA_OF_SIDE * blobs.sides
    descriptors = np.zeros((len(sigmas), 65), np.float32)
    for start in range(0, len(sigmas), BLOCK):
        block = slice(start, start + BLOCK)
        headings = find_headings(integral, blobs.pixels[block], sigmas[block])
        descriptors[block, :64] = describe(integral, blobs.pixels[block], sigmas[block], headings)
    descriptors[:, 64] = SIGN_DISTANCE / 2 * blobs.signs
    return Detection(blobs.pixels, blobs.sides, blobs.responses, descriptors)


@dataclass(frozen=True, eq=False)
class Blobs:
    """Maxima over position and size; (0, 0) is the centre of the first pixel."""

    pixels: Float[Array, "k 2"]  # position (column, row) of each blob (k, 2) [pixels]
    # side of its box filter, which is the blob's diameter (k,) [pixels]
    sides: Float[Array, "k"]
    responses: Float[Array, "k"]  # determinant of the Hessian (k,)
    # sign of the Laplacian (k,): -1 for bright on dark, 1 for dark on bright
    signs: Int[NDArray[np.int8], "k"]


def integral_image(image: Image) -> Integral:
    """Compute the integral image without its mean, which would only cost digits."""
    return cv2.integral(image - image.mean(), sdepth=cv2.CV_64F)


def filter_sides(octave: int) -> list[int]:
    """List the sides of the box filters of an octave [pixels].

    >>> filter_sides(1)
    [15, 27, 39, 51]
    """
    return [3 * (2 ** (octave + 1) * (layer + 1) + 1) for layer in range(LAYERS)]


def find_blobs(image: Image) -> Blobs:
    """Find maxima of the approximated Hessian's determinant over position and size."""
    integral = integral_image(image)
    least = LEAST_RESPONSE * float(np.abs(image).max(initial=0.0)) ** 2
    octaves = [_octave_blobs(integral, octave, least) for octave in range(OCTAVES)]
    return Blobs(
        np.concatenate([blobs.pixels for blobs in octaves]),
        np.concatenate([blobs.sides for blobs in octaves]),
        np.concatenate([blobs.responses for blobs in octaves]),
        np.concatenate([blobs.signs for blobs in octaves]),
    )


def _octave_blobs(integral: Integral, octave: int, least: float) -> Blobs:
    step = 2**octave
    sides = filter_sides(octave)
    rows, columns = (len(range(0, size - 1, step)) for size in integral.shape)
    responses, traces = np.zeros((2, LAYERS, rows, columns))
    for layer, side in enumerate(sides):
        fill_hessian(integral, side, step, responses[layer], traces[layer])
    layer, row, column = _maxima(responses, sides, step, least)
    offset = _quadratic_offset(responses, layer, row, column)
    # Offsets up to a whole cell are allowed, not half a cell as for Gaussians: the responses of
    # boxes have edges, which disturb the quadratic. On maps turned by 37 degrees, 4 % more of the
    # associations are then right.
    near = (np.abs(offset) <= 1.0).all(axis=1)
    layer, row, column, offset = layer[near], row[near], column[near], offset[near]
    return Blobs(
        pixels=step * np.column_stack([column + offset[:, 2], row + offset[:, 1]]),
        sides=np.array(sides)[layer] + offset[:, 0] * (sides[1] - sides[0]),
        responses=responses[layer, row, column],
        signs=np.where(traces[layer, row, column] < 0, -1, 1).astype(np.int8),
    )


def fill_hessian(
    integral: Integral, side: int, step: int, determinant: Layer, trace: Layer
) -> None:
    """Write determinant and trace for one filter size where the filter fits; 0 elsewhere."""
    lobe, half = side // 3, side // 2
    bend: Corners = {half + 1: 1, -half: -1, lobe // 2 + 1: -3, -(lobe // 2): 3}  # lobes 1 -2 1
    even: Corners = {lobe: 1, 1 - lobe: -1}  # 2 lobe - 1 pixels of equal weight
    odd: Corners = {lobe + 1: 1, 1: -1, 0: -1, -lobe: 1}  # lobes 1 0 -1; the 0 is a pixel wide
    # The filter fits around these of every step-th pixels.
    first = -(-half // step)
    rows, columns = (max(0, (size - 2 - half) // step - first + 1) for size in integral.shape)
    if rows == 0 or columns == 0:
        return

    def filtered(down: Corners, right: Corners) -> Layer:
        strips = _weighted(integral, 0, down, first * step, step, rows)
        return _weighted(strips, 1, right, first * step, step, columns) / side**2

    yy, xx, xy = filtered(bend, even), filtered(even, bend), filtered(odd, odd)
    window = (slice(first, first + rows), slice(first, first + columns))
    determinant[window] = xx * yy - (XY_WEIGHT * xy) ** 2
    trace[window] = xx + yy


def _weighted(
    corners: Float[Array, "n m"], axis: int, weights: Corners, start: int, step: int, count: int
) -> Float[Array, "p q"]:
    """Sum shifted copies of the corners with weights, at every step-th position along an axis."""
    shape = (count, corners.shape[1]) if axis == 0 else (corners.shape[0], count)
    span = (count - 1) * step + 1
    total = np.zeros(shape)
    for shift, weight in weights.items():
        line = slice(start + shift, start + shift + span, step)
        shifted = corners[line] if axis == 0 else corners[:, line]
        if abs(weight) == 1:  # saves a pass over the memory, which takes most of the time
            (np.add if weight > 0 else np.subtract)(total, shifted, out=total)
        else:
            total += weight * shifted
    return total


def _maxima(
    responses: Float[Array, "layers rows columns"], sides: list[int], step: int, least: float
) -> tuple[Indices, Indices, Indices]:
    """Find the cells that are above all 26 neighbours: (layer, row, column)."""
    # OpenCV compares along rows and columns, because it is fast; then the layers are compared.
    kernel = np.ones((3, 3), np.uint8)
    highest = np.stack([cv2.dilate(layer, kernel) for layer in responses])
    peaks: list[Indices] = []
    for layer in range(1, LAYERS - 1):
        middle = responses[layer]
        peak = (middle >= highest[layer]) & (middle > least)
        peak &= (middle > highest[layer - 1]) & (middle > highest[layer + 1])
        # The neighbours must be known too, so the next larger filter has to fit.
        margin = -(-(sides[layer + 1] // 2) // step) + 1
        inside = np.zeros_like(peak)
        inside[margin:-margin, margin:-margin] = True
        row, column = np.nonzero(peak & inside)
        peaks.append(np.stack([np.full(len(row), layer), row, column]))
    layer, row, column = np.concatenate(peaks, axis=1)
    return layer, row, column


def _quadratic_offset(
    responses: Float[Array, "layers rows columns"], layer: Indices, row: Indices, column: Indices
) -> Float[Array, "k 3"]:
    """Find the peak of the quadratic through a maximum and its neighbours: (layer, row, column)."""
    unit = np.eye(3, dtype=np.intp)

    def at(shift: Indices) -> Array:
        return responses[layer + shift[0], row + shift[1], column + shift[2]]

    centre = responses[layer, row, column]
    slope = np.stack([(at(e) - at(-e)) / 2 for e in unit], axis=-1)
    hessian = np.zeros((len(layer), 3, 3))
    for i, e in enumerate(unit):
        hessian[:, i, i] = at(e) + at(-e) - 2 * centre
        for j in range(i):
            f = unit[j]
            mixed = (at(e + f) - at(e - f) - at(f - e) + at(-e - f)) / 4
            hessian[:, i, j] = hessian[:, j, i] = mixed
    # A peak that is flat along some line has no single position: its offset is NaN.
    flat = np.abs(np.linalg.det(hessian)) <= 1e-12 * np.abs(centre) ** 3
    hessian[flat] = np.eye(3)
    offset = -np.linalg.solve(hessian, slope[..., None])[..., 0].astype(np.float64)
    offset[flat] = np.nan
    return offset


def find_headings(
    integral: Integral, pixels: Points, sigmas: Float[Array, "k"]
) -> Float[Array, "k"]:
    """Find the main heading [rad] of the Haar responses around each keypoint (Bay's Sec. 4.1)."""
    along = np.arange(-HEADING_RADIUS, HEADING_RADIUS + 1)
    steps = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    steps = steps[np.hypot(*steps.T) <= HEADING_RADIUS]
    weights = np.exp(-np.sum(steps**2, axis=1) / (2 * HEADING_WIDTH**2)).astype(np.float32)
    where = pixels[:, None] + sigmas[:, None, None] * steps
    responses = _haar_responses(integral, where, sigmas) * weights[:, None]
    # Sum all responses of a keypoint by the step of heading that they fall into.
    turns = np.arctan2(responses[..., 1], responses[..., 0]) / (2 * np.pi)
    step = np.floor(turns * HEADINGS).astype(np.intp) % HEADINGS
    bins = step + HEADINGS * np.arange(len(pixels))[:, None]
    sums = np.stack(
        [
            np.bincount(bins.ravel(), responses[..., axis].ravel(), HEADINGS * len(pixels))
            for axis in (0, 1)
        ],
        axis=-1,
    ).reshape(len(pixels), HEADINGS, 2)
    windows = sum(np.roll(sums, -shift, axis=1) for shift in range(HEADINGS // 2))
    longest = np.asarray(windows)[
        np.arange(len(pixels)), np.argmax(np.sum(np.square(windows), axis=-1), axis=1)
    ]
    return np.arctan2(longest[:, 1], longest[:, 0])


def describe(
    integral: Integral, pixels: Points, sigmas: Float[Array, "k"], headings: Float[Array, "k"]
) -> Float[Singles, "k 64"]:
    """Describe the square of 20 sigma around each keypoint, along its heading (Bay's Sec. 4.2).

    In each of 4 x 4 cells the Haar responses of side 2 sigma [pixels] are summed to
    (Σ dx, Σ dy, Σ |dx|, Σ |dy|), weighted by Gaussians about the cell and about the keypoint.
    """
    along = np.arange(SAMPLES) - (SAMPLES - 1) / 2
    square = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    weights = np.exp(-np.sum(square**2, axis=1) / (2 * SQUARE_WIDTH**2))
    c, s = np.cos(headings), np.sin(headings)
    turn = np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], axis=-2)  # rows: own axes
    where = pixels[:, None] + (sigmas[:, None, None] * square) @ turn
    responses = _haar_responses(integral, where, sigmas)
    own = responses @ np.swapaxes(turn, 1, 2).astype(np.float32)
    # The weight of each sample in each cell, so that one matrix product gives all sums.
    middles = SAMPLES / 4 * (np.arange(4) - 1.5)
    near = np.exp(-((along - middles[:, None]) ** 2) / (2 * CELL_WIDTH**2))
    share = (np.kron(near, near) * weights).astype(np.float32)
    described = np.concatenate([share @ own, share @ np.abs(own)], axis=-1).reshape(-1, 64)
    length = np.linalg.norm(described, axis=1, keepdims=True)
    return described / np.maximum(length, np.finfo(np.float32).tiny)


def _haar_responses(
    integral: Integral, where: Float[Array, "k n 2"], halves: Float[Array, "k"]
) -> Responses:
    """Compute Haar responses at positions (column, row) [pixels]; 0 beyond the image."""
    responses = np.zeros(where.shape, np.float32)
    rounded = np.maximum(1, np.rint(halves)).astype(np.intp)
    for half in np.unique(rounded):
        if 2 * half >= min(integral.shape):
            continue
        chosen = rounded == half
        stride = max(1, int(half) // 3)
        # The image's first sample lies on the pixels' corner (half, half).
        sampled = (where[chosen] + 0.5 - half) / stride
        responses[chosen] = interpolate(_haar_image(integral, int(half), stride), sampled)
    return responses


def _haar_image(integral: Integral, half: int, stride: int) -> Float[Singles, "rows columns 2"]:
    """Compute the mean of one half of a square minus that of the other, along (column, row)."""

    def corners(down: int, right: int) -> Float[Array, "rows columns"]:
        rows, columns = integral.shape
        return integral[
            half + down : rows - half + down : stride,
            half + right : columns - half + right : stride,
        ]

    rising = corners(half, half) - corners(-half, -half)
    falling = corners(half, -half) - corners(-half, half)
    scale = 1 / (2 * half**2)
    haar = np.empty((*rising.shape, 2), np.float32)
    haar[..., 0] = scale * (rising + falling - 2 * (corners(half, 0) - corners(-half, 0)))
    haar[..., 1] = scale * (rising - falling - 2 * (corners(0, half) - corners(0, -half)))
    return haar
