"""Mutators of what holds files: zipped datasets; of images; of bags."""

import io
import random
import struct
import tempfile
import zipfile
import zlib
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tests.long.fuzz.mutation import Case, at_random, cut, flipped, surplus

NAMES = (
    "../000.npy", "/etc/000.npy", "a/../../000.npy", "..\\000.npy", "C:000.npy", "a\nb.npy",
    "\x1b[31m.npy",
    "a" * 300 + ".npy", "b/" * 2000 + "000.npy", "x" * 60_000 + ".npy", "é" * 150 + ".npy",
    "\x7f.npy",
)  # fmt: skip
"""Names of files that no file may be made of."""


def _array() -> bytes:
    file = io.BytesIO()
    np.save(file, np.random.default_rng(0).normal(size=(12, 3)))
    return file.getvalue()


def _zip(names: list[str], method: int = zipfile.ZIP_DEFLATED, attributes: int = 0) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name in names:
            member = zipfile.ZipInfo(name)
            member.filename = name  # ZipInfo itself would cut it at a zero byte
            member.external_attr = attributes
            archive.writestr(member, _array(), method)
    return file.getvalue()


@cache
def _bomb() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("000.xyz", bytes(9_000_000))
    return file.getvalue()


def archive(rng: random.Random) -> Case:
    names = ["hills/submaps/000.npy", "hills/submaps/001.npy"]
    whole = _zip(names)
    what = rng.choice(
        ("name", "link", "size", "cut", "directory", "bomb", "method", "random", "data")
    )
    match what:
        case "name":
            return Case(_zip([*names, rng.choice(NAMES)]), what, damaged=True)
        case "link":
            return Case(_zip(names, attributes=0o120777 << 16), what, damaged=True)
        case "size":
            data = bytearray(whole)
            true = struct.pack("<I", len(_array()))
            place = rng.choice([k for k in range(len(data)) if data[k : k + 4] == true])
            data[place : place + 4] = struct.pack("<I", rng.choice((0, 10, 2**31, 2**32 - 2)))
            # Of the two places that give the size, Python reads the one in the directory.
            return Case(bytes(data), what, damaged=place > data.index(b"PK\x01\x02"))
        case "bomb":
            return Case(_bomb(), what, damaged=True)
        case "directory":
            data, start = bytearray(whole), whole.index(b"PK\x01\x02")
            for _ in range(rng.choice((1, 2, 6))):
                data[rng.randrange(start, len(data))] = rng.choice((0, 255, 1, 127))
            return Case(bytes(data), what, damaged=False)
        case "data":
            data = bytearray(whole)
            data[rng.randint(60, 90)] ^= 1 << rng.randrange(8)
            return Case(bytes(data), what, damaged=True)
        case "method":
            data = bytearray(whole)
            place = data.index(b"PK\x01\x02") + 10
            data[place : place + 2] = struct.pack("<H", rng.choice((1, 6, 9, 12, 14, 99)))
            return Case(bytes(data), what, damaged=True)
        case "cut":
            return cut(rng, whole)
        case _:
            return at_random(rng, whole)


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def image(rng: random.Random) -> Case:
    """A PNG, or a JPEG."""
    if rng.random() < 0.2:
        jpeg = _jpeg()
        return (
            cut(rng, jpeg, 2)
            if rng.random() < 0.4
            else Case(flipped(rng, jpeg), "flip", damaged=False)
        )
    width, height, depth, color = 8, 6, 8, 0
    rows = b"".join(b"\0" + bytes(rng.randrange(256) for _ in range(width)) for _ in range(height))
    data = zlib.compress(rows)
    what = rng.choice(("size", "depth", "data", "cut", "surplus", "checksum", "chunk", "random"))
    if what == "size":
        width, height = rng.choice(
            ((0, 6), (2**31 - 1, 2**31 - 1), (100_000, 100_000), (8, 2**31), (8, 0))
        )
    if what == "depth":
        depth, color = rng.choice(((0, 0), (3, 0), (16, 3), (8, 5), (255, 255)))
    if what == "data":
        data = rng.choice(
            (b"", b"x", data[: rng.randrange(1, len(data))], zlib.compress(bytes(10_000_000)))
        )
    header = struct.pack(">IIBBBBB", width & 0xFFFFFFFF, height & 0xFFFFFFFF, depth, color, 0, 0, 0)
    whole = (
        b"\x89PNG\r\n\x1a\n"
        + _chunk(b"IHDR", header)
        + _chunk(b"IDAT", data)
        + _chunk(b"IEND", b"")
    )
    match what:
        case "cut":
            return cut(rng, whole)
        case "surplus":
            return surplus(rng, whole)
        case "checksum":
            place = rng.randrange(12, len(whole))
            spoilt = (
                whole[:place] + bytes([whole[place] ^ (1 << rng.randrange(8))]) + whole[place + 1 :]
            )
            return Case(spoilt, what, damaged=True)
        case "chunk":
            odd = _chunk(
                rng.choice((b"PLTE", b"tRNS", b"iCCP", b"zTXt", b"eXIf", b"acTL")), bytes(40)
            )
            return Case(whole[:33] + odd + whole[33:], what, damaged=False)
        case "random":
            return at_random(rng, whole)
    # How much of broken pixels is shown is the library's choice.
    return Case(whole, what, damaged=what == "size")


def grey(rng: random.Random) -> Case:
    """A grey PNG of 3 rows and 5 columns with 16 bits."""
    rows = [bytes([0]) + bytes(rng.randrange(256) for _ in range(10)) for _ in range(3)]
    size, form, data = (5, 3), (16, 0, 0, 0, 0), b"".join(rows)
    what = rng.choice(("size", "form", "data", "filter", "cut", "surplus", "checksum", "random"))
    match what:
        case "size":
            size = rng.choice(((3, 5), (0, 0), (2**31 - 1, 3), (5, 2**32 - 1)))
        case "form":
            form = rng.choice(
                ((8, 0, 0, 0, 0), (16, 2, 0, 0, 0), (16, 0, 0, 0, 1), (1, 0, 9, 9, 0))
            )
        case "data":
            data = rng.choice((b"", data[:-1], data + b"\0", bytes(10_000_000)))
        case "filter":
            data = data[:11] + bytes([rng.randrange(5, 256)]) + data[12:]
    whole = (
        b"\x89PNG\r\n\x1a\n"
        + _chunk(b"IHDR", struct.pack(">IIBBBBB", *size, *form))
        + _chunk(b"IDAT", zlib.compress(data))
        + _chunk(b"IEND", b"")
    )
    match what:
        case "cut":
            return cut(rng, whole)
        case "surplus":
            return surplus(rng, whole)
        case "checksum":
            place = rng.randrange(12, len(whole))
            return Case(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :], what, True)
        case "random":
            return at_random(rng, whole)
    return Case(whole, what, damaged=True)


@cache
def _jpeg() -> bytes:
    import cv2  # noqa: PLC0415 (only where images are fuzzed)

    done, data = cv2.imencode(".jpg", np.random.default_rng(0).integers(0, 255, (16, 16), np.uint8))
    assert done
    return data.tobytes()


@cache
def _bags() -> tuple[tuple[str, bytes], ...]:
    """A bag of each kind, by its ending."""
    from tests.support.bags import write_bag  # noqa: PLC0415 (needs the extra 'ros')
    from tests.support.drive import make_drive  # noqa: PLC0415

    few = make_drive(num_scans=3, points_a_scan=10)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_bag(folder / "a.bag", few, ros1=True, poses="odometry")
        write_bag(folder / "b", few, ros1=False, poses="odometry", storage="mcap")
        write_bag(folder / "c", few, ros1=False, poses="stamped", storage="sqlite3")
        files = (folder / "a.bag", *folder.glob("*/*.mcap"), *folder.glob("*/*.db3"))
        return tuple((file.suffix, file.read_bytes()) for file in files)


def bag(rng: random.Random) -> Case:
    ending, whole = rng.choice(_bags())
    if rng.random() < 0.3:
        return replace(cut(rng, whole, len(whole) // 20), ending=ending)
    return replace(at_random(rng, whole), ending=ending)


def geotiff_of(keys: tuple[int, ...], **how: Any) -> bytes:
    """Make an elevation model of 12 x 9 cells of 2 m."""
    import tifffile  # noqa: PLC0415 (only where elevation models are fuzzed)

    heights = np.random.default_rng(0).normal(size=(12, 9)).astype(np.float32)
    tags = [
        (33550, "d", 3, (2.0, 2.0, 0.0), True),
        (33922, "d", 6, (0.0, 0.0, 0.0, 500_000.0, 5_000_000.0, 0.0), True),
        (34735, "H", len(keys), keys, True),
        (42113, "s", 0, "-9999", True),
    ]
    file = io.BytesIO()
    tifffile.imwrite(file, how.pop("heights", heights), extratags=tags, metadata=None, **how)
    return file.getvalue()


METRES = (1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 32633)
"""Directory of keys: a projected system, EPSG:32633."""


def _places_of_tags(whole: bytes | bytearray) -> list[int]:
    (start,) = struct.unpack_from("<I", whole, 4)
    (number,) = struct.unpack_from("<H", whole, start)
    return [start + 2 + 12 * k for k in range(number)]


def with_tag(whole: bytes, code: int, **changed: int) -> bytes:
    """Change a tag of a TIFF: its kind, its count or its value."""
    data = bytearray(whole)
    for place in _places_of_tags(data):
        named, *parts = struct.unpack_from("<HHII", data, place)
        if named == code:
            entry = dict(zip(("kind", "count", "value"), parts, strict=True)) | changed
            struct.pack_into("<HHII", data, place, code, *entry.values())
    return bytes(data)


def _with_odd_tag(rng: random.Random, whole: bytes) -> bytes:
    """Change the type, the number or the values of a tag, or its code to another one's."""
    data = bytearray(whole)
    places = _places_of_tags(whole)
    place = rng.choice(places)
    code, kind, count, value = struct.unpack_from("<HHII", data, place)
    match rng.choice(("kind", "count", "value", "values", "code", "code")):
        case "kind":
            kind = rng.choice((*range(1, 19), 99))
        case "count":
            count = rng.choice((0, 1, 2, 3, 5, 7, 1000, 2**31, 2**32 - 1))
        case "value":
            value = rng.choice((0, 1, 7, 8, value + 1, value ^ (1 << rng.randrange(32)), 2**32 - 1))
        case "values" if 8 <= value < len(data) - 8:  # where the values lie
            data[value : value + 8] = struct.pack(
                "<d", rng.choice((0.0, -1.0, float("nan"), float("inf"), 1e300, 5e-324))
            )
        case _:
            (code,) = struct.unpack_from("<H", data, rng.choice(places))
    struct.pack_into("<HHII", data, place, code, kind, count, value % 2**32)
    return bytes(data)


def geotiff_bomb() -> bytes:
    """Make an elevation model whose strip unpacks to 16 MB."""
    whole, bomb = geotiff_of(METRES, compression="zlib"), zlib.compress(bytes(1 << 24))
    return with_tag(with_tag(whole, 273, value=len(whole)), 279, value=len(bomb)) + bomb


def geotiff(rng: random.Random) -> Case:
    what = rng.choice(("degrees", "feet", "words", "cut", "tag", "tag", "tag", "random", "random"))
    match what:
        case "degrees":
            return Case(geotiff_of((1, 1, 0, 1, 1024, 0, 1, 2)), what, damaged=True)
        case "feet":
            return Case(geotiff_of((*METRES[:3], 3, *METRES[4:], 3076, 0, 1, 9002)), what, True)
        case "words":
            return Case(geotiff_of(METRES, heights=np.zeros((12, 9), np.complex64)), what, True)
    tiles = {"compression": "zlib", "tile": (16, 16)}
    written = ({}, {"compression": "zlib"}, {"tile": (16, 16)}, {"rowsperstrip": 5}, tiles)
    whole = geotiff_of(METRES, **rng.choice(written))
    if what == "tag":
        return Case(_with_odd_tag(rng, whole), what, damaged=False)
    # Without its last cells the file is cut short; the order of its parts is the writer's.
    return cut(rng, whole) if what == "cut" else at_random(rng, whole)
