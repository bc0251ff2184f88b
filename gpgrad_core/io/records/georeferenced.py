"""Files that other programs put at the right place: rasters, clouds and tracks with coordinates."""

import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.io.georeference import EXTRA, Georeference
from gpgrad_core.io.records.files import replacing
from gpgrad_core.io.records.maps import Layer, write_raster
from gpgrad_core.libraries import load_library
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.types import Grid

BLOCK = 256
"""Side of a tile of a raster [cells]."""


def check_libraries() -> None:
    """Raise InputError unless the libraries for these files are installed."""
    for name in ("pyproj", "laspy", "lazrs"):
        load_library(name, EXTRA)


def write_cloud_optimised(
    path: Path, grid: Grid, layers: Mapping[str, Layer], georeference: Georeference
) -> None:
    """Write a cloud-optimised GeoTIFF by GDAL: a band per layer, in the system's coordinates."""
    rasterio = load_library("rasterio")
    copy = load_library("rasterio.shutil").copy
    with TemporaryFolder(".raster-", path.parent) as folder, replacing(path) as unfinished:
        plain = Path(folder) / "plain.tif"
        write_raster(plain, grid, layers)
        with rasterio.open(plain, "r+") as raster:
            raster.crs = rasterio.crs.CRS.from_wkt(georeference.wkt)
        copy(
            plain,
            unfinished,
            driver="COG",
            compress="DEFLATE",
            blocksize=BLOCK,
            overviews="AUTO",
            overview_resampling="average",
            bigtiff="IF_SAFER",
        )


def write_laz(
    path: Path, pieces: Iterable[Float[Array, "_n 3"]], georeference: Georeference
) -> int:
    """Write points as LAZ 1.4 with their coordinate system, from pieces in its coordinates [m]."""
    laspy, pyproj = load_library("laspy", EXTRA), load_library("pyproj", EXTRA)
    header = laspy.LasHeader(point_format=6, version="1.4")
    # Near the points, because LAS counts steps from there in 32 bits.
    header.offsets = np.floor(georeference.apply(np.zeros((1, 3)))[0])
    header.scales = np.full(3, 0.001)  # LAS has whole numbers: of millimetres
    header.add_crs(pyproj.CRS.from_wkt(georeference.wkt))
    count = 0
    with (
        replacing(path) as unfinished,
        unfinished.open("wb") as file,
        laspy.open(file, mode="w", header=header, do_compress=True, closefd=False) as writer,
    ):
        for piece in pieces:
            record = laspy.ScaleAwarePointRecord.zeros(len(piece), header=header)
            record.x, record.y, record.z = piece.T
            writer.write_points(record)
            count += len(piece)
    return count


def write_geojson(
    path: Path, tracks: Mapping[str, Sequence[str]], places: Mapping[str, Float[Array, "3"]]
) -> None:
    """Write traverses and submaps as GeoJSON (RFC 7946); places are longitude, latitude, height."""
    lines = [
        _feature("LineString", [_rounded(places[name]) for name in names], traverse=track)
        for track, names in tracks.items()
        if len(names) > 1
    ]
    points = [
        _feature("Point", _rounded(places[name]), traverse=track, submap=name)
        for track, names in tracks.items()
        for name in names
    ]
    content = {"type": "FeatureCollection", "features": [*lines, *points]}
    with replacing(path) as unfinished:
        text = json.dumps(content, ensure_ascii=False, allow_nan=False)
        unfinished.write_text(text + "\n", encoding="utf-8")


def write_kml(
    path: Path, tracks: Mapping[str, Sequence[str]], places: Mapping[str, Float[Array, "3"]]
) -> None:
    """Write traverses as KML 2.2 (OGC 07-147r2), on the ground: KML's heights are above the sea."""
    parts: list[str] = []
    for track, names in tracks.items():
        line = " ".join(_written(places[name]) for name in names)
        parts.append(
            f"<Folder><name>{escape(track)}</name><Placemark><name>{escape(track)}</name>"
            f"<LineString><tessellate>1</tessellate><coordinates>{line}</coordinates></LineString>"
            "</Placemark>"
            + "".join(
                f"<Placemark><name>{escape(name)}</name><Point><coordinates>"
                f"{_written(places[name])}</coordinates></Point></Placemark>"
                for name in names
            )
            + "</Folder>"
        )
    with replacing(path) as unfinished:
        unfinished.write_text(
            '<?xml version="1.0" encoding="UTF-8"?>\n'
            '<kml xmlns="http://www.opengis.net/kml/2.2"><Document>'
            f"{''.join(parts)}</Document></kml>\n",
            encoding="utf-8",
        )


def _feature(kind: str, coordinates: object, **properties: str) -> dict[str, object]:
    return {
        "type": "Feature",
        "geometry": {"type": kind, "coordinates": coordinates},
        "properties": properties,
    }


def _rounded(place: Float[Array, "3"]) -> list[float]:
    """Keep a tenth of a millimetre: nine digits of a degree."""
    return [round(float(place[0]), 9), round(float(place[1]), 9), round(float(place[2]), 4)]


def _written(place: Float[Array, "3"]) -> str:
    return ",".join(f"{number:.9f}".rstrip("0").rstrip(".") for number in _rounded(place))
