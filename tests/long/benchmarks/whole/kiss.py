"""KISS-SLAM on a recording: ``python -m tests.long.benchmarks.whole.kiss``.

It gets the scans in the sensor's frame, in their order, and nothing else.
"""

import contextlib
import io
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from scipy.spatial.transform import Rotation

from gpgrad_core.io.clouds import read_cloud
from gpgrad_core.io.poses import pose_row
from gpgrad_core.se2 import Pose

RANGE = 100.0
"""The range that the package's own lengths are made for [m]."""
SETUPS = ("defaults", "coarse", "scaled")
"""``defaults`` leaves all lengths as they come. ``scaled`` scales them all by the sensor's range,
as the package does with the voxel of its odometry if it is told the range: a hundredth of it.
``coarse`` makes them twice as large. In all, a local map ends after the range, because after the
package's own 100 m the drive would be over."""


@dataclass(frozen=True)
class Options:
    """KISS-SLAM on the scans of a recording."""

    recording: Path
    """Folder of ``gpgrad simulate --scans``."""
    out: Path
    """Folder to write ``odometry.txt`` and ``trajectory.txt`` to, TUM rows of the sensor's poses,
    and ``found.json``."""
    setup: Literal["defaults", "coarse", "scaled"] = "scaled"
    """Its lengths: see `SETUPS`."""
    max_range: float = 10.0
    """How far the sensor sees [m]."""


def configure(setup: str, max_range: float) -> Any:
    """Make the configuration of a setup for a sensor of some range [m]."""
    from kiss_slam.config import load_config  # noqa: PLC0415 - of an extra

    config = load_config(None)
    data, mapping = config.odometry.preprocessing, config.odometry.mapping
    data.deskew = False  # each simulated scan is taken at one moment
    config.local_mapper.splitting_distance = max_range
    if setup == "defaults":
        return config
    data.max_range = max_range
    scale = max_range / RANGE * (2.0 if setup == "coarse" else 1.0)
    mapping.voxel_size = scale * mapping.voxel_size
    config.odometry.adaptive_threshold.initial_threshold *= scale
    config.odometry.adaptive_threshold.min_motion_th *= scale
    config.local_mapper.voxel_size *= scale
    config.loop_closer.detector.density_map_resolution *= scale
    return config


def find_map(config: Any, scans: list[Path]) -> tuple[list[Any], list[Any], int]:
    """Run KISS-SLAM as its own pipeline does.

    Returns:
        The sensor's pose at each scan (4, 4) by KISS-ICP alone, the poses corrected by the loop
        closures, and the number of these.
    """
    from kiss_slam.slam import KissSLAM  # noqa: PLC0415

    system = KissSLAM(config)
    odometry, start, node = [], np.eye(4), 0
    for path in scans:
        system.process_scan(_points(path), np.zeros(0))
        # A local map that ends resets the odometry to its end.
        last = system.local_map_graph.last_id
        if last != node:
            ended = system.local_map_graph[node].local_trajectory[-1]
            odometry.append(start @ ended)
            start, node = start @ ended, last
        else:
            odometry.append(start @ system.odometry.last_pose)
    system.generate_new_node()
    system.local_map_graph.erase_last_local_map()
    poses, _ = system.fine_grained_optimization()
    return odometry, list(poses), len(system.closures)


def _points(path: Path) -> Any:
    return np.array(read_cloud(path).points, np.float64)


def _write(path: Path, scans: list[Path], poses: list[Any]) -> None:
    if len(poses) != len(scans) or not np.isfinite(poses).all():
        sys.exit(f"{len(poses)} poses for {len(scans)} scans, or poses that are not finite")
    rows = [
        pose_row(scan.stem, Pose(pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_quat()))
        for scan, pose in zip(scans, poses, strict=True)
    ]
    path.write_text("\n".join(rows) + "\n")


def main(options: Options) -> None:
    """Run and write."""
    scans = sorted((options.recording / "scans").iterdir())
    config = configure(options.setup, options.max_range)
    with contextlib.redirect_stdout(io.StringIO()):  # it tells every closure
        odometry, poses, closures = find_map(config, scans)
    options.out.mkdir(parents=True, exist_ok=True)
    _write(options.out / "odometry.txt", scans, odometry)
    _write(options.out / "trajectory.txt", scans, poses)
    (options.out / "found.json").write_text(json.dumps({"closures": closures}))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
