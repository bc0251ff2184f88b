"""The recordings on which both systems run."""

from dataclasses import dataclass
from pathlib import Path

from tests.long.benchmarks.whole.running import gpgrad


@dataclass(frozen=True)
class Drive:
    """A simulated drive, out and back.

    Attributes:
        name: As in the table.
        scans: Number of scans.
        max_range: How far the sensor sees [m].
        flags: The further flags of ``gpgrad simulate``.
    """

    name: str
    scans: int
    max_range: float
    flags: tuple[str, ...]

    def record(self, folder: Path, terrain: Path | None) -> Path:
        """Simulate the recording, unless it is there already.

        Args:
            folder: Where recordings are kept.
            terrain: A GeoTIFF to drive over; None makes the ground.
        """
        over = "" if terrain is None else f"_over_{terrain.stem}"
        recording = folder / f"{self.name.replace(', ', '_').replace(' ', '_')}{over}"
        if not recording.exists():
            ground = () if terrain is None else ("--terrain", str(terrain))
            limits = ("--scans", str(self.scans), "--max-range", f"{self.max_range:g}")
            gpgrad("simulate", str(recording), *limits, *self.flags, *ground)
        return recording


DRIVE = ("--num-submaps", "16")
LIDAR = ("--sensor", "lidar")
ROCKY = ("--seed", "21")
BARE = ("--seed", "22", "--rock-density", "0.1", "--roughness", "0.1", "--crater-density", "0.02")
"""Rolling ground with few rocks and craters."""

DRIVES = (
    Drive("LiDAR, rocks", 320, 10.0, (*DRIVE, *LIDAR, *ROCKY)),
    Drive("LiDAR, bare", 320, 10.0, (*DRIVE, *LIDAR, *BARE)),
    Drive("stereo, rocks", 320, 7.0, (*DRIVE, *ROCKY)),
    Drive("stereo, bare", 320, 7.0, (*DRIVE, *BARE)),
)
"""Each is 80 m long: once around, and the same way back."""

QUICK = (
    Drive(
        "quick",
        60,
        6.0,
        ("--sensor", "lidar", "--num-submaps", "6", "--spacing", "2", "--extent", "30"),
    ),
)
"""A short one, to see that all of it works; its figures mean nothing."""
