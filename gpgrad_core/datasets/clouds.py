"""One cloud file -> one submap."""

import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.datasets.pcd import read_pcd, read_pcd_colors
from gpgrad_core.datasets.ply import read_ply, read_ply_colors, read_ply_property
from gpgrad_core.datasets.tables import as_floats, read_table
from gpgrad_core.errors import InputError
from gpgrad_core.libraries import load_library
from gpgrad_core.types import Submap

Points: TypeAlias = Float[NDArray[np.floating], "n 3"]
COARSE_STEP = 1e-3
"""If neighbouring 32-bit coordinates differ by more than this [m], the user is warned."""


def load_cloud(path: Path | str) -> Submap:
    """Load one gravity-aligned cloud: .ply .pcd .npz .npy .xyz .csv .las .laz .bin.

    float64 files keep their precision. Rows that are not finite are dropped and counted in
    ``Submap.num_dropped``.

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
    try:
        submap = Submap.from_points(
            points,
            path.stem,
            colors=_read_colors(path),
            noise_std=_read_property(path, "noise_std"),
            ranges=_read_property(path, "range"),
        )
    except InputError as error:
        # The submap's error names the submap; the user needs the name of the file.
        raise InputError(f"{path}: {str(error).removeprefix(f'{path.stem}: ')}") from None
    notes: list[str] = []
    if submap.num_dropped:
        verb = "is not finite and was" if submap.num_dropped == 1 else "are not finite and were"
        notes.append(f"{path.name}: {submap.num_dropped:,} of {len(points):,} rows {verb} dropped")
    furthest = float(np.abs(submap.points).max())
    if points.dtype.itemsize < 8 and np.spacing(np.float32(furthest)) > COARSE_STEP:
        notes.append(
            f"{path.name}: its 32-bit coordinates of up to {furthest:,.0f} m have steps of "
            f"{np.spacing(np.float32(furthest)):.2g} m; save it with 64 bits or in a local frame"
        )
    return submap, tuple(notes)


def read_points(path: Path) -> Points:
    """Read a cloud's rows [m] without changes, also NaN, in the precision of the file.

    Raises:
        InputError: As in `load_cloud`, except that the cloud may hold any points, or none.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"{path}: unknown ending {path.suffix!r}; the known ones are {' '.join(READERS)}"
        )
    try:
        return reader(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def _read_colors(path: Path) -> Float[NDArray[np.floating], "n 3"] | None:
    reader = COLOR_READERS.get(path.suffix.lower())
    return None if reader is None else reader(path)


def _read_property(path: Path, name: str) -> Float[NDArray[np.floating], "n"] | None:
    reader = PROPERTY_READERS.get(path.suffix.lower())
    return None if reader is None else reader(path, name)


def _read_npz_property(path: Path, name: str) -> Float[NDArray[np.floating], "n"] | None:
    with np.load(path, allow_pickle=False) as archive:
        return np.asarray(archive[name], np.float64).ravel() if name in archive else None


def _read_npy(path: Path) -> Points:
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, MemoryError) as error:  # MemoryError: a damaged shape
        raise InputError(f"{path}: is not a complete NPY file: {_first_line(error)}") from None
    if not isinstance(array, np.ndarray):  # np.load looks at the content: this is a renamed NPZ
        array.close()
        raise InputError(f"{path}: is an NPZ archive; rename it to .npz")
    return _check_points(array, str(path))


def _read_npz(path: Path) -> Points:
    try:
        # The file is opened here, because NumPy does not close one that is not an archive.
        with path.open("rb") as file:
            archive = np.load(file, allow_pickle=False)
            if isinstance(archive, np.ndarray):
                raise InputError(f"{path}: is a single NPY array; rename it to .npy")
            arrays = {name: archive[name] for name in archive.files}
    except InputError:
        raise
    except (ValueError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"{path}: is not a complete NPZ file: {_first_line(error)}") from None
    if "points" in arrays:
        return _check_points(arrays["points"], f"{path}, array 'points'")
    clouds = [name for name, array in arrays.items() if _has_points_shape(array)]
    if len(clouds) != 1:
        held = ", ".join(f"{name} {array.shape}" for name, array in arrays.items()) or "nothing"
        raise InputError(
            f"{path}: needs an array 'points', or just one of shape (n, 3); it holds {held}"
        )
    return as_floats(arrays[clouds[0]])


def _has_points_shape(array: NDArray[Any]) -> bool:
    return array.ndim == 2 and array.shape[1] == 3 and array.dtype.kind in "fiu"


def _check_points(array: NDArray[Any], where: str) -> Points:
    if not _has_points_shape(array):
        raise InputError(
            f"{where}: points must be numbers of shape (n, 3), got {array.dtype} {array.shape}"
        )
    return as_floats(array)


def _read_bin(path: Path) -> Points:
    """Read KITTI's rows of x, y, z and reflectance, all float32, without a header."""
    size = path.stat().st_size
    if size % 16:
        raise InputError(
            f"{path}: is not a complete KITTI scan: {size:,} bytes are not a multiple of 16, the "
            "four float32 of a point"
        )
    return np.fromfile(path, "<f4").reshape(-1, 4)[:, :3]


def _read_las(path: Path) -> Points:
    try:
        laspy: Any = load_library("laspy", "gpgrad[las]")
    except InputError as error:
        raise InputError(f"{path}: to read {path.suffix}, {error}") from None
    try:
        return np.asarray(laspy.read(path).xyz, dtype=np.float64)
    except OSError:
        raise
    except Exception as error:  # laspy, lazrs and NumPy each raise their own on broken files
        raise InputError(f"{path}: is not a complete LAS file: {_first_line(error)}") from None


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]


READERS: dict[str, Callable[[Path], Points]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".npz": _read_npz,
    ".npy": _read_npy,
    ".xyz": read_table,
    ".csv": read_table,
    ".las": _read_las,
    ".laz": _read_las,
    ".bin": _read_bin,
}
"""The reader of a file, by its ending."""

PROPERTY_READERS: dict[str, Callable[[Path, str], Float[NDArray[np.floating], "n"] | None]] = {
    ".ply": read_ply_property,
    ".npz": _read_npz_property,
}
"""The reader of a named number of each point, by the file's ending. The names are ``noise_std``,
the standard deviation of the height [m], and ``range``, the distance from the sensor [m]."""

COLOR_READERS: dict[str, Callable[[Path], Float[NDArray[np.floating], "n 3"] | None]] = {
    ".ply": read_ply_colors,
    ".pcd": read_pcd_colors,
}
"""The reader of the points' colours, by the file's ending."""
