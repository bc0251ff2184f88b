"""Simulates a dataset with true poses: terrain, rover, submaps and odometry."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy.random import PCG64, Generator, SeedSequence

from gpgrad_core.arrays import Array
from gpgrad_core.datasets.rover import Stop, Track, plan_track, scan
from gpgrad_core.datasets.simulation_params import SimulationParams
from gpgrad_core.datasets.terrain import HeightField, make_terrain
from gpgrad_core.datasets.voxel_means import voxel_means
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import Dataset, Submap

STOP_SPACING = 1.0  # approximate distance between stops, at which the sensor scans [m]
ATTITUDE_STD = 0.003  # standard deviation of the gravity direction at a stop [rad]
TERRAIN_STREAM, ODOMETRY_STREAM, SUBMAP_STREAM = 0, 1, 2


def simulate_dataset(params: SimulationParams, progress: Progress = silent) -> Dataset:
    """Simulate a rover that drives out over synthetic ground and back, and builds submaps.

    Each submap is gravity-aligned. Its origin is on the ground under its first stop, and x is the
    heading there. Its points are voxel means, rounded to a millimetre and exact in float32. So
    machines that differ in the last bit of a sine make the same dataset, and the written dataset
    equals the one in memory.

    Args:
        params: Parameters of the simulation. The same parameters give the same dataset, bit for
            bit.
        progress: Called once per submap; may raise Cancelled.

    Returns:
        The dataset, with true poses and odometry.

    Raises:
        InputError: If the route does not fit into the extent.
    """
    track = plan_track(params)
    terrain = make_terrain(params, track.xy, stream(params.seed, TERRAIN_STREAM))
    progress(0.2)
    starts = [track.at(k * params.spacing) for k in range(params.num_submaps)]
    truth = [true_pose(terrain, start) for start in starts]
    odometry = drift(truth, params, stream(params.seed, ODOMETRY_STREAM), params.spacing)
    submaps: list[Submap] = []
    for k in range(params.num_submaps):
        points = _make_submap(terrain, track, k, params)
        submaps.append(
            Submap.from_points(points, f"{k:03d}", pose_true=truth[k], pose_odometry=odometry[k])
        )
        progress(0.2 + 0.8 * (k + 1) / params.num_submaps)
    return Dataset(
        name=f"simulated-{params.seed}",
        submaps=tuple(submaps),
        description=(
            f"Synthetic ground with craters, ripples and rocks; a rover drove out on a "
            f"{params.route.replace('_', ' ')} route and back (gpgrad simulate, "
            f"seed {params.seed})."
        ),
        sensor_noise=dict(zip(("constant", "quadratic"), params.range_noise, strict=True)),
    )


def stream(*path: int) -> Generator:
    """Make an independent random generator, so that one more submap does not change the others.

    Args:
        path: Numbers that identify it; the first is the seed of the simulation.
    """
    return Generator(PCG64(SeedSequence(path)))


def true_pose(terrain: HeightField, stop: Stop) -> Pose:
    """Compute the pose of the level frame on the ground under the rover."""
    ground = float(terrain.height(np.array([[stop.x, stop.y]]))[0])
    return _level_pose(stop.x, stop.y, ground, stop.yaw)


def _level_pose(x: float, y: float, z: float, yaw: float) -> Pose:
    x, y, z = np.round([x, y, z], 6).tolist()
    return Pose.from_planar(SE2(x, y, yaw), z)


def drift(truth: list[Pose], params: SimulationParams, rng: Generator, step: float) -> list[Pose]:
    """Simulate odometry: each step has a small error of its length and of its heading.

    Args:
        truth: True level poses along the drive.
        params: Parameters of the odometry.
        rng: Generator of the errors.
        step: Distance from pose to pose [m]. Many short steps drift as much as a few long ones.

    Returns:
        The poses according to odometry; the first one is the true one.
    """
    believed = [truth[0]]
    more = np.sqrt(params.spacing / step)
    for before, after in pairwise(truth):
        motion = before.planar.inverse() @ after.planar
        length_error, height_error = more * rng.normal(0.0, params.odometry_drift, 2)
        turn_error = rng.normal(0.0, params.heading_drift * np.sqrt(step))
        # Half of the heading's error is reached in the middle of the step.
        off_course = SE2(yaw=0.5 * turn_error)
        x, y = off_course.rotation @ (motion.translation * (1.0 + length_error))
        last = believed[-1]
        here = last.planar @ SE2(float(x), float(y), motion.yaw + turn_error)
        climb = float(after.translation[2] - before.translation[2])
        z = float(last.translation[2]) + climb + step * height_error
        believed.append(_level_pose(here.x, here.y, z, here.yaw))
    return believed


def _make_submap(
    terrain: HeightField, track: Track, index: int, params: SimulationParams
) -> Float[Array, "n 3"]:
    """Combine the scans from the stops of one submap."""
    rng = stream(params.seed, SUBMAP_STREAM, index)
    start_distance = index * params.spacing
    start = track.at(start_distance)
    pose = true_pose(terrain, start)
    # From above, one scan sees everything.
    airborne = params.sensor == "airborne"
    num_stops = 1 if airborne else max(1, round(params.spacing / STOP_SPACING))
    clouds: list[Array] = []
    offset, yaw_error = np.zeros(3), 0.0
    for k in range(num_stops):
        # The last stop lies before the first stop of the next submap: there is no turn between.
        driven = params.spacing / num_stops
        stop = track.at(start_distance + k * driven)
        local = (scan(terrain, stop, params, rng) - pose.translation) @ pose.rotation
        if k > 0:
            offset = offset + params.submap_drift * np.sqrt(driven) * rng.standard_normal(3)
            yaw_error += params.submap_drift * np.sqrt(driven) * rng.standard_normal()
        tilt = ATTITUDE_STD * rng.standard_normal(2)
        clouds.append(_misplace(local, offset, yaw_error, tilt))
    points = voxel_means(np.concatenate(clouds), params.voxel_size)
    if len(points) > params.max_points:
        points = points[np.sort(rng.choice(len(points), params.max_points, replace=False))]
    return np.round(points, 3).astype(np.float32).astype(np.float64)


def _misplace(
    points: Float[Array, "n 3"], offset: Array, yaw_error: float, tilt: Array
) -> Float[Array, "n 3"]:
    """Move points by a small error of the rover's pose, about the submap's origin."""
    small = np.array(
        [
            [0.0, -yaw_error, tilt[0]],
            [yaw_error, 0.0, tilt[1]],
            [-tilt[0], -tilt[1], 0.0],
        ]
    )
    return points + points @ small.T + offset
