"""KITTI's scans: rows of x, y, z and reflectance, all float32, without a header."""

from collections.abc import Collection
from pathlib import Path

import numpy as np

from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds.format import CloudFormat, PointCloud

REFLECTANCE = ("intensity", "reflectance")
"""Names of the fourth number of a point."""


def read_kitti(path: Path, names: Collection[str] = ()) -> PointCloud:
    """Read a scan.

    Args:
        path: The file.
        names: Which further numbers of each point to read; see `REFLECTANCE`.

    Raises:
        InputError: If its size is not that of whole rows.
    """
    size = path.stat().st_size
    if size % 16:
        raise InputError(
            f"{path}: is not a complete KITTI scan: {size:,} bytes are not a multiple of 16, the "
            "four float32 of a point"
        )
    rows = np.fromfile(path, "<f4").reshape(-1, 4)
    numbers = {name: rows[:, 3] for name in REFLECTANCE if name in names}
    return PointCloud(rows[:, :3], numbers=numbers)


KITTI = CloudFormat(".bin", "KITTI's rows of four 32-bit numbers", read_kitti)
