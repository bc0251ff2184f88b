"""Pairs of images -> points, each with the standard deviation that the matching leaves.

OpenCV's semi-global matching finds disparities to a pixel or so. It checks the right image against
the left one, wants the best match to be clearly better than the second, and drops small islands. A
step of least-squares matching follows (Gruen 1985; Förstner 1982): over a window around each pixel,
the differences of the two images, after their local brightness and contrast are made equal, are
explained by a shift. That shift is a linear estimate, and its variance follows from what stays
unexplained and from the texture: little texture, blur and noise all make it larger.

A window sees ground that is not a plane, and what it cannot follow is an error too. `NOISE` says
how much each part counts; it was fitted to rendered pairs over simulated ground
(``tests/long/quality/test_stereo.py`` checks it on others).
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.recordings.cameras import CameraModel
from gpgrad_core.recordings.recording import Scan
from gpgrad_core.recordings.trajectory import Poses

GreyImage: TypeAlias = UInt8[NDArray[np.uint8], "rows columns"]
PixelMap: TypeAlias = Float[NDArray[np.floating], "rows columns"]
Maps: TypeAlias = tuple[PixelMap, PixelMap]

WINDOW, WIDE = 9, 21
"""Sides of the window that is matched, and of the one in which most pixels must match [pixels]."""
BLOCK, UNIQUE, ISLAND = 5, 10, 100
"""Of semi-global matching: side of a block, margin of the best match [%], pixels of an island."""
WIDEST = 0.2
"""Largest disparity, in widths of the image, unless points must be further away anyway."""
LEAST = 0.01
"""Smallest disparity, in widths of the image; what is further away has too large an error."""
NOISE = (0.55, 0.42, 0.092, 5.5e-4)
"""Of the variance of a disparity: factors of the estimate's own variance, of the disparity's
scatter about a plane within the window, and of the square of its second difference across the
window; and the variance that interpolation leaves [pixels²]."""
ROUGHEST, BENT = 0.07, 0.03
"""Largest scatter about a plane [pixels²], before and after refinement: more is an edge."""
MOVED = 0.5
"""Largest shift of the refinement [pixels]; a larger one is a wrong match."""
MATCHED = 0.8
"""Least share of pixels around one that must have a match as well."""
LEAST_TEXTURE = 0.5
"""Least root mean square of the image's slope along a row [grey levels per pixel]."""
STEP = 2
"""Every second pixel of every second row is a point: neighbours share their errors anyway."""
FEW, MANY = 0.01, 0.05
"""Shares of pixels that match as they are, and the other way round, if cameras are swapped."""

NO_MATCH = (
    "pairs whose pixels find no match may have the calibration of other cameras, be taken at "
    "different times, or not be rectified though their name says so"
)


@dataclass(frozen=True, eq=False)
class Rig:
    """Two cameras, and how their images are made comparable row by row."""

    left: CameraModel
    right: CameraModel
    focal: float  # of the rectified images [pixels]
    centre: tuple[float, float]  # of the left rectified image [pixels]
    shift: float  # of the centre from the right image to the left one [pixels]
    baseline: float  # distance of the cameras [m]
    turn: Rotation  # ``R_camera_rectified`` of the left camera
    maps: tuple[Maps, Maps] | None  # for OpenCV's remap; None if the images are rectified

    def scan(
        self,
        left: GreyImage,
        right: UInt8[NDArray[np.uint8], "rows_of_right columns_of_right"],
        where: str,
        nearest: float = 0.0,
    ) -> Scan:
        """Match a pair of images; points nearer than so many metres are not looked for."""
        for camera, image in ((self.left, left), (self.right, right)):
            if camera.size[0]:
                camera.check_image(image, where)
        if left.shape != right.shape:
            raise InputError(
                f"{where}: the left image has {left.shape[1]} x {left.shape[0]} pixels, the right "
                f"one {right.shape[1]} x {right.shape[0]}; they must be of one size"
            )
        if not self.left.size[0] and not 0 < self.centre[0] < left.shape[1]:
            raise InputError(
                f"{where}: the centre of the calibration {self.left.where} is outside of the image "
                f"of {left.shape[1]} x {left.shape[0]} pixels; it is that of another camera"
            )
        if abs(self.shift) >= left.shape[1]:
            raise InputError(
                f"{where}: by P of {self.left.where} and {self.right.where} the centres are "
                f"{abs(self.shift):.0f} pixels apart, and the image is {left.shape[1]} wide; they "
                "are of other cameras"
            )
        if self.maps is not None:
            import cv2  # noqa: PLC0415 - loads slowly

            left = cv2.remap(left, *self.maps[0], cv2.INTER_LINEAR).astype(np.uint8)
            right = cv2.remap(right, *self.maps[1], cv2.INTER_LINEAR).astype(np.uint8)
        count = self._range(left.shape[1], nearest)
        disparity, std = refine(left, right, match(left, right, count))
        share = float(np.mean(np.isfinite(std)))
        if share < FEW:
            other = refine(right, left, match(right, left, count))[1]
            if float(np.mean(np.isfinite(other))) > MANY:
                raise InputError(
                    f"{where}: the cameras are swapped: {share:.1%} of the pixels have a match, "
                    "many more have one the other way round; exchange left and right images"
                )
        rows, columns = np.nonzero(np.isfinite(std[::STEP, ::STEP]))
        rows, columns = STEP * rows, STEP * columns
        apart = disparity[rows, columns].astype(np.float64) - self.shift
        true = apart > LEAST * left.shape[1]
        rows, columns, apart = rows[true], columns[true], apart[true]
        rays = np.column_stack(
            [columns - self.centre[0], rows - self.centre[1], np.full(len(rows), self.focal)]
        )
        points = self.turn.apply(rays * (self.baseline / apart)[:, None])
        ranges = np.linalg.norm(points, axis=1)
        return Scan(points, ranges * std[rows, columns] / apart, (WINDOW / STEP) ** 2)

    def _range(self, width: int, nearest: float) -> int:
        """Choose the number of disparities, a multiple of 16."""
        most = WIDEST * width
        if nearest > 0:
            # A point at the image's edge is nearer along z than along its ray.
            most = min(most, 1.5 * self.focal * self.baseline / nearest)
        return 16 * max(1, int(np.ceil((most + max(self.shift, 0.0)) / 16)))


def make_rig(
    left: CameraModel, right: CameraModel, between: Poses | None = None, *, rectified: bool = False
) -> Rig:
    """Combine two cameras; `between` is ``T_left_right``, if known apart from the calibration."""
    pl, pr = left.projection, right.projection
    offset = 0.0 if pl is None or pr is None else float(pl[0, 3] - pr[0, 3]) / float(pl[0, 0])
    if offset == 0.0 and rectified and between is not None:
        offset = float(between.translation[0, 0])
    if offset == 0.0 and between is not None and float(np.linalg.norm(between.translation)) > 1e-6:
        return _aligned(left, right, between)
    what = f"{left.where} and {right.where}"
    if offset == 0.0:
        raise InputError(
            f"{what}: there is no baseline: P of the right camera has 0 as its fourth number, and "
            "nothing else says how far apart the cameras are"
        )
    if offset < 0.0:
        raise InputError(
            f"{what}: the cameras are swapped: the right one is {-offset:.3f} m left of the other; "
            "name them the other way round"
        )
    left_p, right_p = (left.matrix if pl is None else pl), (right.matrix if pr is None else pr)
    maps = None
    if not rectified:
        maps = (_maps(left, left.rectification, left_p), _maps(right, right.rectification, right_p))
    return Rig(
        left,
        right,
        float(left_p[0, 0]),
        (float(left_p[0, 2]), float(left_p[1, 2])),
        float(left_p[0, 2] - right_p[0, 2]),
        offset,
        # As in ROS, the frame of a camera is that of its rectified image.
        Rotation.identity(),
        maps,
    )


def _aligned(left: CameraModel, right: CameraModel, between: Poses) -> Rig:
    """Turn both cameras so that their rows lie along the baseline."""
    aside = between.translation[0]
    baseline = float(np.linalg.norm(aside))
    x = aside / baseline
    if abs(x[0]) > abs(x[1]) and x[0] < 0:
        raise InputError(
            f"{left.where} and {right.where}: the cameras are swapped: the right one is "
            f"{baseline:.3f} m left of the other; name them the other way round"
        )
    turned = between.rotation[0].as_matrix()
    ahead = np.array([0.0, 0.0, 1.0]) + turned[:, 2]
    across = np.cross(ahead, x).astype(np.float64)
    y = across / np.linalg.norm(across)
    z = np.cross(x, y).astype(np.float64)
    axes = np.column_stack([x, y, z])  # of the rectified frame, in the left one
    focal = 0.5 * float(left.matrix[1, 1] + right.matrix[1, 1])
    centre = 0.5 * (np.array(left.size) - 1.0)
    matrix = np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])
    maps = (_maps(left, axes.T, matrix), _maps(right, axes.T @ turned, matrix))
    where = (float(centre[0]), float(centre[1]))
    return Rig(left, right, focal, where, 0.0, baseline, Rotation.from_matrix(axes), maps)


def _maps(camera: CameraModel, turn: Array | None, projection: Array) -> Maps:
    import cv2  # noqa: PLC0415 - loads slowly

    turn = np.eye(3) if turn is None else turn
    make = cv2.fisheye.initUndistortRectifyMap if camera.fisheye else cv2.initUndistortRectifyMap
    distortion = camera.distortion if len(camera.distortion) else np.zeros(4)
    matrix = np.ascontiguousarray(projection[:, :3])
    along, down = make(camera.matrix, distortion, turn, matrix, camera.size, cv2.CV_32FC1)
    return along.astype(np.float32), down.astype(np.float32)


def match(left: GreyImage, right: GreyImage, count: int) -> PixelMap:
    """Find the disparity of each pixel of the left image, of 0 or less where there is none."""
    import cv2  # noqa: PLC0415 - loads slowly

    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=count,
        blockSize=BLOCK,
        P1=8 * BLOCK**2,
        P2=32 * BLOCK**2,
        disp12MaxDiff=1,
        preFilterCap=31,
        uniquenessRatio=UNIQUE,
        speckleWindowSize=ISLAND,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    return matcher.compute(left, right).astype(np.float32) / 16.0


def refine(left: GreyImage, right: GreyImage, coarse: PixelMap) -> tuple[PixelMap, PixelMap]:
    """Refine disparities; give them with their standard deviations, NaN where there is none."""
    matched = coarse > 0
    weight = matched.astype(np.float32)
    share = _least(_mean(weight), 1e-3)
    disparity = np.where(matched, coarse, np.float32(0))
    smooth = _mean(disparity * weight) / share
    scatter = _off_plane(_mean(disparity * disparity * weight) / share, smooth)
    shifted = _shift(left, right, smooth, weight, share)
    smooth = _mean(shifted.disparity * weight) / share
    shifted = _shift(left, right, smooth, weight, share)
    disparity = shifted.disparity
    level = _mean(disparity * weight) / share
    bend = _off_plane(_mean(disparity * disparity * weight) / share, level)
    good = matched & (share > 0.9) & (scatter < ROUGHEST) & (bend < BENT)
    good &= np.maximum(np.abs(disparity - coarse), np.abs(shifted.shift)) < MOVED
    good &= shifted.texture > LEAST_TEXTURE**2
    good_share = good.astype(np.float32)
    good &= _mean(good_share, WIDE) > MATCHED
    parts = (shifted.variance, bend, _curvature(np.where(matched, disparity, level)), 1.0)
    variance = sum(np.float32(factor) * part for factor, part in zip(NOISE, parts, strict=True))
    return disparity, np.where(good, np.sqrt(variance), np.float32(np.nan))


@dataclass(frozen=True, eq=False)
class _MatchStep:
    """What a step of least-squares matching finds at each pixel."""

    disparity: PixelMap
    shift: PixelMap  # from the disparity that it began with [pixels]
    texture: PixelMap  # mean square of the slope along the row [(grey levels / pixel)²]
    variance: PixelMap  # of the shift, if the window were a plane [pixels²]


def _shift(
    left: GreyImage, right: GreyImage, smooth: PixelMap, weight: PixelMap, share: PixelMap
) -> _MatchStep:
    """Explain what differs between the left image and the moved right one by a shift."""
    import cv2  # noqa: PLC0415 - loads slowly

    one = left.astype(np.float32)
    columns, rows = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in one.shape[::-1]))
    moved = cv2.remap(
        right.astype(np.float32),
        columns - smooth,
        rows,
        cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    ).astype(np.float32)
    slope = cv2.Sobel(np.float32(0.5) * (one + moved), cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    (level, contrast), (other, other_contrast) = _statistics(one), _statistics(moved)
    gain = np.sqrt(np.clip(contrast / other_contrast, np.float32(0.25), np.float32(4.0)))
    difference = (one - level) - (moved - other) * gain
    texture = _least(_mean(slope * slope * weight) / share, 1e-3)
    along = _mean(slope * difference * weight) / share
    shift = -along / texture
    unexplained = _least(_mean(difference * difference * weight) / share + along * shift, 0.0)
    variance = unexplained / (texture * share * np.float32(WINDOW**2))
    disparity = smooth + np.clip(shift, np.float32(-1), np.float32(1))
    return _MatchStep(disparity, shift, texture, variance)


def _statistics(image: PixelMap) -> tuple[PixelMap, PixelMap]:
    level = _mean(image)
    return level, _least(_mean(image * image) - level * level, 1e-2)


def _mean(layer: PixelMap, side: int = WINDOW) -> PixelMap:
    import cv2  # noqa: PLC0415 - loads slowly

    return cv2.boxFilter(layer, -1, (side, side)).astype(np.float32, copy=False)


def _least(layer: PixelMap, least: float) -> PixelMap:
    return np.maximum(layer, np.float32(least))


def _curvature(layer: PixelMap) -> PixelMap:
    """The sum of the squares of both second differences across the window."""
    import cv2  # noqa: PLC0415 - loads slowly

    one, apart = np.ones(1, np.float32), np.zeros(WINDOW + 2, np.float32)
    apart[[0, WINDOW // 2 + 1, -1]] = 1.0, -2.0, 1.0
    across, down = (
        cv2.sepFilter2D(layer, cv2.CV_32F, *kernels, borderType=cv2.BORDER_REPLICATE)
        for kernels in ((apart, one), (one, apart))
    )
    return across * across + down * down


def _off_plane(squares: PixelMap, level: PixelMap) -> PixelMap:
    """Subtract the share of a plane from the variance within the window."""
    import cv2  # noqa: PLC0415 - loads slowly

    across, down = (
        cv2.Sobel(level, cv2.CV_32F, *axis, ksize=3, scale=1 / 8) for axis in ((1, 0), (0, 1))
    )
    inclined = (across * across + down * down) * np.float32((WINDOW**2 - 1) / 12)
    return _least(squares - level * level - inclined, 0.0)
