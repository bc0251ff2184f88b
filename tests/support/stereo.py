"""Renders stereo pairs over known ground: texture, blur, noise and changing exposure."""

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from gpgrad_core.recordings.trajectory import Poses
from gpgrad_core.se2 import SE2
from gpgrad_core.simulation.params import SimulationParams, stream
from gpgrad_core.simulation.rover import sensor_pose
from gpgrad_core.simulation.terrain import HeightField, make_terrain

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

    def projection(self, *, right: bool = False) -> np.ndarray:
        """P of one of the cameras."""
        return _projection(self.focal, self.centre, self.baseline if right else 0.0)

    def rays(self) -> np.ndarray:
        """Directions of all pixels in the camera's frame, with z = 1 (rows, columns, 3)."""
        x = (np.arange(self.width) - self.centre[0]) / self.focal
        y = (np.arange(self.height) - self.centre[1]) / self.focal
        u, v = np.meshgrid(x, y)
        return np.stack([u, v, np.ones_like(u)], axis=-1)


def _projection(focal: float, centre: tuple[float, float], aside: float) -> np.ndarray:
    x, y = centre
    return np.array([[focal, 0, x, -focal * aside], [0, focal, y, 0], [0, 0, 1, 0]])


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
    return _projection(FOCAL, CENTRE, BASELINE if right else 0.0)


def driven(count: int) -> Poses:
    """Poses of the body, straight ahead along a line that is turned."""
    along = STEP * np.arange(count)
    turn = np.full(count, 0.3)
    places = np.column_stack([np.cos(0.3) * along, np.sin(0.3) * along, np.zeros(count)])
    return Poses(places, Rotation.from_euler("z", turn[:, None]))


@dataclass(frozen=True, eq=False)
class Filmed:
    """What a rectified pair of cameras saw of a drive."""

    size: tuple[int, int]  # width, height [pixels]
    projections: tuple[np.ndarray, np.ndarray]  # P of the left and of the right camera
    mount: Poses  # ``T_body_camera`` of the left one
    body: Poses  # at each pair
    pairs: list[tuple[np.ndarray, np.ndarray]]
    depths: list[np.ndarray]  # of the pixels of each left image [m]; NaN where there is none

    def millimetres(self, k: int) -> np.ndarray:
        """Depths as cameras give them; 0 where there is none."""
        return np.rint(1000 * np.nan_to_num(self.depths[k])).astype(np.uint16)

    def cloud(self, k: int, count: int) -> np.ndarray:
        """Some of the points of a pair, drawn at random, in the camera's frame [m]."""
        rows, columns = np.nonzero(np.isfinite(self.depths[k]))
        drawn = np.random.default_rng(k).choice(len(rows), min(count, len(rows)), replace=False)
        pixels = np.stack([columns[drawn], rows[drawn], np.ones(len(drawn))])
        z = self.depths[k][rows[drawn], columns[drawn]]
        return (np.linalg.inv(self.projections[0][:, :3]) @ pixels).T * z[:, None]


def level_drive(count: int = 3) -> Filmed:
    """Drive over the plane; the first rows have no depth."""
    depths = level_depths()
    depths[:4] = np.nan
    pairs = [level_pair(k) for k in range(count)]
    both = projection(), projection(right=True)
    return Filmed(SIZE, both, MOUNT, driven(count), pairs, [depths] * count)


LOOKS_DOWN, RADIUS, STOPS, WIDER = 0.35, 3.0, 26, 0.3
"""Of the camera [rad]; and of a drive around a circle [m], whose second lap is wider."""
MISMATCH = 0.08
"""Standard deviation of the disparities that depths are made of [pixels]."""


def rendered_drive() -> Filmed:
    """Drive over simulated ground, once around and on over what was seen."""
    params, camera = SimulationParams(seed=3, extent=40.0), Camera().small()
    angles = np.arange(STOPS) / RADIUS
    radii = RADIUS + WIDER * (angles > 2 * np.pi)
    x, y = 0.5 * params.extent + radii * np.array([np.cos(angles), np.sin(angles)])
    ground = make_terrain(params, np.column_stack([x, y]), stream(params.seed, 1))
    stops = map(SE2, x.tolist(), y.tolist(), (angles + np.pi / 2).tolist())
    body = Poses.of(*(sensor_pose(ground, stop, params) for stop in stops))
    down = Rotation.from_euler("y", LOOKS_DOWN) * OPTICAL
    mount = Poses(np.array([[0.1, 0.06, 0.0]]), Rotation.from_matrix([down.as_matrix()]))
    rng = np.random.default_rng(0)
    pairs, depths = [], []
    for k in range(STOPS):
        left, right, depth = render(ground, body[k : k + 1] @ mount, camera, rng)
        off = MISMATCH * rng.standard_normal(depth.shape) / (camera.focal * camera.baseline)
        pairs.append((left, right))
        depths.append(depth / (1.0 + off * depth))
    both = camera.projection(), camera.projection(right=True)
    return Filmed((camera.width, camera.height), both, mount, body, pairs, depths)
