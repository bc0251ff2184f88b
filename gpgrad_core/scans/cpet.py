"""Scans with a pose each, ``NAME/NAME.xyz`` with ``NAME/NAME.gt`` -> a recording.

`gpgrad_core.datasets.cpet` has the form of the files and its sources.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.datasets.clouds import read_cloud
from gpgrad_core.datasets.cpet import PosedScan
from gpgrad_core.scans.recording import Reader, Recording, RecordingSources, identify
from gpgrad_core.scans.trajectory import Located, Poses


def open_posed_scans(
    path: Path, scans: Sequence[PosedScan], sources: RecordingSources
) -> Recording:
    """Open scans with a pose each.

    Args:
        path: The folder of their folders.
        scans: The scans, as `find_posed_scans` finds them.
        sources: Must name no file.

    Raises:
        InputError: If a pose cannot be read, or the sources name other files.
    """
    each = f"the scans of {path} have a pose each, in NAME.gt"
    sources.refuse(each, "poses", "truth", "times", "mount")
    sources.refuse(f"the scans of {path} have x, y and z only", "keep")
    body = Poses.of(*(scan.read_pose() for scan in scans))
    return Recording(
        name=path.resolve().name,
        identity=identify([file for scan in scans for file in (scan.cloud, scan.truth)]),
        stamps=None,
        body=body,
        mount=Poses.identity(),
        read=_reader(scans),
        labels=tuple(scan.cloud.name for scan in scans),
        truth=Located(body, np.ones(len(scans), bool)),
        notes=("the poses of the scans are the true ones; there is no odometry",),
    )


def _reader(scans: Sequence[PosedScan]) -> Reader:
    def read(start: int, stop: int) -> Iterator[Float[NDArray[np.floating], "n 3"]]:
        for scan in scans[start:stop]:
            yield read_cloud(scan.cloud).points

    return read
