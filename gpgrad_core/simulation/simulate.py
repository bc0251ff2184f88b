"""Simulates a dataset with true poses: terrain, rover, submaps and odometry."""

from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.ground import submap_of_cloud
from gpgrad_core.io.clouds import voxel_means
from gpgrad_core.io.clouds.ply import write_ply
from gpgrad_core.io.folder import CLOUD_FOLDER, check_vacant, new_folder, write_all_but_clouds
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.run.parallel import run_jobs
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.simulation.endless_terrain import EndlessGround
from gpgrad_core.simulation.params import ODOMETRY_STREAM, SUBMAP_STREAM, SimulationParams, stream
from gpgrad_core.simulation.routes import STEP, Track, plan_track
from gpgrad_core.simulation.rover import scan
from gpgrad_core.simulation.terrain import ROWS, ElevationModel, HeightField, make_ground
from gpgrad_core.types import Dataset, Submap

STOP_SPACING = 1.0  # approximate distance between stops, at which the sensor scans [m]
ATTITUDE_STD = 0.003  # standard deviation of the gravity direction at a stop [rad]
BLOCK = 10  # successive submaps that are made at a time
EDGE = 1.0  # of ground beyond what the sensor sees [m]


def simulate_dataset(
    params: SimulationParams,
    progress: Progress = silent,
    *,
    terrain: ElevationModel | None = None,
) -> Dataset:
    """Simulate a rover that drives out over synthetic ground and back, and builds submaps.

    Each submap is gravity-aligned. Its origin is on the ground under its first stop, and x is the
    heading there. Its points are voxel means, rounded to a millimetre and exact in float32. So
    machines that differ in the last bit of a sine make the same dataset, and the written dataset
    equals the one in memory. The same parameters give the same dataset, bit for bit.

    Args:
        params: Parameters of the simulation.
        progress: Called once per submap; may raise Cancelled.
        terrain: Elevation model to drive over; None makes the ground.

    Raises:
        InputError: If the route does not fit into the extent, or the elevation model cannot be
            used.
    """
    world = make_world(params, terrain)
    progress(0.2)
    submaps = tuple(drive_over(world, progress))
    return replace(describe_simulated(params, terrain), submaps=submaps)


def drive_over(world: "SimulatedWorld", progress: Progress = silent) -> Iterator[Submap]:
    """Drive over a world of `make_world`, and give each submap as soon as it is made."""
    params, names, truth = world.params, names_of(world.params), list[Pose]()
    for block in blocks_of(params):
        low, high = (0.2 + 0.8 * k / params.num_submaps for k in (block.start, block.stop))
        views = world.look(block, part(progress, low, high))
        for k, (pose, points) in zip(block, views, strict=True):
            truth.append(pose)
            # What the odometry says of a place does not depend on what comes later.
            estimated = odometry_of(truth, params)[-1]
            yield submap_of_cloud(points, names[k], pose_true=pose, pose_odometry=estimated)


def simulate_into(
    directory: Path | str,
    params: SimulationParams,
    *,
    terrain: ElevationModel | None = None,
    overwrite: bool = False,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> None:
    """Simulate a dataset into a folder; each cloud is written as soon as it is made."""
    check_vacant(directory, overwrite=overwrite)
    check_route(params, terrain)
    plan_track(params)  # refuses a route before the work
    try:
        with new_folder(Path(directory), overwrite=overwrite) as unfinished:
            clouds = unfinished / CLOUD_FOLDER
            clouds.mkdir()
            # Other processes would each make the whole of a ground that has an end.
            beside = executor if params.route == "roaming" else None
            work = partial(_write_block, params, clouds, terrain)
            blocks = run_jobs(work, blocks_of(params), beside, part(progress, 0.0, 0.98))
            truth = [pose for poses in blocks for pose in poses]
            write_all_but_clouds(
                unfinished,
                describe_simulated(params, terrain),
                dict(enumerate(truth)),
                dict(enumerate(odometry_of(truth, params))),
            )
    finally:
        _world_of_this_process.cache_clear()
    progress(1.0)


def _write_block(
    params: SimulationParams,
    folder: Path,
    terrain: ElevationModel | None,
    block: range,
    progress: Progress,
) -> list[Pose]:
    """Make a block of submaps, write their clouds, and give their true poses."""
    names, poses = names_of(params), list[Pose]()
    views = _world_of_this_process(params, terrain).look(block, progress)
    for k, (pose, points) in zip(block, views, strict=True):
        write_ply(folder / f"{names[k]}.ply", points)
        poses.append(pose)
    return poses


@dataclass(frozen=True, eq=False)
class SimulatedWorld:
    """The ground, and the drive over it."""

    params: SimulationParams  # what they were made from
    track: Track  # the drive
    ground: HeightField | EndlessGround  # the whole ground, or one that is made where it is needed

    def look(
        self, block: range, progress: Progress = silent
    ) -> Iterator[tuple[Pose, Float[Array, "n 3"]]]:
        """Make some successive submaps: the true pose of each, and the points in its frame [m]."""
        ground, params = self.ground, self.params
        if isinstance(ground, EndlessGround):
            first, last = (round(k * params.spacing / STEP) for k in (block.start, block.stop))
            near = self.track.xy[first : last + 2]
            margin = params.max_range + EDGE
            ground = ground.window(near.min(axis=0) - margin, near.max(axis=0) + margin)
        for k in block:
            pose = true_pose(ground, self.track.at(k * params.spacing))
            points = _make_submap(ground, self.track, k, params)
            progress((k + 1 - block.start) / len(block))
            yield pose, points


def check_route(params: SimulationParams, terrain: ElevationModel | None) -> None:
    """Refuse the route roaming over an elevation model, which has an end."""
    if terrain is not None and params.route == "roaming":
        raise InputError(
            f"{terrain.path}: the route roaming makes its own ground; choose another route"
        )


def make_world(params: SimulationParams, terrain: ElevationModel | None = None) -> SimulatedWorld:
    """Plan the drive and make the ground."""
    check_route(params, terrain)
    track = plan_track(params)
    if params.route == "roaming":
        return SimulatedWorld(params, track, EndlessGround(params, track.xy))
    return SimulatedWorld(params, track, make_ground(params, track.xy, terrain))


_world_of_this_process = lru_cache(maxsize=1)(make_world)


def blocks_of(params: SimulationParams) -> list[range]:
    """Divide the submaps into blocks that need nearly the same ground."""
    count = params.num_submaps
    return [range(k, min(k + BLOCK, count)) for k in range(0, count, BLOCK)]


def names_of(params: SimulationParams) -> list[str]:
    """Name the submaps: their numbers, with as many digits as the last one has, at least three."""
    digits = max(3, len(str(params.num_submaps - 1)))
    return [f"{k:0{digits}d}" for k in range(params.num_submaps)]


def odometry_of(truth: list[Pose], params: SimulationParams) -> list[Pose]:
    """Simulate the odometry between submaps."""
    return drift(truth, params, stream(params.seed, ODOMETRY_STREAM), params.spacing)


def describe_simulated(params: SimulationParams, terrain: ElevationModel | None = None) -> Dataset:
    """Describe a simulated dataset, without its submaps."""
    ground = "Synthetic ground with craters, ripples and rocks"
    if params.ground in ROWS:
        ground = f"Synthetic {params.ground} {params.row_spacing:g} m apart"
    if terrain is not None:
        ground = (
            f"Ground of {terrain.path.name} at the scale {terrain.scale:g}, heights times "
            f"{terrain.exaggeration:g}, with rocks"
        )
    drove = f"drove out on a {params.route.replace('_', ' ')} route and back"
    if params.route == "roaming":
        drove = "roamed over it"
    return Dataset(
        f"simulated-{params.seed}",
        (),
        description=(f"{ground}; a rover {drove} (gpgrad simulate, seed {params.seed})."),
        sensor_noise=dict(zip(("constant", "quadratic"), params.range_noise, strict=True)),
    )


def true_pose(terrain: HeightField, stop: SE2) -> Pose:
    """Compute the pose of the level frame on the ground under the rover."""
    ground = float(terrain.height(np.array([[stop.x, stop.y]]))[0])
    return _level_pose(stop.x, stop.y, ground, stop.yaw)


def _level_pose(x: float, y: float, z: float, yaw: float) -> Pose:
    x, y, z = np.round([x, y, z], 6).tolist()
    return Pose.from_planar(SE2(x, y, yaw), z)


def drift(truth: list[Pose], params: SimulationParams, rng: Generator, step: float) -> list[Pose]:
    """Simulate odometry: each step has a small error of its length and of its heading."""
    estimated = [truth[0]]
    more = np.sqrt(params.spacing / step)
    for before, after in pairwise(truth):
        motion = before.planar.inverse() @ after.planar
        length_error, height_error = more * rng.normal(0.0, params.odometry_drift, 2)
        turn_error = rng.normal(0.0, params.heading_drift * np.sqrt(step))
        # Half of the heading's error is reached in the middle of the step.
        off_course = SE2(yaw=0.5 * turn_error)
        x, y = off_course.rotation @ (motion.translation * (1.0 + length_error))
        last = estimated[-1]
        here = last.planar @ SE2(float(x), float(y), motion.yaw + turn_error)
        climb = float(after.translation[2] - before.translation[2])
        z = float(last.translation[2]) + climb + step * height_error
        estimated.append(_level_pose(here.x, here.y, z, here.yaw))
    return estimated


def _make_submap(
    terrain: HeightField, track: Track, index: int, params: SimulationParams
) -> Float[Array, "n 3"]:
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
