"""What the folders of image pairs have in common: files with times, and a recording of them."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.reading.images import read_images
from gpgrad_core.reading.paths import in_order
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.pose_files import (
    PoseFile,
    read_mount,
    read_timed_poses,
    read_truth_file,
)
from gpgrad_core.recordings.recording import Recording, RecordingSources, Scan, assemble
from gpgrad_core.recordings.stereo import NO_MATCH, Rig
from gpgrad_core.recordings.trajectory import Poses, Trajectory

ENDINGS = (".png", ".jpg", ".jpeg", ".pgm", ".bmp", ".tif", ".tiff")
BATCH = 8
"""Number of pairs that are decoded together."""


def images_in(folder: Path) -> list[Path]:
    """List the images of a folder in the order of their names; there may be none, or no folder."""
    if not folder.is_dir():
        return []
    files = in_order(list(folder.iterdir()))
    return [k for k in files if k.suffix.lower() in ENDINGS and not k.name.startswith(".")]


def is_pair(one: Path, other: Path) -> bool:
    """Tell whether two folders have images."""
    return bool(images_in(one)) and bool(images_in(other))


def choose_poses(
    path: Path, own: Trajectory | None, sources: RecordingSources
) -> tuple[Trajectory, PoseFile | None, tuple[str, ...]]:
    """Choose the poses, and the truth if there is one; also give a note.

    `own` are the true poses that the recording brings. They are the poses if no others are named,
    and the truth otherwise.
    """
    truth = None if sources.truth is None else read_truth_file(sources.truth)
    if sources.poses is not None:
        if truth is None and own is not None:
            truth = PoseFile(own, numbered=False)
        return read_timed_poses(sources.poses), truth, ()
    if own is None:
        raise InputError(f"{path}: has no poses; say where they are: --poses FILE")
    note = "the poses are the true ones of the recording; there is no odometry"
    return own, truth, (note,)


def open_pairs(
    path: Path,
    pairs: Sequence[tuple[Path, Path]],
    stamps: Float[NDArray[np.float64], "n"],
    rig: Rig,
    mount: Poses,
    trajectory: Trajectory,
    truth: PoseFile | None,
    sources: RecordingSources,
    params: BuildParams,
    *,
    up: str = "z",
    files: Sequence[Path] = (),
    notes: tuple[str, ...] = (),
) -> Recording:
    """Make a recording of image pairs by their times [s].

    `mount` is ``T_body_camera`` of the left camera, and `files` are those that were read for it.
    """
    sources.refuse("image pairs have x, y and z only", "keep")
    sources.refuse("the folder has its own calibration", "calibration")

    def read(numbers: Sequence[int]) -> Iterator[Scan]:
        chosen = [pairs[k] for k in numbers]
        images = read_images([file for pair in chosen for file in pair], 2 * BATCH)
        for (left, _), one, other in zip(chosen, images, images, strict=True):
            yield rig.scan(one, other, str(left), params.min_range)

    return assemble(
        path,
        sources,
        params,
        stamps=stamps,
        poses=trajectory,
        labels=[left.name for left, _ in pairs],
        read=read,
        files=pairs,
        texts=[*files, sources.poses, sources.truth, sources.mount],
        mount=mount if sources.mount is None else read_mount(sources.mount).pose,
        truth=truth,
        truth_name=str(sources.truth or path),
        notes=notes,
        up=up,
        advice=NO_MATCH,
    )
