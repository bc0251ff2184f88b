"""Folders of image pairs in the form of EuRoC's datasets -> a recording.

In the folder, or in its ``mav0/``, each of ``cam0/`` and ``cam1/`` has ``data/`` with images,
``data.csv`` with rows ``time [ns], file name``, and ``sensor.yaml`` with ``resolution``,
``intrinsics``, the distortion and ``T_BS``, the camera's pose on the body. The images are as they
were taken. ``state_groundtruth_estimate0/data.csv`` may have the true poses of the body: rows of
the time [ns], x, y, z [m] and the quaternion w, x, y, z. ``mocap0/`` may stand in its place.
"""

import csv
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.reading.text import lines_of, parse_numbers, read_text
from gpgrad_core.recordings.cameras import read_camera
from gpgrad_core.recordings.image_pairs import choose_poses, is_pair, open_pairs
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.pose_files import read_timed_poses
from gpgrad_core.recordings.recording import Recording, RecordingSources, pair_stamps
from gpgrad_core.recordings.stereo import make_rig

CAMERAS = ("cam0", "cam1")
TRUTHS = ("state_groundtruth_estimate0", "mocap0")
STATES = (0, 1, 2, 3, 5, 6, 7, 4), True
"""Columns of the time, x, y, z, qx, qy, qz and qw of true poses, whose times are in nanoseconds."""
LARGEST_TABLE = 100_000_000


def _root(path: Path) -> Path:
    return path / "mav0" if (path / "mav0").is_dir() else path


def is_euroc(path: Path) -> bool:
    """Tell whether a folder has image pairs as EuRoC's do."""
    root = _root(path)
    return is_pair(*(root / camera / "data" for camera in CAMERAS))


def open_euroc(path: Path, sources: RecordingSources, params: BuildParams) -> Recording:
    """Open a folder of image pairs; true poses that it brings are used as far as needed."""
    root = _root(path)
    sources.refuse("the images have their times in data.csv", "times")
    files = [root / camera / name for camera in CAMERAS for name in ("data.csv", "sensor.yaml")]
    (left_times, left), (right_times, right) = (_images(root / camera) for camera in CAMERAS)
    numbers, notes = pair_stamps(left_times, right_times, str(path), CAMERAS)
    cameras = [read_camera(root / camera / "sensor.yaml") for camera in CAMERAS]
    on_body = [camera.on_body for camera in cameras]
    if on_body[0] is None or on_body[1] is None:
        raise InputError(f"{files[1] if on_body[0] is None else files[3]}: has no T_BS")
    rig = make_rig(cameras[0], cameras[1], on_body[0].inverse() @ on_body[1])
    tables = [file for name in TRUTHS if (file := root / name / "data.csv").is_file()]
    own = read_timed_poses(tables[0], STATES) if tables else None
    trajectory, truth, pose_notes = choose_poses(path, own, sources)
    return open_pairs(
        path,
        [(left[i], right[k]) for i, k in numbers],
        left_times[numbers[:, 0]],
        rig,
        on_body[0],
        trajectory,
        truth,
        sources,
        params,
        files=[*files, *tables[:1]],
        notes=(*notes, *pose_notes),
    )


def _images(folder: Path) -> tuple[Float[NDArray[np.float64], "n"], list[Path]]:
    """Read the times [s] and the files of a camera's images."""
    table = folder / "data.csv"
    stamps: list[float] = []
    files: list[Path] = []
    for where, cells in rows_of(table):
        if len(cells) != 2 or Path(cells[1]).name != cells[1]:
            raise InputError(f"{where}: must be a time [ns] and the name of a file in data/")
        if not (folder / "data" / cells[1]).is_file():
            raise InputError(f"{where}: {folder / 'data' / cells[1]}: no such file")
        stamps.append(1e-9 * parse_numbers(cells[:1], where)[0])
        files.append(folder / "data" / cells[1])
    if not files:
        raise InputError(f"{table}: holds no images")
    return np.array(stamps), files


def rows_of(path: Path) -> list[tuple[str, list[str]]]:
    """Split a table with commas into cells; ``#`` or ``%`` begins a comment."""
    if not path.exists():
        raise InputError(f"{path}: no such file")
    rows: list[tuple[str, list[str]]] = []
    reader = csv.reader(lines_of(read_text(path, LARGEST_TABLE)))
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if any(cells) and not cells[0].startswith(("#", "%")):
                rows.append((f"{path}, line {reader.line_num}", cells))
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num}: {error}") from None
    return rows
