"""A synthetic recording: the scans of a rover's sensor along its drive."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds.ply import write_ply
from gpgrad_core.io.folder import SIMULATED, check_vacant, new_folder
from gpgrad_core.io.poses import pose_row
from gpgrad_core.reading.text import write_lines
from gpgrad_core.run import Progress, silent
from gpgrad_core.se2 import Pose
from gpgrad_core.simulation.params import ODOMETRY_STREAM, SCAN_STREAM, SimulationParams, stream
from gpgrad_core.simulation.routes import STEP, Track, plan_track
from gpgrad_core.simulation.rover import scan, sensor_pose
from gpgrad_core.simulation.simulate import ATTITUDE_STD, drift, true_pose
from gpgrad_core.simulation.terrain import ElevationModel, HeightField, make_ground

START, PERIOD = 1_700_000_000.0, 0.1
"""Time at which the drive begins, and time from scan to scan [s]."""
POSES_A_SCAN = 2
"""Poses per scan: odometry is faster than the sensor. No pose has the time of a scan."""
TURN_LENGTH = 1.0
"""A turn on the spot by a radian takes as long as driving this far [m]."""
SUDDEN = 0.5
"""A larger change of the heading from one point of the track to the next is a turn on the spot
[rad]."""


def simulate_recording(
    directory: Path | str,
    num_scans: int,
    params: SimulationParams | None = None,
    *,
    points_a_scan: int | None = None,
    terrain: ElevationModel | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
) -> None:
    """Simulate a drive and write the recording: scans, odometry and true poses.

    `build_dataset` can read the folder. ``scans/`` has the clouds in the sensor's frame, named by
    their time; ``times.txt`` has their times, so that a copy that lacks scans is found out;
    ``poses.txt`` has the sensor's poses by odometry and ``poses_gt.txt`` the true ones, both as
    TUM rows. The folder appears when all of it is written.

    Args:
        directory: Folder to make; it must not exist or be empty.
        num_scans: Number of scans, evenly spread over the drive and its turn on the spot.
        params: Ground, route, sensor and odometry.
        points_a_scan: A scan with more points is thinned to this many; None keeps all.
        terrain: Elevation model to drive over; None makes the ground.
        overwrite: Whether to replace a recording that was simulated.
        progress: Called once per scan.

    Raises:
        InputError: If the directory is taken, another process is writing it, the route does not
            fit into the extent, or there are fewer than two scans.
    """
    directory, params = Path(directory), params or SimulationParams()
    check_vacant(directory, overwrite=overwrite)
    if num_scans < 2:
        raise InputError(f"a recording needs 2 or more scans, got {num_scans}")
    if params.route == "roaming":
        raise InputError("the route roaming makes submaps, not scans; choose another route")
    track = _with_turns(plan_track(params))
    with new_folder(directory, overwrite=overwrite) as unfinished:
        ground = make_ground(params, track.xy, terrain)
        spacing = track.length / (num_scans - 1)
        _write_poses(unfinished, num_scans, spacing, track, ground, params)
        stamps = [f"{START + k * PERIOD:.6f}" for k in range(num_scans)]
        write_lines(unfinished / "times.txt", stamps)
        (unfinished / "scans").mkdir()
        for k, stamp in enumerate(stamps):
            rng = stream(params.seed, SCAN_STREAM, k)
            stop = track.between(k * spacing)
            points = scan(ground, stop, params, rng)
            if points_a_scan is not None and len(points) > points_a_scan:
                points = points[np.sort(rng.choice(len(points), points_a_scan, replace=False))]
            sensor = sensor_pose(ground, stop, params)
            local = (points - sensor.translation) @ sensor.rotation
            write_ply(unfinished / "scans" / f"{stamp}.ply", local)
            progress((k + 1) / num_scans)


def _with_turns(track: Track) -> Track:
    """Let the rover take its time where it turns on the spot."""
    change = np.diff(np.unwrap(track.yaw))
    xy, yaw = [track.xy[:1]], [track.yaw[:1]]
    for k, turn in enumerate(change):
        steps = int(np.ceil(abs(turn) * TURN_LENGTH / STEP)) if abs(turn) > SUDDEN else 1
        xy.append(np.repeat(track.xy[k + 1 : k + 2], steps, axis=0))
        yaw.append(track.yaw[k] + turn * np.arange(1, steps + 1) / steps)
    return Track(np.vstack(xy), np.concatenate(yaw))


def _write_poses(
    directory: Path,
    num_scans: int,
    spacing: float,
    track: Track,
    terrain: HeightField,
    params: SimulationParams,
) -> None:
    """Write the sensor's poses, from just before the first scan to just after the last."""
    rng = stream(params.seed, ODOMETRY_STREAM)
    step = spacing / POSES_A_SCAN
    distances = step * (np.arange(POSES_A_SCAN * num_scans + 1) - 0.5)
    stops = [track.between(distance) for distance in distances]
    ground = [true_pose(terrain, stop) for stop in stops]
    estimated = drift(ground, params, rng, step)
    truth = [sensor_pose(terrain, stop, params) for stop in stops]
    head = "# timestamp tx ty tz qx qy qz qw   (p_world = R p_sensor + t)"
    true_rows, odometry_rows = [f"# {SIMULATED}", head], [f"# {SIMULATED}", head]
    for distance, level, wrong, true in zip(distances, ground, estimated, truth, strict=True):
        # Drift moves and turns the rover as a whole; an inertial unit measures its tilt.
        moved = Rotation.from_quat(wrong.quaternion) * Rotation.from_quat(level.quaternion).inv()
        tilt = Rotation.from_rotvec([*(ATTITUDE_STD * rng.standard_normal(2)), 0.0])
        rotation = tilt * moved * Rotation.from_quat(true.quaternion)
        position = wrong.translation + moved.apply(true.translation - level.translation)
        pose = Pose(position, rotation.as_quat(canonical=True))
        stamp = f"{START + PERIOD * distance / spacing:.6f}"
        true_rows.append(pose_row(stamp, true))
        odometry_rows.append(pose_row(stamp, pose))
    for name, rows in (("poses_gt.txt", true_rows), ("poses.txt", odometry_rows)):
        write_lines(directory / name, rows)
