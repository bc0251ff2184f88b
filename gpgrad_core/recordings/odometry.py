"""Poses of scans that have none, by KISS-ICP, and where it failed.

KISS-ICP (Vizzo 2023) predicts each pose by the last motion and registers the scan to those before
it. It always gives a pose. Whether the pose means anything is measured here: by the overlap, by how
far the pose is from its prediction, and by a second registration from a start beside the first,
which ends in the same place if the ground holds the scan.
"""

from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError, told_apart
from gpgrad_core.libraries import load_library
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.recording import Recording
from gpgrad_core.recordings.trajectory import Poses
from gpgrad_core.run import Progress, silent

System: TypeAlias = Any
"""KISS-ICP has no types."""
LONGEST = 100.0
"""The range that the package's own lengths are made for [m]. They are scaled by the sensor's."""
RANGE_QUANTILE = 0.99
"""Share of the points that is within the sensor's range; further ones are too few to use."""
LEAST_POINTS = 50
"""A scan that is thinned to fewer points is not registered."""
LEAST_OVERLAP = 0.5
"""Least share of a scan's points that the scans before it must have seen."""
REACH = 3.0
"""Points are matched within this many of the package's thresholds."""
CHECKED_EACH = 8
"""Every so many scans one is registered twice; so is each one that is far from its prediction."""
BESIDE = 0.03
"""The second start is beside the first by this share of the sensor's range."""
LEAST_PULL = 0.9
"""A scan that is held by the ground loses this share of the distance between the starts: 0.96 or
more on rough ground with a LiDAR; a stereo camera that got lost, half."""
UNTRUSTED = 0.2
"""Share of the scans that depend on their start from which the poses are not to be trusted."""


@dataclass(eq=False)
class _Measured:
    poses: list[Array] = field(default_factory=list[Array])  # T_first_scan (4, 4)
    breaks: list[int] = field(default_factory=list[int])  # scans that could not be registered
    reason: str = ""  # why the first of them could not
    thin: int = 0  # number of scans with too few points
    checked: int = 0  # number of scans that were registered twice
    loose: int = 0  # number of those that ended elsewhere


def estimate_poses(
    recording: Recording, params: BuildParams, progress: Progress = silent
) -> Recording:
    """Estimate poses of a recording's scans, in the frame of the body at the first scan.

    Where a scan cannot be registered, it begins anew at the predicted pose: see `Recording.breaks`.
    """
    package = load_library("kiss_icp.kiss_icp", "gpgrad[odometry]")
    if params.points_frame == "world" or recording.in_world:
        raise InputError("--odometry needs the points in the sensor's frame, not in the world's")
    max_range = _range(recording, params)

    def begin(pose: Array, motion: Array) -> System:
        system = package.KissICP(_configure(max_range, params))
        system.last_pose, system.last_delta = pose, motion
        return system

    system, measured = begin(np.eye(4), np.eye(4)), _Measured()
    for k, scan in enumerate(recording.read(0, len(recording))):
        points = np.ascontiguousarray(scan.finite)
        before = system.last_pose, system.last_delta
        reason = _register(system, points, k, max_range, measured)
        if reason:
            measured.reason = measured.reason or f"{recording.labels[k]}: {reason}"
            measured.breaks.append(k)
            system = begin(before[0] @ before[1], before[1])
            system.register_frame(points, np.zeros(0))  # it is the first one of the new map
        measured.poses.append(system.last_pose)
        progress((k + 1) / len(recording))
    poses = np.array(measured.poses)
    sensor = Poses(poses[:, :3, 3].copy(), Rotation.from_matrix(poses[:, :3, :3]))
    count = len(recording)
    mount = recording.mount if len(recording.mount) > 1 else recording.mount.repeated(count)
    return replace(
        recording,
        body=mount.repeated(count) @ sensor @ mount.inverse(),
        breaks=tuple(measured.breaks),
        notes=(*recording.notes, *_notes(measured, max_range, params)),
    )


def _range(recording: Recording, params: BuildParams) -> float:
    every = np.concatenate([np.linalg.norm(scan.finite, axis=1) for _, scan in recording.sample()])
    every = every[every <= (params.max_range or LONGEST)]
    if not len(every):
        raise InputError(f"{recording.name}: its scans have no points to make odometry of")
    return max(float(np.quantile(every, RANGE_QUANTILE)), 10.0 * params.voxel_size)


def _configure(max_range: float, params: BuildParams) -> Any:
    """Scale the package's lengths, and let it give the same poses in each run."""
    config = load_library("kiss_icp.config", "gpgrad[odometry]").load_config(None)
    scale = max_range / LONGEST
    config.data.max_range, config.data.min_range = max_range, params.min_range
    config.data.deskew = False  # the points of a scan are put together at one pose
    config.mapping.voxel_size = scale
    config.adaptive_threshold.initial_threshold *= scale
    config.adaptive_threshold.min_motion_th *= scale
    config.registration.max_num_threads = 1
    return config


def _register(
    system: System, points: Float[Array, "n 3"], number: int, max_range: float, measured: _Measured
) -> str:
    """Register a scan, and say why it could not be registered, if so."""
    preprocessed = system.preprocessor.preprocess(points, np.zeros(0), np.eye(4))
    start = system.last_pose @ system.last_delta
    if len(system.voxelize(preprocessed)[0]) < LEAST_POINTS:
        measured.thin += 1
        system.last_pose = start
        return ""
    if system.local_map.empty():
        system.register_frame(points, np.zeros(0))
        return ""
    threshold = float(system.adaptive_threshold.get_threshold())
    if REACH * threshold > max_range:
        return (
            f"its predictions are off by {threshold:.2g} m, so any points of its range of "
            f"{max_range:.2g} m may match"
        )
    earlier = system.local_map.point_cloud()
    _, source = system.register_frame(points, np.zeros(0))
    return _doubt(system, source, earlier, start, threshold, number, max_range, measured)


def _doubt(
    system: System,
    source: Float[Array, "n 3"],
    earlier: Float[Array, "m 3"],
    start: Float[Array, "4 4"],
    threshold: float,
    number: int,
    max_range: float,
    measured: _Measured,
) -> str:
    """Check a registration of the points `source` to the `earlier` ones; lengths are in metres."""
    pose, reach, beside = system.last_pose, REACH * threshold, BESIDE * max_range
    if not np.isfinite(pose).all():
        return "its pose is not finite"
    tree = KDTree(earlier, compact_nodes=False, balanced_tree=False)
    distance, _ = tree.query(_transform(pose, source), distance_upper_bound=reach)
    overlap = float(np.mean(np.isfinite(distance)))
    if overlap < LEAST_OVERLAP:
        return f"only {overlap:.0%} of its points are within {reach:.2g} m of earlier ones"
    deviation = _size(np.linalg.inv(start) @ pose, max_range)
    if deviation <= reach and number % CHECKED_EACH:
        return ""
    copy = load_library("kiss_icp.mapping").get_voxel_hash_map(system.config)
    copy.add_points(earlier)
    other = np.eye(4)
    other[number // CHECKED_EACH % 2, 3] = beside
    again = system.registration.align_points_to_map(source, copy, start @ other, reach, threshold)
    loose = float(np.linalg.norm(again[:3, 3] - pose[:3, 3])) > (1.0 - LEAST_PULL) * beside
    measured.checked += 1
    measured.loose += loose
    if loose and deviation > reach:
        allowed, far = told_apart(reach, deviation, ".2f", ".2f")
        return f"it is {far} m from its prediction, and its threshold allows {allowed} m"
    return ""


def _transform(pose: Float[Array, "4 4"], points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    return points @ pose[:3, :3].T + pose[:3, 3]


def _size(motion: Float[Array, "4 4"], max_range: float) -> float:
    """How far a motion moves points at the end of the range [m], as KISS-ICP measures it."""
    angle = float(Rotation.from_matrix(motion[:3, :3]).magnitude())
    return float(np.linalg.norm(motion[:3, 3])) + 2.0 * max_range * float(np.sin(angle / 2.0))


def _notes(measured: _Measured, max_range: float, params: BuildParams) -> tuple[str, ...]:
    count, broken = len(measured.poses), len(measured.breaks)
    up = (
        ""
        if params.gravity == "cloud"
        else "; up is z of the first scan's body (or --gravity cloud)"
    )
    notes = [f"the poses are odometry of kiss-icp, within a range of {max_range:.2g} m{up}"]
    if measured.thin:
        has, stands = ("has", "stands") if measured.thin == 1 else ("have", "stand")
        notes.append(
            f"{measured.thin:,} of {count:,} scans {has} fewer than {LEAST_POINTS} points to "
            f"register and {stands} where the last motion leads"
        )
    if broken:
        notes.append(
            f"kiss-icp failed at {broken:,} of {count:,} scans; submaps end there, and the motion "
            f"to the next is a guess; the first is {measured.reason}"
        )
    if measured.loose > UNTRUSTED * measured.checked:
        notes.append(
            "the odometry of kiss-icp is not to be trusted: of "
            f"{measured.checked:,} scans that were registered again from "
            f"{BESIDE * max_range:.2g} m beside, {measured.loose:,} ended elsewhere, "
            "because the ground does not hold them; give poses"
        )
    return tuple(notes)
