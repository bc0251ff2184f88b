"""What camera images say of a motion that the terrain found: the same place, another, or nothing.

Keypoints are ORB's (Rublee et al., *ORB: An Efficient Alternative to SIFT or SURF*, 2011), and the
number of false alarms judges how many of them agree (Moisan and Stival, *A Probabilistic Criterion
to Detect Rigid Point Matches Between Two Images and Estimate the Fundamental Matrix*, IJCV 2004).
The guide has the limits (method.md, *Camera images*).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, hypot, inf, lgamma, log, log10
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from gpgrad_core.arrays import Array, Indices, Mask, NDArray
from gpgrad_core.reading.images import read_images
from gpgrad_core.se2 import SE2
from gpgrad_core.types import ImageSays, ImageVerdict

NUM_FEATURES = 1500
"""Largest number of ORB features of an image (the paper's Sec. VII-B)."""
RATIO = 0.8
"""Two descriptors are associated if their distance is below this share of the second smallest."""
EPIPOLAR_DISTANCE = 2.0
"""Largest distance of an inlier from its epipolar line [pixels]."""
MIN_ASSOCIATIONS, TO_DETERMINE = 8, 7
"""Smallest number of associations for a fundamental matrix, and how many determine one."""
FALSE_ALARMS = 1e-3
"""Two submaps agree if chance brings as much in fewer than this share of unrelated pairs."""
MOST_IMAGES = 4
"""Images of a submap that are compared."""
SPOT = 8.0
"""Side of a square whose keypoints count once [pixels]: one stone has several keypoints."""
TEXTURE, BLUR, CONTRAST = 100, 1.0, 20
"""An image with fewer corners of this contrast [grey values], after a blur of so many pixels, says
nothing by what it does not show."""
NEAR_OFFSET, NEAR_TURN = 0.5, float(np.radians(15.0))
"""A camera that was moved by less than this [m, rad] must show the same ground again."""
LOOKS_ASIDE, TILTS = float(np.radians(90.0)), float(np.radians(45.0))
"""The vehicle may turn by this much more than its image, and by this much less [rad]."""
WIDEST = 3.0
"""An image that is this many times as wide as high may be a panorama, which does not turn."""

Descriptors = UInt8[NDArray[np.uint8], "_ 32"]


@dataclass(frozen=True, eq=False)
class ImageFeatures:
    """ORB features of one image."""

    name: str  # name of the file
    size: tuple[int, int]  # width and height [pixels]
    pixels: Float[Array, "k 2"]  # positions (k, 2) [pixels]
    # their directions (k,) [rad], clockwise as one sees the image
    angles: Float[Array, "k"]
    descriptors: Descriptors  # strings of bits (k, 32) [bytes]
    num_corners: int  # number of corners that stand out of an image's noise


@dataclass(frozen=True, eq=False)
class ImageAgreement:
    """How well two images agree with one geometry of two views."""

    num_associations: int  # number of associations, counted by their spots
    num_inliers: int  # number of those that agree
    # decimal logarithm of the number of agreements as good that chance brings
    log_false_alarms: float
    turn: float  # median angle by which the inliers are turned [rad]; 0 without inliers


def extract_orb(name: str, image: UInt8[NDArray[np.uint8], "rows columns"]) -> ImageFeatures:
    """Extract the ORB features of an image."""
    keypoints, descriptors = cv2.ORB.create(nfeatures=NUM_FEATURES).detectAndCompute(image, None)
    pixels = np.array([keypoint.pt for keypoint in keypoints], dtype=np.float64).reshape(-1, 2)
    angles = np.radians(np.array([keypoint.angle for keypoint in keypoints], dtype=np.float64))
    described = (
        np.zeros((0, 32), np.uint8) if len(pixels) == 0 else np.asarray(descriptors, np.uint8)
    )
    smooth = cv2.GaussianBlur(image, (0, 0), BLUR)
    num_corners = len(cv2.FastFeatureDetector.create(CONTRAST).detect(smooth))
    size = image.shape[1], image.shape[0]
    return ImageFeatures(name, size, pixels, angles, described, num_corners)


def extract_images(files: tuple[Path, ...]) -> tuple[ImageFeatures, ...]:
    """Extract the ORB features of image files; a broken one raises InputError."""
    images = read_images(files)
    return tuple(extract_orb(file.name, image) for file, image in zip(files, images, strict=True))


def some_of(files: tuple[Path, ...]) -> tuple[Path, ...]:
    """Choose the images of a submap that are compared: all, or some evenly among them."""
    if len(files) <= MOST_IMAGES:
        return files
    return tuple(files[k] for k in np.linspace(0, len(files) - 1, MOST_IMAGES).round().astype(int))


def nearest_words(descriptors: Descriptors, words: Descriptors) -> Int[Indices, "k"]:
    """Find the word that each descriptor is, by the ratio of the two nearest; -1 if none is."""
    chosen = np.full(len(descriptors), -1, dtype=np.intp)
    if len(words) < 2 or len(descriptors) == 0:
        return chosen
    for k, pair in enumerate(cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(descriptors, words, 2)):
        first, second = pair
        if first.distance < RATIO * second.distance:
            chosen[k] = first.trainIdx
    return chosen


def fit_two_views(query: Float[Array, "m 2"], database: Float[Array, "m 2"], seed: int) -> Mask:
    """Find which associations (m,) fit one fundamental matrix; none if they are few [pixels]."""
    if len(query) < MIN_ASSOCIATIONS:
        return np.zeros(len(query), np.bool_)
    usac = cv2.UsacParams()
    usac.threshold = EPIPOLAR_DISTANCE
    usac.randomGeneratorState = seed
    try:
        agree: cv2.typing.MatLike | None = cv2.findFundamentalMat(query, database, usac)[1]
    except cv2.error:  # its local search fails where no sample gives a matrix
        agree = None
    return np.zeros(len(query), np.bool_) if agree is None else np.asarray(agree, np.bool_).ravel()


def compare_images(query: ImageFeatures, database: ImageFeatures, seed: int = 0) -> ImageAgreement:
    """Compare two images by the associations that are the nearest of each other."""
    there = nearest_words(query.descriptors, database.descriptors)
    back = nearest_words(database.descriptors, query.descriptors)
    matched = np.flatnonzero(there >= 0)
    mutual = matched[back[there[matched]] == matched]
    pixels, other = query.pixels[mutual], database.pixels[there[mutual]]
    inliers = fit_two_views(pixels, other, seed)
    num_associations, num_inliers = _spots(pixels, other), _spots(pixels[inliers], other[inliers])
    turns = (database.angles[there[mutual]] - query.angles[mutual])[inliers]
    middle = np.angle(np.exp(1j * turns).sum()) if len(turns) else 0.0
    around = np.angle(np.exp(1j * (turns - middle)))
    return ImageAgreement(
        num_associations,
        num_inliers,
        log_false_alarms(num_inliers, num_associations, database.size),
        float(middle + np.median(around)) if len(turns) else 0.0,
    )


def _spots(query: Float[Array, "m 2"], database: Float[Array, "m 2"]) -> int:
    """Count associations by their spots, so that each spot of either image counts once."""
    cells = (np.floor(pixels / SPOT).astype(np.intp) for pixels in (query, database))
    return min(len(np.unique(occupied, axis=0)) for occupied in cells)


def log_false_alarms(num_inliers: int, num_associations: int, size: tuple[int, int]) -> float:
    """Compute how often chance lets k inliers of n associations agree with one fundamental matrix.

    By Moisan and Stival (2004), of n associations of which k lie within a distance d of their
    epipolar lines, in an image of diagonal D and area A [pixels]:

        NFA = 3 (n - 7) C(n, k) C(k, 7) (2 d D / A)^(k - 7)

    It gives the decimal logarithm; infinite if there are too few inliers to tell.
    """
    k, n = num_inliers, num_associations
    if k <= TO_DETERMINE:
        return inf
    share = min(2.0 * EPIPOLAR_DISTANCE * hypot(*size) / (size[0] * size[1]), 1.0)
    ways = _log_choose(n, k) + _log_choose(k, TO_DETERMINE)
    return log10(3 * (n - TO_DETERMINE)) + ways + (k - TO_DETERMINE) * log10(share)


def _log_choose(n: int, k: int) -> float:
    return (lgamma(n + 1) - lgamma(k + 1) - lgamma(n - k + 1)) / log(10.0)


def judge_by_images(
    query: Sequence[ImageFeatures],
    database: Sequence[ImageFeatures],
    T_database_query: SE2,
    seed: int = 0,
) -> ImageVerdict:
    """Judge a motion of frames that are fixed to the vehicle by the images of its two submaps.

    The images *confirm* it if two of them agree with one geometry of two views, better than chance
    explains. They *contradict* it in two cases, which need two images of one camera, with the same
    file name. They agree, but one is turned against the other as the motion does not turn. Or the
    motion puts the camera back to where it was, and yet two rich images have nothing in common.
    In all other cases they are *silent*.
    """
    pairs = [(a, b) for a in query for b in database]
    agreements = [compare_images(a, b, seed) for a, b in pairs]
    if not agreements:
        return ImageVerdict("silent", "there are no images", 0, 0)
    best = min(range(len(agreements)), key=lambda k: agreements[k].log_false_alarms)
    (a, b), agreement = pairs[best], agreements[best]

    def verdict(word: ImageSays, reason: str) -> ImageVerdict:
        counts = agreement.num_associations, agreement.num_inliers
        return ImageVerdict(word, reason, *counts)

    fit = (
        f"{agreement.num_inliers} of {agreement.num_associations} associations of {a.name} and "
        f"{b.name} fit one geometry of two views"
    )
    if agreement.log_false_alarms + log10(len(agreements)) < log10(FALSE_ALARMS):
        turned, image = abs(_wrapped(T_database_query.yaw)), abs(_wrapped(agreement.turn))
        one_camera = a.name == b.name and a.size[0] < WIDEST * a.size[1]
        if one_camera and not -TILTS <= turned - image <= LOOKS_ASIDE:
            return verdict(
                "contradicted",
                f"{fit}, but the image is turned by {degrees(image):.0f}°, and the motion turns "
                f"by {degrees(turned):.0f}°",
            )
        return verdict("confirmed", fit)
    offset, turn = (
        hypot(T_database_query.x, T_database_query.y),
        abs(_wrapped(T_database_query.yaw)),
    )
    same = [(a, b) for a, b in pairs if a.name == b.name]
    fewest = min(features.num_corners for pair in pairs for features in pair)
    if fewest < TEXTURE:
        return verdict(
            "silent", f"an image has too little texture: {fewest} corners, {TEXTURE} needed"
        )
    if same and offset <= NEAR_OFFSET and turn <= NEAR_TURN:
        return verdict(
            "contradicted",
            f"the motion puts the camera back within {offset:.2g} m and {degrees(turn):.0f}°, but "
            f"only {fit}",
        )
    return verdict(
        "silent",
        f"only {fit}, and after {offset:.1f} m and {degrees(turn):.0f}° the views need not overlap",
    )


def _wrapped(angle: float) -> float:
    return float(np.angle(np.exp(1j * angle)))
