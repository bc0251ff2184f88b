"""XYZ products of Mars rovers in PDS3's form, and the rover's places -> a recording.

An XYZ product is an image of three bands, x, y and z [m] of what each pixel shows, by stereo. It is
a ``.IMG`` with a detached label ``.LBL`` beside it, which the library ``pdr`` (Planetary Data
Reader, an extra) reads. The label's group ``DERIVED_IMAGE_PARMS`` has ``DERIVED_IMAGE_TYPE`` (one
that begins with XYZ) and ``REFERENCE_COORD_SYSTEM_NAME``, the frame of the points: SITE_FRAME or
ROVER_NAV_FRAME. The group ``ROVER_COORDINATE_SYSTEM`` has the rover in its site's frame:
``ORIGIN_OFFSET_VECTOR`` [m] and ``ORIGIN_ROTATION_QUATERNION`` with the real part first. In all
frames x points north or ahead, y east or right, and z down. A pixel of 0 0 0, or of the image's
``MISSING_CONSTANT``, shows nothing. These keys were taken from ``PDSParser`` of NASA's Landform,
which reads the products of MSL and Mars 2020.

The rover's places over many sites are tables of the PLACES archive, ``localized_interp.csv`` (MSL)
or ``best_interp.csv`` (Mars 2020): the label of the former names the columns frame, site, drive and
pose, and the program marsimage takes the pose from northing, easting, elevation [m] and yaw, pitch
and roll [degrees], as the rotation Rz(yaw) Ry(pitch) Rx(roll).

Unverified, as no product could be downloaded: real labels, and everything about Mars 2020's own
labels, which are PDS4 (not read).
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError, message_of
from gpgrad_core.io.poses import check_position, make_pose
from gpgrad_core.libraries import load_library
from gpgrad_core.reading.files import check_regular, open_regular
from gpgrad_core.reading.text import parse_numbers
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.pose_files import table_rows
from gpgrad_core.recordings.recording import (
    FoundPoses,
    FoundScans,
    Recording,
    RecordingSources,
    Scan,
    assemble,
    find_file,
)
from gpgrad_core.recordings.trajectory import Located, Poses
from gpgrad_core.run import Cancelled
from gpgrad_core.se2 import Pose

Content: TypeAlias = Any
"""What the library pdr reads of a product."""
LARGEST_LABEL = 1_000_000
"""Bytes of a label."""
MOST_PIXELS = 1 << 25
"""Of a product; rovers have 1 << 20 to 1 << 21."""
LARGEST_COUNT = 1e9
"""Limit of the numbers of a rover's motion counter; larger ones are not exact as they are read."""
TABLES = ("localized_interp.csv", "best_interp.csv", "localized_pos.csv", "best_tactical.csv")
COLUMNS = ("site", "drive", "northing", "easting", "elevation", "yaw", "pitch", "roll")
SITE, ROVER = ("SITE_FRAME",), ("ROVER_NAV_FRAME", "ROVER_FRAME")
ROVER_GROUPS = ("ROVER_COORDINATE_SYSTEM", "ROVER_COORDINATE_SYSTEM_PARMS")


def has_products(path: Path) -> bool:
    """Whether a path is a folder with labels of XYZ products."""
    return path.is_dir() and any(map(_is_xyz, path.iterdir()))


def _is_xyz(label: Path) -> bool:
    if label.suffix.lower() != ".lbl" or not label.is_file():
        return False
    with open_regular(label) as file:
        content = file.read(LARGEST_LABEL)
    says_xyz = re.search(rb'DERIVED_IMAGE_TYPE\s*=\s*"?XYZ', content)
    return content.lstrip().startswith(b"PDS_VERSION_ID") and says_xyz is not None


@dataclass(frozen=True, eq=False)
class Product:
    """What the label of an XYZ product says."""

    label: Path  # the label's file
    clock: float  # the spacecraft's clock [s]
    place: tuple[int, int, int]  # numbers of site, drive and pose in the rover's motion counter
    in_site: bool  # whether the points are in the frame of the site; else in the rover's
    rover: Pose  # ``T_site_rover``
    missing: tuple[float, ...]  # x, y and z of a pixel that shows nothing


def open_products(path: Path, sources: RecordingSources, params: BuildParams) -> Recording:
    """Open the XYZ products in a folder as scans of the rover, in the order of its clock."""
    sources.refuse("XYZ products have their own times and frames", "truth", "times", "mount")
    sources.refuse("XYZ products have x, y and z only", "keep")
    labels = filter(_is_xyz, sorted(path.iterdir()))
    products = sorted(map(_read_label, labels), key=lambda product: product.clock)
    table = sources.poses or find_file([path], TABLES)
    if table is not None:
        places = read_places_table(table)
        poses = [_pose_of(product, places, table) for product in products]
        frame = f"the rover's places are those of {table.name}"
    else:
        sites = sorted({product.place[0] for product in products})
        if len(sites) > 1:
            raise InputError(
                f"{path}: its products are of the sites {', '.join(map(str, sites[:5]))}; copy "
                f"{TABLES[0]} of PLACES into the folder, or name it: --poses FILE"
            )
        poses = [product.rover for product in products]
        frame = f"the rover's places are those of the labels, in the frame of site {sites[0]}"
    return assemble(
        path,
        sources,
        params,
        FoundScans(
            labels=[product.label.name for product in products],
            read=lambda numbers: (Scan(_points(products[k])) for k in numbers),
            stamps=np.array([product.clock for product in products]),
            files=[(product.label, *_images(product.label)) for product in products],
        ),
        FoundPoses(Located.all_valid(Poses.of(*poses)), up="-z"),
        texts=[table],
        notes=(f"{frame}; its z axis points down and is turned up",),
    )


def _images(label: Path) -> list[Path]:
    beside = label.parent.iterdir()
    return [k for k in beside if k.stem == label.stem and k.suffix.lower() == ".img"]


def _pose_of(product: Product, places: Mapping[tuple[int, ...], Pose], table: Path) -> Pose:
    """Find the rover's pose of a product: that of its site, drive and pose, or of its drive."""
    for key in (product.place, product.place[:2]):
        if key in places:
            return places[key]
    site, drive, _ = product.place
    raise InputError(f"{table}: has no place of site {site}, drive {drive}, of {product.label}")


def read_places_table(path: Path) -> dict[tuple[int, ...], Pose]:
    """Read the rover's poses in north, east, down [m] by (site, drive, pose) and (site, drive)."""
    rows = table_rows(path, comments=())
    names = [name.lower() for name in rows[0][1]] if rows else []
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise InputError(f"{path}: is no table of PLACES: it has no column {', '.join(missing)}")
    places: dict[tuple[int, ...], Pose] = {}
    for where, row in rows[1:]:
        if len(row) != len(names):
            raise InputError(f"{where}: has {len(row)} columns, the first row {len(names)}")
        cells = dict(zip(names, row, strict=True))
        if cells.get("frame", "ROVER").upper() == "ROVER":
            _add_place(places, cells, where)
    if not places:
        raise InputError(f"{path}: holds no place of the rover")
    return places


def _add_place(places: dict[tuple[int, ...], Pose], cells: Mapping[str, str], where: str) -> None:
    named = [name for name in ("site", "drive", "pose") if name in cells]
    keys = parse_numbers([cells[name] for name in named], where)
    if not all(key.is_integer() and abs(key) < LARGEST_COUNT for key in keys):
        raise InputError(f"{where}: site, drive and pose must be whole numbers of up to 9 digits")
    north, east, up, yaw, pitch, roll = parse_numbers([cells[name] for name in COLUMNS[2:]], where)
    position = [north, east, -up]
    check_position(position, where)
    if max(map(abs, (yaw, pitch, roll))) > 720.0:
        raise InputError(f"{where}: yaw, pitch and roll are beyond 720 degrees")
    turn = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)
    pose = Pose(np.array(position), turn.as_quat(canonical=True))
    whole = tuple(int(key) for key in keys)
    places[whole] = places[whole[:2]] = pose


def _read_label(label: Path) -> Product:
    data = _open_product(label)
    shape = [_whole(data, key, label) for key in ("BANDS", "LINES", "LINE_SAMPLES")]
    if shape[0] != 3 or not 0 < shape[1] * shape[2] <= MOST_PIXELS:
        raise InputError(
            f"{label}: an XYZ product has 3 bands of up to {MOST_PIXELS:,} pixels, this one has "
            f"{shape[0]} bands of {shape[1]} x {shape[2]}"
        )
    if not _images(label):
        raise InputError(f"{label}: its image {label.stem}.IMG is not beside it")
    frame = str(_group(data, "DERIVED_IMAGE_PARMS", label).get("REFERENCE_COORD_SYSTEM_NAME"))
    if frame not in (*SITE, *ROVER):
        raise InputError(
            f"{label}: its points are in the frame {frame:.40}; {', '.join((*SITE, *ROVER))} are "
            "read"
        )
    present = (name for name in ROVER_GROUPS if data.metablock(name) is not None)
    group = next(present, ROVER_GROUPS[0])
    rover = _group(data, group, label)
    offset = _numbers(rover.get("ORIGIN_OFFSET_VECTOR"), 3, "ORIGIN_OFFSET_VECTOR", label)
    w, x, y, z = _numbers(
        rover.get("ORIGIN_ROTATION_QUATERNION"), 4, "ORIGIN_ROTATION_QUATERNION", label
    )
    counter = data.metaget("ROVER_MOTION_COUNTER")
    numbers = _numbers(
        tuple(counter)[:3] if isinstance(counter, list | tuple) else None,
        *(3, "ROVER_MOTION_COUNTER", label),
    )
    clock = re.sub(r"^\d+/", "", str(data.metaget("SPACECRAFT_CLOCK_START_COUNT")).strip('"'))
    where = f"{label}, SPACECRAFT_CLOCK_START_COUNT"
    missing = data.metaget("MISSING_CONSTANT")
    nothing = missing if isinstance(missing, list | tuple) else [missing] * 3
    return Product(
        label,
        parse_numbers([clock], where)[0],
        (int(numbers[0]), int(numbers[1]), int(numbers[2])),
        frame in SITE,
        make_pose([*offset, x, y, z, w], f"{label}, {group}"),
        tuple(float(number) for number in nothing if isinstance(number, int | float)),
    )


def _open_product(label: Path) -> Content:
    """Open a product by its label; every error of the library becomes an InputError."""
    for file in (label, *_images(label)):
        check_regular(file)
    if label.stat().st_size > LARGEST_LABEL:
        raise InputError(f"{label}: is larger than {LARGEST_LABEL:,} bytes, the most for a label")
    try:
        pdr = load_library("pdr", "gpgrad[pds]")
    except InputError as error:
        raise InputError(f"{label}: to read products of PDS, {error}") from None
    try:
        return pdr.read(str(label))
    except Cancelled:
        raise
    except Exception as error:  # pdr raises those of all its formats
        raise InputError(
            f"{label}: is not a product that pdr can read: {message_of(error):.200}"
        ) from None


def _group(data: Content, name: str, label: Path) -> Mapping[str, object]:
    block = data.metablock(name)
    if not isinstance(block, Mapping):
        raise InputError(f"{label}: has no group {name}")
    return block


def _whole(data: Content, key: str, label: Path) -> int:
    value = data.metaget(key)
    if not isinstance(value, int):
        raise InputError(f"{label}: has no whole number {key}")
    return value


def _numbers(values: object, count: int, key: str, label: Path) -> list[float]:
    if not isinstance(values, list | tuple) or len(values) != count:
        raise InputError(f"{label}: {key} must have {count} numbers")
    return parse_numbers([str(number) for number in values], f"{label}, {key}")


def _points(product: Product) -> Float[Array, "n 3"]:
    data = _open_product(product.label)
    try:
        bands = np.asarray(data["IMAGE"])
    except Cancelled:
        raise
    except Exception as error:  # a file that is cut short, above all
        raise InputError(
            f"{product.label}: its image cannot be read: {message_of(error):.200}"
        ) from None
    shape = tuple(_whole(data, key, product.label) for key in ("BANDS", "LINES", "LINE_SAMPLES"))
    if bands.shape != shape or bands.dtype.kind != "f":
        raise InputError(
            f"{product.label}: its image is cut short, or has no numbers of 32 or 64 bits: "
            f"{bands.dtype} of shape {bands.shape}, not {shape}"
        )
    pixels = bands.reshape(3, -1).T.astype(np.float64)
    shown = (pixels != 0.0).any(axis=1)
    if len(product.missing) == 3:
        shown &= (pixels != np.array(product.missing)).any(axis=1)
    points = pixels[shown]
    return product.rover.inverse().apply(points) if product.in_site else points
