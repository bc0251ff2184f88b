"""Rasters of heights: elevation models in GeoTIFF.

GDAL reads them, by the library rasterio. Where it warns of damage and goes on, or makes heights of
cells that the file lacks, the file is refused.
"""

import threading
import warnings
import zlib
from dataclasses import dataclass
from logging import WARNING, getLogger
from logging.handlers import QueueHandler
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError, message_of
from gpgrad_core.io.georeference import DEPTHS, unit_length, units_of_crs
from gpgrad_core.libraries import load_library
from gpgrad_core.reading.files import check_regular, open_regular
from gpgrad_core.reading.paths import check_path
from gpgrad_core.types import MAX_COORDINATE

MOST_CELLS = 100_000_000
"""Of a model, and of one of its strips or tiles; they are read together."""
HIGHEST, LARGEST_RADIUS = 1e5, 1e8
"""Limits of a height and of a planet's radius [m]: models without a number for no height have such
ones beyond these."""
MOST_COMPARED = 100_000
"""Number of cells that distinguish radii from heights."""
NO_DATA = 42113
"""GDAL's tag of the number that stands for no height."""
LOGGERS = ("rasterio", "tifffile")
SETTINGS = {
    "GTIFF_REPORT_COMPD_CS": "NO",  # the unit of heights stands with the band
    "GDAL_ENABLE_TIFF_SPLIT": "NO",  # a strip is a strip, however large
}


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
    """Read an elevation model: the band named "elevation", or else the first."""
    if not check_path(path).exists():
        raise InputError(f"{path}: no such file")
    check_regular(path)
    # GDAL reads files beside a model with it, such as masks, whatever the case of their names.
    for file in path.parent.iterdir():
        beside = file.name.casefold().startswith(path.stem.casefold())
        if beside and file.exists() and not file.is_dir():
            check_regular(file)
    rasterio = load_library("rasterio")
    log: SimpleQueue[Any] = SimpleQueue()
    handler, thread = QueueHandler(log), threading.get_ident()
    handler.setLevel(WARNING)
    handler.addFilter(lambda record: record.thread == thread)
    for name in LOGGERS:
        getLogger(name).addHandler(handler)
    try:
        with rasterio.Env(**SETTINGS), warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            # No other driver, because some read what a file of theirs names.
            with rasterio.open(path.absolute(), driver="GTiff") as raster:
                unplaced = rasterio.errors.NotGeoreferencedWarning
                placed = not any(one.category is unplaced for one in warned)
                with (
                    rasterio.Env(GTIFF_REPORT_COMPD_CS="YES"),
                    rasterio.open(path.absolute(), driver="GTiff") as again,
                ):
                    _check_system(again.crs)  # which has the axis of heights here
                model = _read(raster, path, placed=placed)
        while not log.empty():
            if "ignor" in (message := log.get().getMessage()):  # others are of no damage
                raise ValueError(message)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:  # rasterio raises its own and those of GDAL
        message = message_of(error.__cause__ or error)
        raise InputError(f"{path}: is no GeoTIFF that can be read: {message:.200}") from None
    finally:
        for name in LOGGERS:
            getLogger(name).removeHandler(handler)
    return model


def _read(raster: Any, path: Path, *, placed: bool) -> Elevations:
    names = [str(name).lower() for name in raster.descriptions]
    band = names.index("elevation") if "elevation" in names else 0
    kind, shape, place = np.dtype(raster.dtypes[band]), raster.shape, raster.transform
    if raster.count * max(np.prod(shape), np.prod(raster.block_shapes[band])) > MOST_CELLS:
        cells = " x ".join(map(str, (raster.count, *shape)[raster.count == 1 :]))
        raise InputError(
            f"has {cells} cells; an elevation model has rows and columns, up to {MOST_CELLS:,} "
            "cells; crop it"
        )
    if kind.kind not in "fiu" or min(shape) < 2:
        raise InputError(f"has no heights: {kind} of shape {shape}")
    if raster.colorinterp[band].name not in ("gray", "undefined"):
        raise InputError(f"has no heights: {raster.colorinterp[band].name}, as a picture")
    if place.is_identity:
        raise InputError("has no cell size; is it a GeoTIFF?")
    if place.b != 0 or place.d != 0 or place.a <= 0 or place.e >= 0:
        raise InputError("is turned or mirrored; warp it so that north is up")
    cell = (place.a, -place.e)
    if not 1e-4 <= min(cell) <= max(cell) <= 1e5:
        raise InputError(f"its cells of {cell[0]:g} x {cell[1]:g} m are not plausible")
    corner = (place.c + 0.5 * place.a, place.f + (shape[0] - 0.5) * place.e)
    if not all(abs(one) < MAX_COORDINATE for one in corner):
        raise InputError(f"its place {place.c:g}, {place.f:g} is not plausible")
    name = "" if raster.crs is None else raster.crs.to_string()
    system = name if name.startswith("EPSG:") else ""
    _check_blocks(raster, band, path)
    return Elevations(_heights(raster, band)[::-1], cell, corner if placed else (0.0, 0.0), system)


def _check_system(crs: Any) -> None:
    """Refuse a system whose map is not in metres, or whose heights do not count upwards."""
    if crs is None:
        return
    try:
        unit, _ = units_of_crs(crs)
        if unit != 1.0:
            raise InputError(
                f"is not in metres (unit {crs.units_factor[0]}); project it to metres first"
            )
    except InputError as error:
        warp = "" if str(error) == DEPTHS else ": gdalwarp -t_srs EPSG:32633 …"
        raise InputError(f"{error}{warp}") from None


def _check_blocks(raster: Any, band: int, path: Path) -> None:
    """Check that the file holds all cells of all strips or tiles of a band, and no more."""
    rows, columns = raster.block_shapes[band]
    down, across = -(-raster.height // rows), -(-raster.width // columns)
    stored = raster.tags(ns="IMAGE_STRUCTURE")
    with load_library("tifffile").TiffFile(path) as parsed:  # for what GDAL does not tell
        tiled, tags = parsed.pages[0].is_tiled, parsed.pages[0].tags
        no_data = str(tags.valueof(NO_DATA, default="nan")).strip("\0 ")
    try:
        float(no_data)
    except ValueError:  # GDAL takes it for 0
        raise InputError(f"its tag of no data is no number: {no_data!r:.40}") from None
    bands = raster.count if stored.get("INTERLEAVE") == "PIXEL" else 1
    row = columns * bands * np.dtype(raster.dtypes[band]).itemsize
    size = path.stat().st_size
    with open_regular(path) as file:
        for k in range(down * across):
            offset, count = (
                raster.get_tag_item(f"BLOCK_{what}_{k % across}_{k // across}", "TIFF", band + 1)
                for what in ("OFFSET", "SIZE")
            )
            if offset is None and raster.nodata is not None:
                continue
            begin, count = int(offset or 0), int(count or 0)
            whole = begin >= 8 and 0 < count <= size - begin  # after the file's header
            if whole and stored.get("COMPRESSION") == "DEFLATE":
                # Of more cells than it expects, GDAL returns whatever its memory held.
                length = row * (rows if tiled else min(rows, raster.height - k * rows))
                file.seek(begin)
                unpacked = zlib.decompressobj().decompress(file.read(count), length + 1)
                whole = len(unpacked) == length
            if not whole:
                kind = "tile" if tiled else "strip"
                raise InputError(
                    f"is no GeoTIFF that can be read: its {kind} {k + 1:,} of {down * across:,} "
                    "lies outside of the file, or has not as many cells as it should"
                )


def _heights(raster: Any, band: int) -> Float[NDArray[np.floating], "rows columns"]:
    """Read the heights [m], row 0 in the north; NaN where there is none."""
    unit = unit_length(raster.units[band] or "m")
    scale, offset = unit * raster.scales[band], unit * raster.offsets[band]
    if not (np.isfinite([scale, offset]).all() and scale != 0):
        raise InputError(f"its heights have the scale {scale:g} and the offset {offset:g}")
    values = raster.read(band + 1)
    whole = values.dtype.itemsize <= 2 and (scale, offset) == (1.0, 0.0)
    heights = values.astype(np.float32 if whole else np.float64)
    valid = raster.read_masks(band + 1) != 0
    for number, one in enumerate(raster.colorinterp, start=1):
        if one.name == "alpha":  # of which GDAL makes a mask for small numbers only
            valid &= raster.read(number) != 0
    with np.errstate(invalid="ignore", over="ignore"):  # numbers that are none
        heights *= scale
        # Before the offset, which may be the radius of a planet, or lead from it to heights.
        some = heights[valid & (np.abs(heights) < LARGEST_RADIUS)]
        middle = np.median(some[:: len(some) // MOST_COMPARED + 1]) if len(some) else 0.0
        radius = middle if middle > HIGHEST else 0.0
        heights[~(valid & (np.abs(heights - radius) < HIGHEST))] = np.nan
        heights += offset
    return heights
