"""Scans with a pose each, ``NAME/NAME.xyz`` with ``NAME/NAME.gt`` -> a recording.

`gpgrad_core.datasets.cpet` has the form of the files and its sources.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import NDArray
from gpgrad_core.datasets.clouds import read_cloud
from gpgrad_core.datasets.cpet import PosedScan
from gpgrad_core.errors import InputError
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
    given = {
        "--poses": sources.poses,
        "--truth": sources.truth,
        "--times": sources.times,
        "--mount": sources.mount,
    }
    for flag, file in given.items():
        if file is not None:
            raise InputError(f"{flag} {file}: the scans of {path} have a pose each, in NAME.gt")
    if sources.keep:
        raise InputError(f"--keep {sources.keep[0]}: the scans of {path} have x, y and z only")
    poses = [one.read_pose() for one in scans]
    body = Poses(
        np.array([pose.translation for pose in poses]),
        Rotation.from_quat([pose.quaternion for pose in poses]),
    )
    return Recording(
        name=path.resolve().name,
        identity=identify([file for one in scans for file in (one.cloud, one.truth)]),
        stamps=None,
        body=body,
        mount=Poses.identity(),
        read=_reader(scans),
        labels=tuple(one.cloud.name for one in scans),
        truth=Located(body, np.ones(len(scans), bool)),
        notes=("the poses of the scans are the true ones; there is no odometry",),
    )


def _reader(scans: Sequence[PosedScan]) -> Reader:
    def read(start: int, stop: int) -> Iterator[Float[NDArray[np.floating], "n 3"]]:
        for one in scans[start:stop]:
            yield read_cloud(one.cloud).points

    return read
