"""What the sensor of a simulated rover sees."""

import numpy as np
from jaxtyping import Float
from numpy.random import Generator
from scipy import ndimage
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.terrain import HeightField

ANGULAR_STEP = 0.008  # between neighbouring rays [rad]
RAY_STEP = 0.02  # along a ray, over the ground [m]
LOWEST, HIGHEST = -1.2, 0.15  # elevation angles that the camera of a level rover sees [rad]
LOWEST_RING, HIGHEST_RING = -0.5, 0.35  # elevation angles of the LiDAR's rings [rad]
WHEELBASE = 0.8  # a wheel stands half of this ahead, behind and on either side [m]
PATCH = 8  # side of a patch in which stereo fails, or errs, as a whole [rays]


def sensor_pose(terrain: HeightField, stop: SE2, params: SimulationParams) -> Pose:
    """Compute the sensor's pose in the world, tilted with the rover by the ground; x is forward."""
    eye, pitch, roll = _stand(terrain, stop, params)
    turn = Rotation.from_euler("ZYX", [stop.yaw, pitch, roll])
    return Pose(eye, turn.as_quat(canonical=True))


def _stand(
    terrain: HeightField, stop: SE2, params: SimulationParams
) -> tuple[Float[Array, "3"], float, float]:
    """Place the rover on the ground: its sensor's position [m], its pitch and roll [rad]."""
    wheels = 0.5 * WHEELBASE * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    c, s = np.cos(stop.yaw), np.sin(stop.yaw)
    heights = terrain.height(wheels @ np.array([[c, s], [-s, c]]) + np.array([stop.x, stop.y]))
    pitch = np.arctan2(heights[1] - heights[0], WHEELBASE)  # positive: nose down
    roll = np.arctan2(heights[2] - heights[3], WHEELBASE)  # positive: left side up
    eye = np.array([stop.x, stop.y, heights.mean() + params.camera_height])
    return eye, pitch, roll


def scan(
    terrain: HeightField, stop: SE2, params: SimulationParams, rng: Generator
) -> Float[Array, "n 3"]:
    """Measure the ground from one stop, as a camera, a LiDAR or an airborne scanner does.

    Along each azimuth, a ray meets the ground where its angle of elevation first reaches the ray's:
    all rays of one azimuth are traced at once. The points are in the world [m].
    """
    if params.sensor == "airborne":
        return _scan_from_above(terrain, stop, params, rng)
    eye, pitch, roll = _stand(terrain, stop, params)
    c, s = np.cos(stop.yaw), np.sin(stop.yaw)

    # The fan is wider than the field of view, because a tilted rover sees a tilted part of it.
    lidar = params.sensor == "lidar"
    half = np.pi if lidar else 0.5 * params.field_of_view + 0.3
    lowest, highest = (LOWEST_RING, HIGHEST_RING) if lidar else (LOWEST, HIGHEST)
    azimuths = np.arange(-half, half, ANGULAR_STEP)
    angles = np.arange(lowest - 0.5, min(highest + 0.5, 1.4), ANGULAR_STEP)
    ranges, hit = _march(terrain, eye, stop.yaw + azimuths, np.tan(angles), params.max_range)

    azimuth, angle = np.meshgrid(azimuths, angles, indexing="ij")
    forward, left, up = (
        np.cos(angle) * np.cos(azimuth),
        np.cos(angle) * np.sin(azimuth),
        np.sin(angle),
    )
    # To the tilted rover's frame: undo the pitch about its y axis, then the roll about x.
    nose = np.cos(pitch) * forward - np.sin(pitch) * up
    top = np.sin(pitch) * forward + np.cos(pitch) * up
    side = np.cos(roll) * left + np.sin(roll) * top
    top = np.cos(roll) * top - np.sin(roll) * left
    elevation = np.arcsin(np.clip(top, -1.0, 1.0))
    if lidar:
        visible = _on_a_ring(elevation, params.lidar_rings)
    else:
        visible = (np.abs(np.arctan2(side, nose)) <= 0.5 * params.field_of_view) & (
            (elevation >= lowest) & (elevation <= highest)
        )
    distance = ranges / np.cos(angle)
    visible &= (
        hit & (distance <= params.max_range) & _matched(ranges.shape, params.dropout_rate, rng)
    )

    constant, quadratic = params.range_noise
    std = constant + quadratic * distance**2
    measured = (distance + std * _errors(distance.shape, params.noise_common, rng))[visible]
    forward, left, up = forward[visible], left[visible], up[visible]
    rays = np.column_stack([c * forward - s * left, s * forward + c * left, up])
    return eye + measured[:, None] * rays


def _errors(shape: tuple[int, ...], common: float, rng: Generator) -> Float[Array, "azimuths rays"]:
    """Draw errors of standard deviation 1, of which neighbours share some of the variance."""
    errors = rng.standard_normal(shape)
    if common == 0:
        return errors
    # Smoothing noise with a Gaussian of s rays leaves 1 / (2 s √π) of its standard deviation.
    half = 0.5 * PATCH
    smooth = ndimage.gaussian_filter(rng.standard_normal(shape), half, mode="wrap")
    shared = 2.0 * half * np.sqrt(np.pi) * smooth
    return np.sqrt(1.0 - common) * errors + np.sqrt(common) * shared


def _scan_from_above(
    terrain: HeightField, stop: SE2, params: SimulationParams, rng: Generator
) -> Float[Array, "n 3"]:
    """Measure the heights of random points in a disc around the stop."""
    density = params.scan_density * (1.0 - params.dropout_rate)
    count = max(3, int(rng.poisson(density * np.pi * params.max_range**2)))
    distance = params.max_range * np.sqrt(rng.random(count))
    bearing = 2.0 * np.pi * rng.random(count)
    around = np.column_stack([np.cos(bearing), np.sin(bearing)])
    xy = np.array([stop.x, stop.y]) + distance[:, None] * around
    heights = terrain.height(xy) + params.noise_constant * rng.standard_normal(count)
    return np.column_stack([xy, heights])


def _march(
    terrain: HeightField, eye: Array, azimuths: Array, slopes: Array, max_range: float
) -> tuple[Float[Array, "azimuths rays"], NDArray[np.bool_]]:
    """Trace all rays; return the horizontal distance of each hit [m], and which rays hit."""
    steps = np.arange(RAY_STEP, max_range + RAY_STEP, RAY_STEP)
    directions = np.column_stack([np.cos(azimuths), np.sin(azimuths)])
    ground = terrain.height(eye[:2] + directions[:, None, :] * steps[None, :, None]) - eye[2]
    horizon = np.maximum.accumulate(ground / steps, axis=1)
    first = np.array([np.searchsorted(row, slopes) for row in horizon])
    hit = (first > 0) & (first < len(steps))
    after = np.clip(first, 1, len(steps) - 1)
    before = after - 1
    # Between the two samples the ground and the ray are lines, and they cross here.
    above = slopes * steps[before] - np.take_along_axis(ground, before, axis=1)
    below = slopes * steps[after] - np.take_along_axis(ground, after, axis=1)
    share = above / np.where(hit, above - below, 1.0)
    return steps[before] + RAY_STEP * np.where(hit, share, 0.0), hit


def _on_a_ring(elevation: Array, num_rings: int) -> NDArray[np.bool_]:
    """Choose the rays nearest to the rings, which are spread evenly over the field of view."""
    spacing = (HIGHEST_RING - LOWEST_RING) / (num_rings - 1)
    ring = np.rint((elevation - LOWEST_RING) / spacing)
    off = np.abs(elevation - LOWEST_RING - ring * spacing)
    return (ring >= 0) & (ring < num_rings) & (off <= 0.5 * ANGULAR_STEP)


def _matched(shape: tuple[int, ...], dropout_rate: float, rng: Generator) -> NDArray[np.bool_]:
    """Draw which rays find something; half of the failures are single rays, half are patches."""
    keep = np.sqrt(1.0 - dropout_rate)
    single = rng.random(shape) < keep
    coarse = rng.random((shape[0] // PATCH + 1, shape[1] // PATCH + 1)) < keep
    patches = coarse.repeat(PATCH, axis=0).repeat(PATCH, axis=1)[: shape[0], : shape[1]]
    return single & patches
