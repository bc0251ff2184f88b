"""Scans with a pose each, a folder for every scan: ``NAME/NAME.xyz`` with ``NAME/NAME.gt``.

This is the form of the sets p2at_met and box_met of the *Canadian Planetary Emulation Terrain 3D
Mapping Dataset* (Tong, Gingras, Larose, Barfoot and Dupuis, IJRR 2013). ``.xyz`` has a row
``x y z`` [m] for each point, in the scanner's frame; ``.gt`` has the four rows of a matrix
``T_world_scanner``, the true pose. Two programs that read it were the specification here: the
tutorial of the Canadian Space Agency (asc-csa/Canadian-Planetary-Emulation-Terrain-3D-Mapping-
Tutorial), which prints a ``.gt``, and ``planetary_setup.py`` of iralabdisco/
point_clouds_registration_benchmark, which names both files.

Unverified, as no file could be downloaded: what columns after the third hold (they are ignored),
and that the world's z axis points up. The printed pose, tilted by seven degrees, agrees with that.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpgrad_core.errors import InputError
from gpgrad_core.io.poses import pose_of_matrix
from gpgrad_core.reading.text import parse_numbers, split_rows
from gpgrad_core.se2 import Pose

CLOUD, TRUTH = ".xyz", ".gt"
LARGEST = 10_000
"""Bytes of a ``.gt``; sixteen numbers take 200."""


@dataclass(frozen=True)
class PosedScan:
    """A scan and the file of its pose."""

    name: str  # the scan's name, which is that of its folder
    cloud: Path  # file of its points
    truth: Path  # file of its pose

    def read_pose(self) -> Pose:
        """Read the pose, ``T_world_scanner``.

        Raises:
            InputError: See `read_matrix_pose`.
        """
        return read_matrix_pose(self.truth)


def is_posed_scan(folder: Path) -> bool:
    """Tell whether a folder holds one scan and its pose."""
    return all((folder / f"{folder.name}{ending}").is_file() for ending in (CLOUD, TRUTH))


def find_posed_scans(folder: Path) -> list[PosedScan]:
    """Find the scans with a pose each in a folder, sorted by name; there may be none.

    Raises:
        InputError: If some of the scans have a pose and others have none.
    """
    if not folder.is_dir():
        return []
    inner = sorted(scan for scan in folder.iterdir() if scan.is_dir())
    posed = [scan for scan in inner if is_posed_scan(scan)]
    bare = [s for s in inner if (s / f"{s.name}{CLOUD}").is_file() and s not in posed]
    if posed and bare:
        raise InputError(
            f"{bare[0]}: has {bare[0].name}{CLOUD} but no pose {bare[0].name}{TRUTH}; copy the "
            "pose too, or remove the scan"
        )
    return [
        PosedScan(scan.name, scan / f"{scan.name}{CLOUD}", scan / f"{scan.name}{TRUTH}")
        for scan in posed
    ]


def read_matrix_pose(path: Path) -> Pose:
    """Read a pose written as the four rows of a 4x4 matrix.

    Raises:
        InputError: If the file has another shape, its last row is not 0 0 0 1, its first three
            columns are not a rotation, or the position is beyond `MAX_COORDINATE`; the message
            names the line where one is to blame.
    """
    rows: list[list[float]] = []
    for where, words in split_rows(path, LARGEST, comment=None):
        if len(words) != 4 or len(rows) == 4:
            raise InputError(f"{where}: a pose is four rows of four numbers, a 4x4 matrix")
        rows.append(parse_numbers(words, where))
    if len(rows) != 4:
        raise InputError(f"{path}: has {len(rows)} rows; a pose is the four rows of a 4x4 matrix")
    matrix = np.array(rows)
    if not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0], rtol=0, atol=1e-6):
        raise InputError(f"{path}: the last row of a pose's 4x4 matrix must be 0 0 0 1")
    return pose_of_matrix(matrix[:3], str(path))
