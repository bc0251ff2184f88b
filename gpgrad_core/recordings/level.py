"""Which way is up in a recording, and which points of its scans are used."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.recording import Reader, Recording, Scan
from gpgrad_core.recordings.trajectory import Located, Poses
from gpgrad_core.recordings.voxels import Voxels, reach

GROUND_VOXEL = 0.2
"""Side of the voxels to which points are thinned [m]: the dense ground nearby must not decide."""
TRIM = 2.5
"""Points further from the plane than this many standard deviations do not count as ground."""
LEAST_POINTS = 20


def level_recording(recording: Recording, params: BuildParams) -> tuple[Recording, tuple[str, ...]]:
    """Turn the world so that z points up, and bring the points into the sensor's frame."""
    if params.points_frame == "world" or recording.in_world:
        recording = replace(recording, read=_in_sensor_frame(recording))
    named = up_axis(recording.up if params.up == "auto" else params.up)
    turn = true_turn = rotation_to_z(named)
    notes: tuple[str, ...] = ()
    if params.gravity == "cloud":
        normals = _ground_normals(recording, params)
        up, spread = estimate_up(normals, recording.name)
        off = np.arccos(np.clip(up @ named, -1.0, 1.0))
        notes = (
            f"the direction up, by the ground of {len(normals)} scans, is {np.degrees(off):.1f} "
            "degrees off that of the poses; half of the scans are within "
            f"{np.degrees(spread):.1f} degrees",
        )
        turn = rotation_to_z(up)
    covariance, truth = recording.covariance, recording.truth
    if covariance is not None:
        matrix = turn.as_matrix()
        covariance = matrix @ covariance @ matrix.T
    if truth is not None and not recording.positions_only:
        truth = Located(_rotate(true_turn, truth.poses), truth.valid)
    body = _rotate(turn, recording.body)
    return replace(recording, body=body, covariance=covariance, truth=truth), notes


def _rotate(turn: Rotation, poses: Poses) -> Poses:
    return Poses(turn.apply(poses.translation), turn * poses.rotation)


def _in_sensor_frame(recording: Recording) -> Reader:
    def read(start: int, stop: int) -> Iterator[Scan]:
        for k, scan in zip(range(start, stop), recording.read(start, stop), strict=True):
            yield replace(scan, points=recording.sensor(k).inverse().apply(scan.points))

    return read


def _ground_normals(recording: Recording, params: BuildParams) -> list[Array]:
    normals: list[Array] = []
    for k, scan in recording.sample():
        points = np.asarray(usable(scan, params)[0].points, np.float64)
        turned = recording.sensor(k).rotation.apply(points) if len(points) else points
        normal = ground_normal(turned)
        normals += [] if normal is None else [normal]
    return normals


def usable(scan: Scan, params: BuildParams) -> tuple[Scan, dict[str, int]]:
    """Drop the points that are not finite, too close or too far, and count them."""
    measured = np.asarray(scan.points, np.float64)
    finite = np.asarray(np.isfinite(measured).all(axis=1))
    ranges = np.linalg.norm(np.where(finite[:, None], measured, 0.0), axis=1)
    # Without a given limit, the keys of the voxels still limit the range.
    furthest = min(params.max_range or np.inf, 0.5 * reach(params.voxel_size))
    close, far = finite & (ranges < params.min_range), finite & (ranges > furthest)
    counts = {
        "measured": len(measured),
        "not_finite": int(np.sum(~finite)),
        "too_close": int(np.sum(close)),
        "too_far": int(np.sum(far)),
    }
    valid = finite & ~close & ~far
    std = None if scan.std is None else np.asarray(scan.std, np.float64)[valid]
    return replace(scan, points=measured[valid], std=std), counts


def up_axis(name: str) -> Float[Array, "3"]:
    """The direction of an axis by its name, such as ``-y``."""
    up = np.zeros(3)
    up["xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    return up


def rotation_to_z(up: Float[Array, "3"]) -> Rotation:
    """The smallest rotation that turns a direction to z."""
    cosine = float(np.clip(up[2] / np.linalg.norm(up), -1.0, 1.0))
    axis = np.cross(up, [0.0, 0.0, 1.0])
    length = float(np.linalg.norm(axis))
    if length < 1e-12:  # along z already; a direction that points down is turned about x
        axis, length = np.array([1.0, 0.0, 0.0]), 1.0
    return Rotation.from_rotvec(np.arccos(cosine) * axis / length)


def ground_normal(points: Float[Array, "n 3"]) -> Array | None:
    """Fit a plane to the ground below the sensor, without outliers; its normal (3,) points up."""
    thinned = Voxels.of(points, np.zeros(len(points)), GROUND_VOXEL).points
    if len(thinned) < LEAST_POINTS:
        return None
    ground = thinned
    normal = np.array([0.0, 0.0, 1.0])
    for _ in range(10):
        centre = ground.mean(axis=0)
        normal = np.linalg.eigh(np.cov((ground - centre).T))[1][:, 0]
        height = (thinned - centre) @ normal
        spread = 1.4826 * float(np.median(np.abs(height)))
        chosen = np.abs(height) <= TRIM * max(spread, 1e-6)
        if chosen.sum() < LEAST_POINTS:
            break
        ground = thinned[chosen]
    return normal if ground.mean(axis=0) @ normal < 0 else -normal


def estimate_up(normals: list[Array], where: str) -> tuple[Float[Array, "3"], float]:
    """Estimate up by normals of the ground; also the median angle between it and them [rad]."""
    if not normals:
        raise InputError(
            f"{where}: no scan shows enough ground to find the direction up; "
            "take gravity from the poses"
        )
    stacked = np.array(normals)
    middle = np.median(stacked, axis=0)
    length = float(np.linalg.norm(middle))
    if length < 0.5:
        raise InputError(
            f"{where}: the scans disagree on the direction up; take gravity from the poses"
        )
    up = middle / length
    angles = np.arccos(np.clip(stacked @ up, -1.0, 1.0))
    return up, float(np.median(angles))
