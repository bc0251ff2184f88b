"""Renders stereo pairs over known ground: texture, blur, noise and changing exposure."""

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from gpgrad_core.recordings.trajectory import Poses
from gpgrad_core.simulation.terrain import HeightField

OPTICAL = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""``R_body_camera`` of a camera that looks ahead: x right, y down, z ahead."""
NEAREST, GROWTH, BISECTIONS = 0.6, 1.015, 10
OCTAVES, FINEST = 7, 0.003
"""The texture has this many octaves; the finest has cells of this size [m]."""


@dataclass(frozen=True)
class Camera:
    """A rectified pair of pinhole cameras, and what spoils its images."""

    width: int = 640
    height: int = 480
    focal: float = 500.0  # [pixels]
    baseline: float = 0.12  # [m]
    blur: float = 0.7  # standard deviation of the optics' blur [pixels]
    noise: float = 1.5  # standard deviation of the noise [grey levels]
    exposure: float = 0.3  # largest relative change from pair to pair
    unequal: float = 0.05  # largest relative difference between the two cameras
    furthest: float = 15.0  # [m]

    @property
    def centre(self) -> tuple[float, float]:
        return (self.width - 1) / 2, (self.height - 1) / 2

    def small(self) -> "Camera":
        """Half the size: a fifth of the time."""
        return replace(self, width=self.width // 2, height=self.height // 2, focal=self.focal / 2)

    def rays(self) -> np.ndarray:
        """Directions of all pixels in the camera's frame, with z = 1 (rows, columns, 3)."""
        x = (np.arange(self.width) - self.centre[0]) / self.focal
        y = (np.arange(self.height) - self.centre[1]) / self.focal
        u, v = np.meshgrid(x, y)
        return np.stack([u, v, np.ones_like(u)], axis=-1)


@cache
def _octaves() -> list[np.ndarray]:
    rng = np.random.default_rng(7)
    white = (rng.normal(size=(512, 512)).astype(np.float32) for _ in range(OCTAVES))
    made = (ndimage.gaussian_filter(octave, 0.8, mode="wrap") for octave in white)
    return [octave / octave.std() for octave in made]


def _albedo(x: np.ndarray, y: np.ndarray, footprint: np.ndarray) -> np.ndarray:
    """Brightness of the ground's material; detail finer than a pixel's footprint averages out."""
    value = np.zeros(x.shape, np.float32)
    for k, octave in enumerate(_octaves()):
        cell = FINEST * 2.0**k
        turned = np.cos(k) * x - np.sin(k) * y, np.sin(k) * x + np.cos(k) * y
        at = [np.mod(axis / cell, 512).astype(np.float32) for axis in turned]
        share = 1.0 / (1.0 + (footprint / (2.0 * cell)) ** 4)
        value += share.astype(np.float32) * cv2.remap(
            octave, *at, cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP
        )
    return 1.0 + 0.16 * value


def cast(ground: HeightField, eye: np.ndarray, rays: np.ndarray, furthest: float) -> np.ndarray:
    """Depth z at which each ray (rows, columns, 3) meets the ground [m]; NaN if it does not."""
    elevation = ground.elevation.astype(np.float32)
    x0, y0 = ground.origin

    def above(depth: np.ndarray) -> np.ndarray:
        at = [
            ((eye[k] - (x0, y0)[k] + depth * rays[..., k]) / ground.resolution).astype(np.float32)
            for k in range(2)
        ]
        height = cv2.remap(elevation, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return eye[2] + depth * rays[..., 2] - height

    shape = rays.shape[:2]
    low, high = np.full(shape, NEAREST), np.full(shape, np.nan)
    depth, found = NEAREST, np.zeros(shape, bool)
    while depth < furthest:
        further = depth * GROWTH
        hit = ~found & (above(np.full(shape, further)) <= 0)
        low[hit], high[hit] = depth, further
        found |= hit
        depth = further
    high = np.where(found, high, low)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        over = above(middle) > 0
        low, high = np.where(over, middle, low), np.where(over, high, middle)
    return np.where(found, 0.5 * (low + high), np.nan)


def render(
    ground: HeightField, pose: Poses, camera: Camera, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Render a pair from the pose of the left camera; also give the left image's true depth [m]."""
    turn = pose.rotation[0].as_matrix()
    rays = camera.rays() @ turn.T
    gain = 1.0 + camera.exposure * rng.uniform(-1, 1)
    dy, dx = np.gradient(ground.elevation.astype(np.float32), ground.resolution)
    images, depths = [], []
    for side in (0.0, camera.baseline):
        eye = pose.translation[0] + side * turn[:, 0]
        depth = cast(ground, eye, rays, camera.furthest)
        seen = np.isfinite(depth)
        at = np.where(seen, depth, 1.0)
        x, y = eye[0] + at * rays[..., 0], eye[1] + at * rays[..., 1]
        cells = [
            ((v - o) / ground.resolution).astype(np.float32)
            for v, o in zip((x, y), ground.origin, strict=True)
        ]
        gx, gy = (
            cv2.remap(g, *cells, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for g in (dx, dy)
        )
        light = (0.5 - 0.6 * gx + 0.3 * gy) / np.sqrt(1 + gx**2 + gy**2)
        steepness = np.maximum(np.abs(rays[..., 2]) / np.linalg.norm(rays, axis=-1), 0.05)
        footprint = at / camera.focal / np.sqrt(steepness)
        value = 110.0 * np.clip(0.35 + light, 0.1, 2.0) * _albedo(x, y, footprint)
        value = np.where(seen, value, 200.0).astype(np.float32)
        if camera.blur:
            value = cv2.GaussianBlur(value, (0, 0), camera.blur)
        value *= gain * (1.0 + camera.unequal * rng.uniform(-1, 1))
        value += camera.noise * rng.standard_normal(value.shape)
        images.append(np.clip(np.rint(value), 0, 255).astype(np.uint8))
        depths.append(depth)
    return images[0], images[1], depths[0]


SIZE, FOCAL, CENTRE, BASELINE, HEIGHT = (240, 180), 250.0, (119.5, -20.0), 0.12, 1.0
"""Of cameras that look ahead from a level plane; their horizon is above the image."""
MOUNT = Poses(np.array([[0.2, 0.06, HEIGHT]]), Rotation.from_matrix([OPTICAL.as_matrix()]))
"""``T_body_camera`` of the left one."""
STEP = 0.5


def level_pair(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Make a pair of images of a textured plane."""
    width, height = SIZE
    rng = np.random.default_rng(seed)
    wide = ndimage.gaussian_filter(rng.normal(size=(height, width + 60)), 1.0)
    wide = np.clip(128 + 120 * wide / wide.std() / 3, 0, 255).astype(np.float32)
    columns, rows = np.meshgrid(
        np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)
    )
    apart = (BASELINE / HEIGHT * (rows - CENTRE[1])).astype(np.float32)
    right = cv2.remap(wide, columns + apart, rows, cv2.INTER_CUBIC)
    return np.rint(wide[:, :width]).astype(np.uint8), np.clip(np.rint(right), 0, 255).astype(
        np.uint8
    )


def level_depths() -> np.ndarray:
    """Depth of each pixel of the left camera [m]."""
    rows = np.arange(SIZE[1])
    return np.repeat((FOCAL * HEIGHT / (rows - CENTRE[1]))[:, None], SIZE[0], axis=1)


def projection(right: bool = False) -> np.ndarray:
    """P of one of the cameras."""
    shift = -FOCAL * BASELINE if right else 0.0
    return np.array([[FOCAL, 0, CENTRE[0], shift], [0, FOCAL, CENTRE[1], 0], [0, 0, 1, 0]])


def driven(count: int) -> Poses:
    """Poses of the body, straight ahead along a line that is turned."""
    along = STEP * np.arange(count)
    turn = np.full(count, 0.3)
    places = np.column_stack([np.cos(0.3) * along, np.sin(0.3) * along, np.zeros(count)])
    return Poses(places, Rotation.from_euler("z", turn[:, None]))
