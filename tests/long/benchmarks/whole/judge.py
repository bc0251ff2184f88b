"""Judges trajectories by the true one: the sensor's positions at all scans."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.pose_files import read_pose_file
from gpgrad_core.se2 import Pose
from gpgrad_core.slam import trajectory_error

LOST = 0.5
"""Above this share of the positions' own spread, an error says that the system was lost."""


@dataclass(frozen=True)
class Score:
    """How far a trajectory is from the true one, all root mean squares.

    Attributes:
        fitted: Distance after the best rigid motion in space [m].
        from_start: Distance after the motion that makes the first poses equal [m].
        lost: Whether the system was lost.
        share: Share of the scans that have a pose.
    """

    fitted: float
    from_start: float
    lost: bool
    share: float


def score(true: Mapping[str, Pose], found: Mapping[str, Pose]) -> Score:
    """Compare a trajectory with the true one, by the routine that ``gpgrad slam`` uses.

    Args:
        true: The sensor's true pose at each scan.
        found: Its estimated poses in any frame.
    """
    names = [name for name in true if name in found]
    move = true[names[0]] @ found[names[0]].inverse()
    error = trajectory_error(true, {name: move @ found[name] for name in names})
    places = np.array([pose.translation for pose in true.values()])
    spread = np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1)))
    lost = bool(error.absolute > LOST * spread)
    return Score(error.absolute, error.absolute_unaligned, lost, len(names) / len(true))


def poses_at_scans(recording: Path, path: Path) -> dict[str, Pose]:
    """Read poses over time, and interpolate them to the times of a recording's scans."""
    stamps = (recording / "times.txt").read_text().split()
    located = read_pose_file(path).trajectory.at(np.array(stamps, np.float64), BuildParams())
    return {stamp: located.poses.one(k) for k, stamp in enumerate(stamps) if located.valid[k]}


def poses_of_submaps(dataset: Path, corrected: Path) -> dict[str, Pose]:
    """Give the sensor's pose at each scan of a dataset whose submaps have corrected poses.

    Args:
        dataset: What ``gpgrad build`` made; it keeps the sensor's poses in each submap's frame.
        corrected: What ``gpgrad slam`` wrote: a TUM row for each submap.
    """
    poses: dict[str, Pose] = {}
    submaps = read_pose_file(corrected).trajectory
    for place, number in enumerate(submaps.stamps.astype(int).tolist()):
        T_world_submap = submaps.poses.one(place)
        rows = (dataset / "trajectory" / f"{number:03d}.txt").read_text().splitlines()
        for row in rows:
            if not row.startswith("#"):
                stamp, *values = row.split()
                x = np.array(values, np.float64)
                poses[stamp] = T_world_submap @ Pose(x[:3], x[3:])
    return poses


def count_closures(folder: Path) -> int:
    """Count the loop closures that ``gpgrad slam`` used."""
    edges = json.loads((folder / "report.json").read_text())["edges"]
    return sum(edge["kind"] == "loop" and edge["weight"] >= 0.5 for edge in edges)


def write_upright(recording: Path, path: Path, out: Path) -> None:
    """Stand a trajectory upright that begins with the identity, for ``gpgrad build``.

    Its first pose becomes that of the recording's odometry, whose tilt an inertial unit measured.
    Nothing else is taken from there.
    """
    first = next(iter(poses_at_scans(recording, recording / "poses.txt").values()))
    rows: list[str] = []
    for stamp, pose in poses_at_scans(recording, path).items():
        moved = first @ pose
        values = (*moved.translation, *moved.quaternion)
        rows.append(" ".join([stamp, *(f"{value:.9f}" for value in values)]))
    out.write_text("\n".join(rows) + "\n")
