"""SURF, the paper's choice: blobs of a box-filtered Hessian, described by Haar wavelets.

Bay et al., *SURF: Speeded Up Robust Features*, ECCV 2006. OpenCV contains SURF too, but it is
disabled in all packaged builds.

Two things differ from Bay. The cells of the descriptor overlap, as in Agrawal et al., *CenSurE*,
ECCV 2008, so that samples do not jump between cells when the keypoint rotates. And headings are
computed from more and finer wavelets, over half a turn. On twelve grounds rotated by 37 degrees,
97.4 % of the mutual associations are right; with SIFT 97.0 % (``pytest tests/quality -k turned``).
"""

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.features.detection import Detection, Image
from gpgrad_core.features.fast_hessian import Integral, find_blobs, integral_image
from gpgrad_core.features.interpolation import interpolate

SIGMA_OF_SIDE = 1.2 / 9
"""Width of the Gaussian that a box filter approximates, in sides of the filter."""
HEADINGS = 72
"""Number of steps of the window that slides over all headings; it is half of them wide."""
HEADING_RADIUS, HEADING_WIDTH = 10, 4.0
"""Reach of the wavelets for a heading, and width of their Gaussian weight [sigma]."""
CELL_WIDTH, SQUARE_WIDTH = 2.5, 6.0
"""Widths of the Gaussian weights of a sample in a cell, and in the whole square [sigma]."""
SAMPLES = 20
"""Number of Haar responses along each side of the square, one sigma apart; a cell has 5."""
BLOCK = 4096
"""Number of keypoints described at a time, which bounds the memory."""
SIGN_DISTANCE = 3.0
"""Distance between descriptors whose signs differ. It is larger than that of any two descriptors of
length 1."""

Points = Float[NDArray[np.float64], "k 2"]  # (column, row) [pixels]
Responses = Float[NDArray[np.float32], "k n 2"]  # along (column, row)


def detect_surf(image: Image) -> Detection:
    """Detect and describe SURF keypoints.

    The descriptor has Bay's 64 numbers, of length 1. The 65th number is the sign of the Laplacian,
    so large that bright blobs are associated only with bright blobs: Bay's indexing by the sign,
    as a distance.

    Args:
        image: The gradient image (rows, columns) [m/m].
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


def find_headings(
    integral: Integral, pixels: Points, sigmas: Float[NDArray[np.float64], "k"]
) -> Float[NDArray[np.float64], "k"]:
    """Find the main heading of the Haar responses around each keypoint (Bay's Sec. 4.1).

    Responses of side 2 sigma are summed over a window of half a turn that slides over all
    headings. The longest sum gives the heading.

    Args:
        integral: Integral image.
        pixels: Keypoints (column, row) (k, 2) [pixels].
        sigmas: Width of the keypoint's Gaussian (k,) [pixels].

    Returns:
        The headings (k,) [rad].
    """
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
    integral: Integral,
    pixels: Points,
    sigmas: Float[NDArray[np.float64], "k"],
    headings: Float[NDArray[np.float64], "k"],
) -> Float[NDArray[np.float32], "k 64"]:
    """Describe the square of 20 sigma around each keypoint, along its heading (Bay's Sec. 4.2).

    In each of 4 x 4 cells the Haar responses of side 2 sigma are summed to
    (Σ dx, Σ dy, Σ |dx|, Σ |dy|). They are rotated into the keypoint's frame and weighted by
    Gaussians about the cell and about the keypoint.

    Args:
        integral: Integral image.
        pixels: Keypoints (column, row) (k, 2) [pixels].
        sigmas: Width of the keypoint's Gaussian (k,) [pixels].
        headings: Heading of each keypoint (k,) [rad].

    Returns:
        Descriptors of length 1 (k, 64).
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
    integral: Integral,
    where: Float[NDArray[np.float64], "k n 2"],
    halves: Float[NDArray[np.float64], "k"],
) -> Responses:
    """Compute Haar responses at positions around each keypoint; 0 beyond the image.

    Keypoints whose wavelets have the same side, in whole pixels, share an image of responses.
    It is smooth over a third of a side, so it is computed at that step and interpolated.

    Args:
        integral: Integral image.
        where: n positions (column, row) for each keypoint (k, n, 2) [pixels].
        halves: Half the side of each keypoint's wavelet (k,) [pixels]; it is rounded.
    """
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


def _haar_image(
    integral: Integral, half: int, stride: int
) -> Float[NDArray[np.float32], "rows columns 2"]:
    """Compute the mean of one half of a square minus that of the other, along (column, row)."""

    def corners(down: int, right: int) -> Float[NDArray[np.float64], "rows columns"]:
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
