"""One cloud file -> one submap."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.datasets.las import read_las, read_las_property, unpacked_las
from gpgrad_core.datasets.npy import read_npy, read_npz, read_npz_property, unpacked_npz
from gpgrad_core.datasets.pcd import read_pcd, read_pcd_colors, read_pcd_property, unpacked_pcd
from gpgrad_core.datasets.ply import read_ply, read_ply_colors, read_ply_property
from gpgrad_core.datasets.tables import read_table
from gpgrad_core.errors import InputError
from gpgrad_core.reading.paths import check_path
from gpgrad_core.types import Submap

Points: TypeAlias = Float[NDArray[np.floating], "n 3"]
COARSE_STEP = 1e-3
"""If neighbouring 32-bit coordinates differ by more than this [m], the user is warned."""


def load_cloud(path: Path | str) -> Submap:
    """Load one gravity-aligned cloud: .ply .pcd .npz .npy .xyz .csv .las .laz .bin.

    float64 files keep their precision. Rows that are not finite are dropped and counted in
    ``Submap.num_dropped``; wild points are left out and counted in ``Submap.num_wild``.

    Args:
        path: The file; its name without the ending becomes the submap's id.

    Returns:
        The submap, with points in metres.

    Raises:
        InputError: If the file is missing or broken, has an unknown ending, or holds no terrain.
    """
    return load_cloud_with_notes(Path(path))[0]


def load_cloud_with_notes(path: Path) -> tuple[Submap, tuple[str, ...]]:
    """Load one cloud, with notes on what was left out or is doubtful, one line each.

    Raises:
        InputError: See `load_cloud`.
    """
    points = read_points(path)
    if len(points) == 0:
        raise InputError(f"{path}: is an empty cloud: it holds no points; give another file")
    notes: list[str] = []
    colors = _read_colors(path)
    if colors is not None and not _are_colors(colors, points):
        colors = None
        notes.append(f"{path.name}: its colours are not all from 0 to 1 and were left out")
    try:
        submap = Submap.from_points(
            points,
            path.stem,
            colors=colors,
            noise_std=_read_counted(path, "noise_std", len(points)),
            ranges=_read_counted(path, "range", len(points)),
        )
    except InputError as error:
        # The submap's error names the submap; the user needs the name of the file.
        raise InputError(f"{path}: {str(error).removeprefix(f'{path.stem}: ')}") from None
    if submap.num_dropped:
        verb = "is not finite and was" if submap.num_dropped == 1 else "are not finite and were"
        notes.append(f"{path.name}: {submap.num_dropped:,} of {len(points):,} rows {verb} dropped")
    notes += wild_note(submap, path.name)
    furthest = float(np.abs(submap.points).max())
    if points.dtype.itemsize < 8 and np.spacing(np.float32(furthest)) > COARSE_STEP:
        notes.append(
            f"{path.name}: its 32-bit coordinates of up to {furthest:,.0f} m have steps of "
            f"{np.spacing(np.float32(furthest)):.2g} m; save it with 64 bits or in a local frame"
        )
    return submap, tuple(notes)


def wild_note(submap: Submap, name: str) -> list[str]:
    """Say how many wild points were left out of a cloud; nothing if there were none."""
    count, total = submap.num_wild, submap.num_points + submap.num_wild
    if not count:
        return []
    verb, them = ("was", "it") if count == 1 else ("were", "them")
    return [f"{name}: {count:,} of {total:,} points {verb} left out: no ground explains {them}"]


def read_points(path: Path) -> Points:
    """Read a cloud's rows [m] without changes, also NaN, in the precision of the file.

    Raises:
        InputError: As in `load_cloud`, except that the cloud may hold any points, or none.
    """
    if not check_path(path).exists():
        raise InputError(f"{path}: no such file")
    if not path.is_file() and not path.is_dir():  # a pipe would be waited for, without end
        raise InputError(f"{path}: cannot be read: it is a device or a pipe, not a file")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"{path}: unknown ending {path.suffix!r}; the known ones are {' '.join(READERS)}"
        )
    try:
        return reader(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def unpacked_bytes(path: Path) -> int:
    """Give the bytes that a cloud takes in memory; a compressed one takes more than its file.

    Raises:
        InputError: If it is broken.
    """
    measure = UNPACKED.get(path.suffix.lower())
    try:
        return path.stat().st_size if measure is None else measure(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def _read_colors(path: Path) -> Float[NDArray[np.floating], "n 3"] | None:
    reader = COLOR_READERS.get(path.suffix.lower())
    return None if reader is None else reader(path)


def _are_colors(colors: Points, points: Points) -> bool:
    """Say whether all points that are kept have red, green and blue from 0 to 1."""
    kept = colors[np.isfinite(points).all(axis=1)]
    return bool(np.all((kept >= 0) & (kept <= 1)))


def read_property(path: Path, name: str) -> Float[NDArray[np.float64], "n"] | None:
    """Read a named number of each point, such as its ``intensity``; None if the file has none.

    Those of ``.ply``, ``.npz`` and ``.pcd`` have the file's names; the fourth number of KITTI's
    ``.bin`` is its ``intensity`` or ``reflectance``; ``.las`` and ``.laz`` have those of
    `las.FIELDS`.

    Raises:
        InputError: If the file is broken.
    """
    if path.suffix.lower() == ".bin":
        return _read_rows(path)[:, 3].astype(np.float64) if name in FOURTH else None
    reader = FIELD_READERS.get(path.suffix.lower())
    values = None if reader is None else reader(path, name)
    return None if values is None else np.asarray(values, np.float64)


def _read_counted(path: Path, name: str, count: int) -> Float[NDArray[np.floating], "n"] | None:
    reader = PROPERTY_READERS.get(path.suffix.lower())
    values = None if reader is None else reader(path, name)
    if values is not None and len(values) != count:
        raise InputError(f"{path}: {name} has {len(values):,} rows, the points have {count:,}")
    return values


def _read_bin(path: Path) -> Points:
    """Read KITTI's rows of x, y and z; see `_read_rows`."""
    return _read_rows(path)[:, :3]


def _read_rows(path: Path) -> Float[NDArray[np.floating], "n 4"]:
    """Read KITTI's rows of x, y, z and reflectance, all float32, without a header."""
    size = path.stat().st_size
    if size % 16:
        raise InputError(
            f"{path}: is not a complete KITTI scan: {size:,} bytes are not a multiple of 16, the "
            "four float32 of a point"
        )
    return np.fromfile(path, "<f4").reshape(-1, 4)


FOURTH = ("intensity", "reflectance")
"""Names of the fourth number of KITTI's points."""


READERS: dict[str, Callable[[Path], Points]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".npz": read_npz,
    ".npy": read_npy,
    ".xyz": read_table,
    ".csv": read_table,
    ".las": read_las,
    ".laz": read_las,
    ".bin": _read_bin,
}
"""The reader of a file, by its ending."""

UNPACKED: dict[str, Callable[[Path], int]] = {
    ".npz": unpacked_npz,
    ".pcd": unpacked_pcd,
    ".las": unpacked_las,
    ".laz": unpacked_las,
}
"""What gives the size of a file's points in memory, for those that may be compressed."""

PROPERTY_READERS: dict[str, Callable[[Path, str], Float[NDArray[np.floating], "n"] | None]] = {
    ".ply": read_ply_property,
    ".npz": read_npz_property,
}
"""The reader of a named number of each point, by the file's ending. The names are ``noise_std``,
the standard deviation of the height [m], and ``range``, the distance from the sensor [m]."""

FIELD_READERS = PROPERTY_READERS | {
    ".pcd": read_pcd_property,
    ".las": read_las_property,
    ".laz": read_las_property,
}
"""The reader of any number of each point; what these files call ``range`` is not taken for ours."""

COLOR_READERS: dict[str, Callable[[Path], Float[NDArray[np.floating], "n 3"] | None]] = {
    ".ply": read_ply_colors,
    ".pcd": read_pcd_colors,
}
"""The reader of the points' colours, by the file's ending."""
