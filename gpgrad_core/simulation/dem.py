"""A digital elevation model in a GeoTIFF -> its heights, and ground to drive on.

The first band of the first image is read, with the tags of the OGC's GeoTIFF standard 1.1 (OGC
19-008r4): ModelPixelScaleTag (33550) has the size of a cell and ModelTiepointTag (33922) the place
of one, or ModelTransformationTag (34264) has both if it has no rotation. Of GeoKeyDirectoryTag
(34735), GTModelTypeGeoKey (1024) says whether the model is projected, ProjectedCRSGeoKey (3072) by
which system, ProjLinearUnitsGeoKey (3076) in which unit, and GTRasterTypeGeoKey (1025) whether a
place is a cell's corner or its middle. GDAL's tag 42113 is the number that stands for no height.

A damaged file is refused, as GDAL does: tifffile would make heights of what is left of it.
"""

import contextlib
import logging
import sys
import zlib
from collections.abc import Generator
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, cast

import numpy as np
import tifffile
from jaxtyping import Float
from scipy import ndimage

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.reading.files import check_regular
from gpgrad_core.reading.paths import check_path
from gpgrad_core.simulation.params import ROCK_STREAM, SimulationParams, stream
from gpgrad_core.simulation.terrain import RESOLUTION, HeightField, add_rocks
from gpgrad_core.types import MAX_COORDINATE

MOST_CELLS = 100_000_000
"""Of a model; they are read together, as 64-bit numbers of the window only."""
PIXEL_SCALE, TIE_POINT, TRANSFORMATION, GEO_KEYS, NO_DATA = 33550, 33922, 34264, 34735, 42113
MODEL_TYPE, RASTER_TYPE, PROJECTED_SYSTEM, LINEAR_UNITS = 1024, 1025, 3072, 3076
GEOGRAPHIC, METRE, MIDDLES = 2, 9001, 2
USER_DEFINED = 32767
UNKNOWN_UNITS = (0, 32767)
HEADER = 8
"""Bytes at the beginning of a TIFF that are no cells."""
DEFLATE = (8, 32946)
"""Compressions by zlib: Adobe's number and the older one."""

SHORT, LONG, LONG8, REAL, TEXT = (3,), (3, 4), (3, 4, 16), (11, 12), (2,)
"""Types of a tag's values, as TIFF 6.0 and BigTIFF number them."""
ONE, SOME = range(1, 2), range(1, sys.maxsize)
TAGS: dict[int, tuple[str, tuple[int, ...], range]] = {
    256: ("ImageWidth", LONG, ONE),
    257: ("ImageLength", LONG, ONE),
    258: ("BitsPerSample", SHORT, SOME),
    259: ("Compression", SHORT, ONE),
    262: ("PhotometricInterpretation", SHORT, ONE),
    266: ("FillOrder", SHORT, ONE),
    273: ("StripOffsets", LONG8, SOME),
    277: ("SamplesPerPixel", SHORT, ONE),
    278: ("RowsPerStrip", LONG, ONE),
    279: ("StripByteCounts", LONG8, SOME),
    284: ("PlanarConfiguration", SHORT, ONE),
    317: ("Predictor", SHORT, ONE),
    322: ("TileWidth", LONG, ONE),
    323: ("TileLength", LONG, ONE),
    324: ("TileOffsets", LONG8, SOME),
    325: ("TileByteCounts", LONG8, SOME),
    339: ("SampleFormat", SHORT, SOME),
    PIXEL_SCALE: ("ModelPixelScale", REAL, range(2, 4)),
    TIE_POINT: ("ModelTiepoint", REAL, range(6, sys.maxsize, 6)),
    TRANSFORMATION: ("ModelTransformation", REAL, range(16, 17)),
    GEO_KEYS: ("GeoKeyDirectory", SHORT, range(4, sys.maxsize, 4)),
    NO_DATA: ("GDAL_NODATA", TEXT, SOME),
}
"""The tags that are read: name, types, and how many values there may be."""
SIZES = (256, 257, 277, 278, 322, 323)


@dataclass(frozen=True)
class ElevationModel:
    """Which elevation model is the ground of a simulation.

    Attributes:
        path: The GeoTIFF.
        scale: How many metres of the simulation a metre of the model becomes, in all directions.
        exaggeration: Factor of the heights, after the scale.
    """

    path: Path
    scale: float = 1.0
    exaggeration: float = 1.0

    def __post_init__(self) -> None:
        """Check the factors.

        Raises:
            InputError: If one is not a number from 0.0001 to 10,000.
        """
        for name, value in (("scale", self.scale), ("exaggeration", self.exaggeration)):
            if not 1e-4 <= value <= 1e4:
                raise InputError(f"the terrain's {name} must be from 0.0001 to 10,000, got {value}")


def ground_of(
    model: ElevationModel, params: SimulationParams, track: Float[Array, "n 2"]
) -> HeightField:
    """Make the ground of a simulation from the middle of an elevation model.

    Between the model's cells, heights are those of a cubic spline. Only rocks are laid on it, as
    the parameters say; what the parameters say of relief, hills, ripples and craters is not used.

    Args:
        model: The model.
        params: The extent of the ground, the rocks and the seed.
        track: Where the rover drives (n, 2) [m]; rocks keep away from it.

    Raises:
        InputError: If the model cannot be read, is smaller than the ground, or has no height
            somewhere on it; or if the parameters ask for ground with rows.
    """
    if params.ground != "varied":
        raise InputError(
            f"{model.path}: the ground {params.ground!r} is made, and cannot be laid on an "
            "elevation model; leave out one of the two"
        )
    read = read_elevation_model(model.path)
    heights, (width, height) = read.heights, read.cell
    step = np.array([height, width]) * model.scale  # of a cell, along rows and columns [m]
    sides = (np.array(heights.shape) - 1) * step
    if sides.min() < params.extent:
        raise InputError(
            f"{model.path}: covers {sides[1]:.4g} m x {sides[0]:.4g} m at the scale "
            f"{model.scale:g}, but the ground has a side of {params.extent:g} m; lower --extent or "
            "raise --terrain-scale"
        )
    size = int(np.ceil(params.extent / RESOLUTION)) + 1
    # The middle of the ground is that of the model.
    along = RESOLUTION * (np.arange(size) - 0.5 * (size - 1))
    row, column = (
        0.5 * (n - 1) + along / step_along
        for n, step_along in zip(heights.shape, step, strict=True)
    )
    low = [max(int(np.floor(cells[0])) - 8, 0) for cells in (row, column)]
    high = [int(np.ceil(cells[-1])) + 9 for cells in (row, column)]
    window = heights[low[0] : high[0], low[1] : high[1]].astype(np.float64)
    unknown = int(np.sum(~np.isfinite(window)))
    if unknown:
        raise InputError(
            f"{model.path}: has no height at {unknown:,} of the {window.size:,} cells in its "
            "middle; fill them, or crop it so that its middle is whole"
        )
    places = np.meshgrid(row - low[0], column - low[1], indexing="ij")
    elevation = ndimage.map_coordinates(window, places, order=3, mode="nearest")
    elevation = (elevation - np.median(elevation)) * model.scale * model.exaggeration
    add_rocks(elevation, params, track, stream(params.seed, ROCK_STREAM))
    return HeightField(elevation)


@dataclass(frozen=True, eq=False)
class Elevations:
    """The heights of an elevation model.

    Attributes:
        heights: Heights (rows, columns) [m], row 0 in the south; NaN where there is none.
        cell: Width and height of a cell [m].
        corner: Easting and northing of the middle of the first cell, in the south-west [m]; zeros
            if the file does not say.
        system: The coordinate system, such as ``EPSG:32633``; empty if the file has no code of it.
    """

    heights: Float[NDArray[np.floating], "rows columns"]
    cell: tuple[float, float]
    corner: tuple[float, float] = (0.0, 0.0)
    system: str = ""


def read_elevation_model(path: Path) -> Elevations:
    """Read an elevation model.

    Args:
        path: The GeoTIFF.

    Raises:
        InputError: If it is no GeoTIFF of numbers, is too large, is in degrees or another unit
            than metres, or is turned.
    """
    if not check_path(path).exists():
        raise InputError(f"{path}: no such file")
    check_regular(path)
    try:
        with _refusing_what_is_logged(), tifffile.TiffFile(path) as file:
            page = cast("Any", file.pages[0])
            _check_tags(page, path)
            shape = tuple(int(n) for n in page.shape)
            if len(shape) not in (2, 3) or not 0 < np.prod(shape) <= MOST_CELLS:
                raise InputError(
                    f"{path}: has {' x '.join(map(str, shape))} cells; an elevation model has rows "
                    f"and columns, up to {MOST_CELLS:,} cells; crop it"
                )
            _check_segments(page, path)
            tags = {int(tag.code): tag.value for tag in page.tags.values()}
            values = np.asarray(page.asarray())
            if values.ndim == 3:  # the first band
                values = values[0] if int(page.planarconfig) == 2 else values[..., 0]
    except InputError:
        raise
    except Exception as error:  # tifffile raises its own and those of what it reads
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: is no GeoTIFF that can be read: {said:.200}") from None
    if values.dtype.kind not in "fiu" or values.ndim != 2 or min(values.shape) < 2:
        raise InputError(f"{path}: has no heights: {values.dtype} of shape {values.shape}")
    keys = _geo_keys(tags)
    _check_units(keys, path)
    cell = _cell_size(tags, path)
    corner = _corner(tags, keys, cell, len(values), path)
    code = keys.get(PROJECTED_SYSTEM, USER_DEFINED)
    system = f"EPSG:{code}" if 0 < code < USER_DEFINED else ""
    return Elevations(_known(values, tags.get(NO_DATA), path)[::-1], cell, corner, system)


@contextlib.contextmanager
def _refusing_what_is_logged() -> Generator[None]:
    """Raise an error where tifffile logs one and goes on; what it warns of is not shown.

    It warns of what is no damage, such as a number for no height that no cell can hold.
    """
    logger, handler = logging.getLogger("tifffile"), _Raising(logging.ERROR)
    before = logger.propagate
    logger.addHandler(handler)
    logger.propagate = False
    try:
        yield
    finally:
        logger.propagate = before
        logger.removeHandler(handler)


class _Raising(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        raise tifffile.TiffFileError(record.getMessage())


def _check_tags(page: Any, path: Path) -> None:
    """Check that each tag is there once, with values of its type and as many as it has.

    Raises:
        InputError: If one does not, or says that something has the size 0.
    """
    for code, (name, kinds, counts) in TAGS.items():
        for tag in page.tags.getall(code, default=()):
            if int(tag.dtype) not in kinds or tag.count not in counts:
                raise InputError(
                    f"{path}: is no GeoTIFF that can be read: its tag {name} ({code}) has "
                    f"{tag.count:,} values of type {int(tag.dtype)}"
                )
            if code in SIZES and not tag.value:
                raise InputError(
                    f"{path}: is no GeoTIFF that can be read: its tag {name} ({code}) is 0"
                )
        if len(page.tags.getall(code, default=())) > 1:
            raise InputError(
                f"{path}: is no GeoTIFF that can be read: it has the tag {name} ({code}) twice"
            )


def _check_segments(page: Any, path: Path) -> None:
    """Check that the file holds all cells of all strips or tiles, and no more.

    Raises:
        InputError: If one lies outside of the file, is too short, or unpacks to another length;
            empty ones need a number that stands for no height.
    """
    kind, *codes = ("tile", 324, 325) if page.is_tiled else ("strip", 273, 279)
    offsets, counts = (np.atleast_1d(page.tags.valueof(code, default=())) for code in codes)
    number = prod(page.chunked)
    if not len(offsets) == len(counts) == number:
        raise InputError(
            f"{path}: is no GeoTIFF that can be read: it has {len(offsets):,} places and "
            f"{len(counts):,} lengths of {number:,} {kind}s"
        )
    lengths, packed = _unpacked_lengths(page), int(page.compression) in DEFLATE
    size = path.stat().st_size
    with path.open("rb") as file:
        for k, (offset, count) in enumerate(zip(map(int, offsets), map(int, counts), strict=True)):
            if offset == count == 0 and NO_DATA in page.tags:  # as GDAL writes one without heights
                continue
            length = lengths[k % len(lengths)]
            least = length if page.compression == 1 else 1
            whole = offset >= HEADER and count >= least and offset + count <= size
            if whole and packed:
                file.seek(offset)
                unpacked = zlib.decompressobj().decompress(file.read(count), lengths[0] + 1)
                whole = len(unpacked) in (length, lengths[0])
            if not whole:
                raise InputError(
                    f"{path}: is no GeoTIFF that can be read: its {kind} {k + 1:,} of {number:,} "
                    "lies outside of the file, or has not as many cells as it should"
                )


def _unpacked_lengths(page: Any) -> list[int]:
    """Compute the bytes of each strip of a band, from the north on; or of any tile."""
    samples = int(page.samplesperpixel) if int(page.planarconfig) == 1 else 1
    cell = samples * int(page.bitspersample) // 8
    if page.is_tiled:
        return [int(page.tilelength) * int(page.tilewidth) * cell]
    rows, step = int(page.imagelength), int(page.rowsperstrip)
    row = int(page.imagewidth) * cell
    return [min(step, rows - first) * row for first in range(0, rows, step)]


def _known(
    values: NDArray[np.generic], no_data: object, path: Path
) -> Float[NDArray[np.floating], "rows columns"]:
    with np.errstate(invalid="ignore"):  # numbers that are none
        heights = values.astype(np.float32 if values.dtype.itemsize <= 2 else np.float64)
    if no_data is not None:
        try:
            nothing = float(str(no_data).strip("\0 "))
        except ValueError:
            raise InputError(f"{path}: its tag of no data is no number: {no_data!r:.40}") from None
        with np.errstate(over="ignore"):  # a number that no cell holds
            heights[values == nothing] = np.nan
    # No height on any planet; models that lack the tag have such numbers for no height.
    heights[~(np.abs(heights) < 1e5)] = np.nan
    return heights


def _geo_keys(tags: dict[int, object]) -> dict[int, int]:
    """List the keys whose values are numbers in the directory itself."""
    keys = np.asarray(tags.get(GEO_KEYS, ()), dtype=np.int64).ravel()
    rows = keys[4 : len(keys) // 4 * 4].reshape(-1, 4)  # key, where its value is, count, value
    return {int(key): int(value) for key, place, _, value in rows if place == 0}


def _check_units(held: dict[int, int], path: Path) -> None:
    if held.get(MODEL_TYPE) == GEOGRAPHIC:
        raise InputError(
            f"{path}: is in degrees; project it to metres first: gdalwarp -t_srs EPSG:32633 …"
        )
    unit = held.get(LINEAR_UNITS, METRE)
    if unit not in (METRE, USER_DEFINED, 0):  # 0 says nothing
        raise InputError(f"{path}: is not in metres (unit {unit}); project it to metres first")


def _cell_size(tags: dict[int, object], path: Path) -> tuple[float, float]:
    """Find width and height of a cell [m]."""
    scale = np.asarray(tags.get(PIXEL_SCALE, ()), np.float64).ravel()
    turned = np.asarray(tags.get(TRANSFORMATION, ()), np.float64).ravel()
    if len(scale) < 2 and len(turned) == 16:
        matrix = turned.reshape(4, 4)
        if matrix[0, 1] != 0 or matrix[1, 0] != 0 or matrix[0, 0] <= 0 or matrix[1, 1] >= 0:
            raise InputError(f"{path}: is turned or mirrored; warp it so that north is up")
        scale = np.array([matrix[0, 0], -matrix[1, 1]])
    if len(scale) < 2:
        raise InputError(f"{path}: has no cell size; is it a GeoTIFF?")
    if not (np.isfinite(scale[:2]).all() and scale[:2].min() >= 1e-4 and scale[:2].max() <= 1e5):
        raise InputError(f"{path}: its cells of {scale[0]:g} x {scale[1]:g} m are not plausible")
    return float(scale[0]), float(scale[1])


def _corner(
    tags: dict[int, object], keys: dict[int, int], cell: tuple[float, float], rows: int, path: Path
) -> tuple[float, float]:
    """Find easting and northing of the middle of the cell in the south-west [m]."""
    tie = np.asarray(tags.get(TIE_POINT, ()), np.float64).ravel()
    turned = np.asarray(tags.get(TRANSFORMATION, ()), np.float64).ravel()
    if len(tie) >= 6:
        column, row, east, north = tie[0], tie[1], tie[3], tie[4]
    elif len(turned) == 16:
        column, row, east, north = 0.0, 0.0, turned[3], turned[7]
    else:
        return 0.0, 0.0
    inner = 0.0 if keys.get(RASTER_TYPE) == MIDDLES else 0.5
    corner = east + (inner - column) * cell[0], north - (rows - 1 + inner - row) * cell[1]
    if not (np.isfinite(corner).all() and max(map(abs, corner)) < MAX_COORDINATE):
        raise InputError(f"{path}: its place {east:g}, {north:g} is not plausible")
    return float(corner[0]), float(corner[1])
