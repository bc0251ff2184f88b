"""One cloud file -> one submap: every format that is read is a module of this folder."""

import importlib
import pkgutil
from collections.abc import Collection
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError, NoTerrainError, readable
from gpgrad_core.ground import submap_of_cloud
from gpgrad_core.io.clouds.format import CloudFormat, PointCloud
from gpgrad_core.reading.paths import check_path
from gpgrad_core.types import GroundChoice, Submap

COARSE_STEP = 1e-3
"""If neighbouring 32-bit coordinates differ by more than this [m], the user is warned."""


def _find_formats() -> dict[str, CloudFormat]:
    formats: dict[str, CloudFormat] = {}
    for module in pkgutil.iter_modules(__path__, prefix=f"{__name__}."):
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(value, CloudFormat):
                formats[value.ending] = value
    return dict(sorted(formats.items()))


CLOUD_FORMATS = _find_formats()
"""The format of a file, by its ending: every `CloudFormat` of a module in this folder."""
CLOUD_ENDINGS = " ".join(CLOUD_FORMATS)
"""As messages list them."""


def is_cloud(path: Path) -> bool:
    """Whether a file is a cloud, by its ending."""
    return path.suffix.lower() in CLOUD_FORMATS


def load_cloud(path: Path | str, ground: GroundChoice = "automatic") -> Submap:
    """Load one gravity-aligned cloud, of any format in `CLOUD_FORMATS`.

    float64 files keep their precision. Rows that are not finite are dropped and counted in
    ``Submap.num_dropped``; outliers are left out and counted in ``Submap.num_outliers``, and those
    that stand on the ground in ``Submap.num_non_ground``.

    Args:
        path: The file; its name without the ending becomes the submap's id.
        ground: Whether to leave out what stands on the ground; see `Submap.from_points`.

    Raises:
        InputError: If the file is missing or broken, has an unknown ending, or holds no terrain.
    """
    return load_cloud_with_notes(Path(path), ground)[0]


def load_cloud_with_notes(
    path: Path, ground: GroundChoice | None = "automatic"
) -> tuple[Submap, tuple[str, ...]]:
    """Load one cloud, with notes on what was left out or is doubtful, one line each."""
    cloud_format = format_of(path)
    try:
        cloud = read_cloud(path, cloud_format.submap_numbers)
    except InputError as error:
        if path.is_file() and not path.stat().st_size:
            raise NoTerrainError(f"{error}; the file is empty") from None
        raise
    points, colors = cloud.points, cloud.colors
    if len(points) == 0:
        raise NoTerrainError(f"{path}: is an empty cloud: it holds no points; give another file")
    notes: list[str] = []
    shown = None if colors is None else colors[np.isfinite(points).all(axis=1)]
    if shown is not None and not np.all((shown >= 0) & (shown <= 1)):
        colors = None
        notes.append(f"{path.name}: its colours are not all from 0 to 1 and were left out")
    numbers = {name: np.asarray(values, np.float64) for name, values in cloud.numbers.items()}
    try:
        submap = submap_of_cloud(
            points,
            path.stem,
            colors=colors,
            noise_std=numbers.get("noise_std"),
            ranges=numbers.get("range"),
            ground=ground,
        )
    except InputError as error:
        # The submap's error names the submap; the user needs the name of the file.
        raise type(error)(f"{path}: {str(error).removeprefix(f'{path.stem}: ')}") from None
    if submap.num_dropped:
        verb = "is not finite and was" if submap.num_dropped == 1 else "are not finite and were"
        notes.append(f"{path.name}: {submap.num_dropped:,} of {len(points):,} rows {verb} dropped")
    notes += left_out_notes(submap, path.name)
    furthest = float(np.abs(submap.points).max())
    if points.dtype.itemsize < 8 and np.spacing(np.float32(furthest)) > COARSE_STEP:
        notes.append(
            f"{path.name}: its 32-bit coordinates of up to {furthest:,.0f} m have steps of "
            f"{np.spacing(np.float32(furthest)):.2g} m; save it with 64 bits or in a local frame"
        )
    return submap, tuple(notes)


def left_out_notes(submap: Submap, name: str) -> list[str]:
    """Count the outliers that were left out of a cloud, and what stands on the ground."""
    reasons = (
        (submap.num_outliers, "no ground explains it", "no ground explains them"),
        (submap.num_non_ground, "it stands on the ground", "they stand on the ground"),
    )
    total = submap.num_points + submap.num_outliers + submap.num_non_ground
    return [
        f"{name}: {count:,} of {total:,} points {'was' if count == 1 else 'were'} left out: "
        f"{of_one if count == 1 else of_many}"
        for count, of_one, of_many in reasons
        if count
    ]


def read_cloud(path: Path, names: Collection[str] = ()) -> PointCloud:
    """Read what a file holds, without changes: any points, or none.

    `names` are further numbers of each point to read, such as ``intensity``: in ``.ply``, ``.npz``
    and ``.pcd`` those of the file, in others `clouds.npy.REFLECTANCE` and `clouds.las.FIELDS`.
    """
    cloud_format = format_of(path)
    with readable(path):
        cloud = cloud_format.read(path, names)
    for name, values in cloud.numbers.items():
        if len(values) != len(cloud.points):
            raise InputError(
                f"{path}: {name} has {len(values):,} rows, the points have {len(cloud.points):,}"
            )
    return cloud


def format_of(path: Path) -> CloudFormat:
    """Find the format of a file by its ending; InputError if it is missing or of no known one."""
    if not check_path(path).exists():
        raise InputError(f"{path}: no such file")
    cloud_format = CLOUD_FORMATS.get(path.suffix.lower())
    if cloud_format is None:
        raise InputError(
            f"{path}: unknown ending {path.suffix!r}; the known ones are {CLOUD_ENDINGS}"
        )
    return cloud_format


def unpacked_bytes(path: Path) -> int:
    """The bytes that a cloud takes in memory, decompressed; InputError if it is broken."""
    measure = format_of(path).unpacked_bytes
    with readable(path):
        return path.stat().st_size if measure is None else measure(path)


def voxel_means(points: Float[Array, "n 3"], size: float) -> Float[Array, "m 3"]:
    """Replace the points of each voxel of a side [m] by their mean [m], in order of x, y, z."""
    cells = np.floor(points / size).astype(np.int64)
    cells -= cells.min(axis=0)
    spans = cells.max(axis=0) + 1
    keys = (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2]
    _, owner, counts = np.unique(keys, return_inverse=True, return_counts=True)
    sums = [np.bincount(owner, points[:, axis]) for axis in range(3)]
    return np.column_stack(sums) / counts[:, None]
