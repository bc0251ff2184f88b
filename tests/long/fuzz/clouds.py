"""Mutators of the cloud formats."""

import io
import random
import struct
import zipfile
from functools import cache

import numpy as np

from tests.long.fuzz.mutation import (
    NUM_POINTS,
    Case,
    Mutator,
    at_random,
    cut,
    flipped,
    points,
    surplus,
    wrong_count,
)

ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


def _table(rng: random.Random, kind: str = "f4") -> np.ndarray:
    return np.array(points(rng)).astype(kind)


def _text_rows(rng: random.Random, separator: str = " ") -> list[str]:
    return [separator.join(f"{value:.3f}" for value in row) for row in points(rng)]


def _bad_row(rng: random.Random, rows: list[str]) -> str:
    """Spoil one row so that no reader may take it; say how."""
    place = rng.randrange(len(rows))
    what = rng.choice(("word", "short", "long", "comma", "far", "joined"))
    x, y, z = rows[place].split()
    rows[place] = {
        "word": f"{x} {rng.choice(('up', '1_000', '0x1f', '１２', '--1', '1e', '.', '(1)'))} {z}",
        "short": f"{x} {y}",
        "long": f"{x} {y} {z} {z}",
        "comma": f"{x} {y} {z}".replace(".", ","),
        "far": f"{x} {rng.choice(('1e30', '-2e9', '1e300'))} {z}",
        "joined": f"{x}{y}{z}",
    }[what]
    return what


def ply(rng: random.Random) -> Case:
    layout = rng.choice(tuple(ORDERS))
    kind, word = rng.choice((("f4", "float"), ("f8", "double")))
    table = _table(rng, kind)
    header = [
        "ply", f"format {layout} 1.0", "comment made by hand", f"element vertex {NUM_POINTS}",
        *(f"property {word} {name}" for name in "xyz"),
    ]  # fmt: skip
    body = table.astype(ORDERS[layout] + kind).tobytes()
    faces = b""
    if rng.random() < 0.3:
        header += ["element face 4", "property list uchar int vertex_indices"]
        faces = b"".join(struct.pack(ORDERS[layout] + "B3i", 3, 0, 1, 2) for _ in range(4))
    rows = [" ".join(map(repr, row)) for row in table.astype(np.float64).tolist()]
    face_rows = ["3 0 1 2"] * 4 if faces else []
    # Of a text, the end of the last row may be missing without anyone being able to tell.
    least = len([*rows, *face_rows][-1]) + 1 if layout == "ascii" else 1

    def written(what: str, *, damaged: bool) -> Case:
        text = "\n".join([*header, "end_header", ""]).encode()
        if layout == "ascii":
            return Case(text + "\n".join([*rows, *face_rows, ""]).encode(), what, damaged)
        return Case(text + body + faces, what, damaged)

    if layout == "ascii" and rng.random() < 0.3:
        return written("row: " + _bad_row(rng, rows), damaged=True)
    what = rng.choice(
        ("count", "cut", "surplus", "type", "line", "twice", "order", "long element", "far",
         "random", "random", "faces")
    )  # fmt: skip
    match what:
        case "count":
            header[3] = f"element vertex {wrong_count(rng, NUM_POINTS)}"
            return written(what, damaged=True)
        case "cut":
            return cut(rng, written(what, damaged=True).content, least)
        case "surplus" if layout == "ascii":
            rows.insert(rng.randrange(len(rows)), rows[0])
            return written(what, damaged=True)
        case "surplus":
            return surplus(rng, written(what, damaged=True).content)
        case "type":
            place = rng.choice((4, 5, 6))
            name = header[place].split()[2]
            other = rng.choice(("char", "ushort", "int", "double", "float", "list uchar float"))
            header[place] = f"property {other} {name}"
            # In text, a float is as good as a double.
            return written(what, damaged=layout != "ascii" and other != word)
        case "line":
            del header[rng.choice((0, 1, 3, 4, 5, 6))]
            return written(what, damaged=True)
        case "twice":
            header.insert(rng.choice((2, 4, 7)), rng.choice((header[3], header[4], header[1])))
            return written(what, damaged=True)
        case "order":
            header[1] = rng.choice(
                ("format binary 1.0", "format", "format ASCII 1.0", "format x y")
            )
            return written(what, damaged=True)
        case "long element":
            count = wrong_count(rng, 0)
            header[3:3] = [f"element other {count}", "property double a"]
            if rng.random() < 0.5:
                header[5] = "element vertex 0"
            return written(what, damaged=count != "0")
        case "far":
            table[rng.randrange(NUM_POINTS), rng.randrange(3)] = rng.choice((1e30, -3e9))
            body = table.astype(ORDERS[layout] + kind).tobytes()
            rows[:] = [" ".join(map(repr, row)) for row in table.astype(np.float64).tolist()]
            return written(what, damaged=True)
        case "faces" if faces:
            header[-2] = f"element face {wrong_count(rng, 4)}"
            return written(what, damaged=True)
        case _:
            return at_random(rng, written(what, damaged=False).content)


def literal_lzf(data: bytes) -> bytes:
    """Compress by LZF's rules, without finding anything that repeats."""
    runs = [data[k : k + 32] for k in range(0, len(data), 32)]
    return b"".join(bytes([len(run) - 1]) + run for run in runs)


def pcd(rng: random.Random) -> Case:
    layout = rng.choice(("ascii", "binary", "binary_compressed"))
    kind, size = rng.choice((("f4", 4), ("f8", 8)))
    table = _table(rng, kind)
    header = {
        "VERSION": "0.7", "FIELDS": "x y z", "SIZE": f"{size} {size} {size}", "TYPE": "F F F",
        "COUNT": "1 1 1", "WIDTH": "6", "HEIGHT": "2", "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": str(NUM_POINTS), "DATA": layout,
    }  # fmt: skip
    rows = [" ".join(map(repr, row)) for row in table.astype(np.float64).tolist()]
    plain = np.ascontiguousarray(table.T).tobytes()
    packed = literal_lzf(plain)
    least = len(rows[-1]) + 1 if layout == "ascii" else 1
    sizes = [len(packed), len(plain)]

    def written(what: str, *, damaged: bool) -> Case:
        text = "".join(f"{key} {value}\n" for key, value in header.items()).encode()
        bodies = {
            "ascii": "\n".join([*rows, ""]).encode(),
            "binary": table.tobytes(),
            "binary_compressed": struct.pack("<II", *sizes) + packed,
        }
        return Case(text + bodies[layout], what, damaged)

    if layout == "ascii" and rng.random() < 0.3:
        return written("row: " + _bad_row(rng, rows), damaged=True)
    what = rng.choice(
        ("POINTS", "WIDTH", "HEIGHT", "COUNT", "SIZE", "TYPE", "FIELDS", "gone", "cut", "surplus",
         "far", "block", "stream", "random", "random", "both")
    )  # fmt: skip
    match what:
        case "POINTS" | "WIDTH" | "HEIGHT":
            header[what] = wrong_count(rng, int(header[what]))
            return written(what, damaged=True)
        case "both":
            header["POINTS"] = wrong_count(rng, NUM_POINTS)
            header["WIDTH"], header["HEIGHT"] = header["POINTS"], "1"
            return written(what, damaged=True)
        case "COUNT" | "SIZE":
            words = header[what].split()
            words[rng.randrange(3)] = wrong_count(rng, int(words[0]))
            header[what] = " ".join(words)
            # In text, any size of a number reads the same.
            return written(what, damaged=what == "COUNT" or layout != "ascii")
        case "TYPE":
            header[what] = rng.choice(("F F", "F F F F", "F X F", "F F " + "f" * 99))
            return written(what, damaged=True)
        case "FIELDS":
            header[what] = rng.choice(
                ("x y", "x y y", "a b c", "x y z z", "x x z", "", "x y z" * 99)
            )
            return written(what, damaged=True)
        case "gone":
            del header[rng.choice(("FIELDS", "SIZE", "TYPE", "POINTS", "DATA"))]
            return written(what, damaged=True)
        case "cut":
            return cut(rng, written(what, damaged=True).content, least)
        case "surplus" if layout == "ascii":
            rows.append(rows[0])
            return written(what, damaged=True)
        case "surplus":
            return surplus(rng, written(what, damaged=True).content)
        case "far" if layout != "binary_compressed":
            table[3, rng.randrange(3)] = rng.choice((1e30, -3e9))
            rows[:] = [" ".join(map(repr, row)) for row in table.astype(np.float64).tolist()]
            return written(what, damaged=True)
        case "block" if layout == "binary_compressed":
            place = rng.randrange(2)
            sizes[place] = rng.choice([s for s in (0, 1, 7, 2**31, 2**32 - 1) if s != sizes[place]])
            return written(what, damaged=True)
        case "stream" if layout == "binary_compressed":
            packed = flipped(rng, packed)
            sizes[0] = len(packed)
            return written(what, damaged=False)
        case _:
            return at_random(rng, written(what, damaged=False).content)


FIELDS_OF_LAS = {
    24: "B", 25: "B", 94: "H", 96: "I", 100: "I", 104: "B", 105: "H", 107: "I", 111: "I",
    131: "d", 139: "d", 147: "d", 155: "d", 163: "d", 171: "d", 179: "d", 187: "d", 195: "d",
}  # fmt: skip
"""Places and types of the header's numbers."""


@cache
def las_file(seed: int, *, compressed: bool, version: str) -> bytes:
    import laspy  # noqa: PLC0415 (only where LAS is fuzzed)

    rng = random.Random(seed)
    header = laspy.LasHeader(point_format=6 if version == "1.4" else 3, version=version)
    header.scales, header.offsets = np.full(3, 1e-3), np.zeros(3)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = _table(rng, "f8").T
    cloud.return_number = np.ones(NUM_POINTS, np.uint8)
    file = io.BytesIO()
    cloud.write(file, do_compress=compressed)
    return file.getvalue()


def _las_case(rng: random.Random, *, compressed: bool) -> Case:
    version = rng.choice(("1.2", "1.4"))
    content = las_file(rng.randrange(5), compressed=compressed, version=version)
    count = struct.Struct("<Q" if version == "1.4" else "<I"), 247 if version == "1.4" else 107
    what = rng.choice(("count", "cut", "surplus", "field", "scale", "random", "random"))
    data = bytearray(content)
    match what:
        case "count":
            most = 2 ** (8 * count[0].size) - 1
            wrong = rng.choice((1, 11, 13, 400, 50_001, 10**9, most))
            count[0].pack_into(data, count[1], wrong)
            return Case(bytes(data), what, damaged=True)
        case "cut":
            return cut(rng, content)
        case "surplus":
            # After compressed points, a writer may put what it likes.
            return Case(surplus(rng, content).content, what, damaged=not compressed)
        case "scale":
            place, value = rng.choice((131, 139, 147)), rng.choice((0.0, -1.0, 1e30, float("nan")))
            struct.pack_into("<d", data, place, value)
            return Case(bytes(data), what, damaged=True)
        case "field":
            place, kind = rng.choice(tuple(FIELDS_OF_LAS.items()))
            if kind == "d":
                value: float = rng.choice((0.0, 1e300, float("nan"), float("inf"), -1.0, 1e-300))
            else:
                size = struct.calcsize("<" + kind)
                value = rng.choice((0, 1, rng.getrandbits(8 * size), 2 ** (8 * size) - 1))
            struct.pack_into("<" + kind, data, place, value)
            return Case(bytes(data), f"field {place}", damaged=False)
        case _:
            return at_random(rng, content)


def las(rng: random.Random) -> Case:
    return _las_case(rng, compressed=False)


def laz(rng: random.Random) -> Case:
    return _las_case(rng, compressed=True)


def npy_bytes(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def npy_with(header: str, body: bytes, version: int = 1) -> bytes:
    text = header.encode("latin-1", "replace") + b"\n"
    return b"\x93NUMPY" + struct.pack("<BBH", version, 0, len(text) & 0xFFFF) + text + body


HEADER = "{{'descr': {}, 'fortran_order': {}, 'shape': {}, }}"


def npy(rng: random.Random) -> Case:
    body = _table(rng, "f8").tobytes()
    shape = f"({NUM_POINTS}, 3)"
    what = rng.choice(
        ("shape", "type", "order", "header", "version", "cut", "surplus", "far", "random")
    )
    match what:
        case "shape":
            odd = ("()", "(3,)", f"({NUM_POINTS - 1}, 3)", f"(3, {NUM_POINTS})", "(-1, 3)",
            "(12.0, 3)",
                   f"({'9' * 5000}, 3)", f"({wrong_count(rng, NUM_POINTS)}, 3)", "(12, 3", "12, 3",
                   f"({'1, ' * 99})", "(12L, 3)", "(0, 3)")  # fmt: skip
            return Case(npy_with(HEADER.format("'<f8'", False, rng.choice(odd)), body), what, True)
        case "type":
            odd = ("'<f4'", "'|O'", "'O'", "'<U6'", "'<c16'", "'<f3'", "'x'", "f8", "'<M8[s]'",
            "''",
                   "[('x', '<f8')]", "'<f8,<f8'", "'V24'", "'|b1'",
                   "'" + "f" * 3000 + "'")  # fmt: skip
            return Case(npy_with(HEADER.format(rng.choice(odd), False, shape), body), what, True)
        case "order":
            odd = ("true", "0", "None", "'C'", "[]")
            return Case(npy_with(HEADER.format("'<f8'", rng.choice(odd), shape), body), what, True)
        case "header":
            text = HEADER.format("'<f8'", False, shape)
            broken = rng.choice(
                (text[: rng.randrange(len(text))], "(" * rng.randint(1, 60_000), "{", "{}",
                "[]" * 99,
                 text + "}", text.replace("shape", "form"), "{'a': __import__('os').abort()}",
                 text.replace(", }", ", 'x': 1}"), text.replace("{", "{'shape': (1, 3), "))
            )  # fmt: skip
            return Case(npy_with(broken, body), what, damaged=True)
        case "version":
            version = rng.choice((0, 2, 3, 4, 255))
            return Case(npy_with(HEADER.format("'<f8'", False, shape), body, version), what, True)
        case "cut" | "surplus":
            return (cut if what == "cut" else surplus)(rng, npy_bytes(_table(rng, "f8")))
        case "far":
            array = _table(rng, "f8")
            array[2, 1] = rng.choice((1e30, -2e9, 1e300))
            return Case(npy_bytes(array), what, damaged=True)
        case _:
            return at_random(rng, npy_bytes(_table(rng, "f8")))


def npz(rng: random.Random) -> Case:
    arrays = {"points.npy": npy_bytes(_table(rng, "f8"))}
    method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    what = rng.choice(
        ("noise", "inner", "twice", "zeros", "data", "directory", "cut", "random", "method")
    )

    def packed() -> bytearray:
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w", method) as archive:
            for name, content in arrays.items():
                archive.writestr(name, content)
        return bytearray(file.getvalue())

    match what:
        case "noise":
            odd = (np.array(["a"] * NUM_POINTS), np.full(NUM_POINTS - 1, 0.1),
            np.full((NUM_POINTS, 2), 0.1),
                   np.full(NUM_POINTS, -1.0), np.full(NUM_POINTS, 1e300), np.zeros(NUM_POINTS),
                   np.full(NUM_POINTS, np.nan), np.array(0.1), np.full(NUM_POINTS, 1j))  # fmt: skip
            name = rng.choice(("noise_std", "range"))
            # A range may be zero.
            allowed = [one for one in odd if name != "range" or one.dtype.kind != "f" or one.any()]
            arrays[f"{name}.npy"] = npy_bytes(rng.choice(allowed))
            return Case(bytes(packed()), what, damaged=True)
        case "inner":
            inner = npy(rng)
            return Case(zipped({"points.npy": inner.content}, method), what, inner.damaged)
        case "twice":
            data = packed()
            return Case(data.replace(b"points.npy", b"points.np") + b"x", what, damaged=False)
        case "zeros":
            return Case(_zipped_zeros(), what, damaged=True)
        case "data":
            data = packed()
            # The last byte of a compressed stream may hold bits that mean nothing.
            place = rng.randint(30 + len("points.npy"), data.index(b"PK\x01\x02") - 3)
            data[place] ^= 1 << rng.randrange(8)
            return Case(bytes(data), what, damaged=True)  # the checksum tells
        case "directory":
            data = packed()
            start = data.index(b"PK\x01\x02")
            place = rng.randrange(start, len(data))
            data[place] = rng.choice((0, 1, 127, 255, rng.randrange(256)))
            return Case(bytes(data), what, damaged=False)
        case "method":
            data = packed()
            wrong = struct.pack("<H", rng.choice((1, 6, 9, 12, 14, 99, 65_535)))
            start = data.index(b"PK\x01\x02")
            data[8:10], data[start + 10 : start + 12] = wrong, wrong
            return Case(bytes(data), what, damaged=True)
        case "cut":
            return cut(rng, bytes(packed()))
        case _:
            return at_random(rng, bytes(packed()))


@cache
def _zipped_zeros() -> bytes:
    zeros = npy_bytes(np.zeros((700_000, 3)))
    return zipped({"points.npy": zeros}, zipfile.ZIP_DEFLATED)


def zipped(files: dict[str, bytes], method: int) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return file.getvalue()


def table(rng: random.Random) -> Case:
    separator = rng.choice((" ", ",", ";", "\t"))
    header = rng.random() < 0.5
    rows = _text_rows(rng)
    what = rng.choice(("row", "row", "commas", "header", "bytes", "random", "random"))
    match what:
        case "row":
            what = _bad_row(rng, rows)
            if what == "comma" and separator == ",":
                what = "more columns"  # which is what decimal commas are here
        case "commas":
            number = rng.choice((2, 3))
            rows = [",".join(row.replace(".", ",").split()[:number]) for row in rows]
            text = "\n".join((["x,y,z"] if header else []) + rows)
            return Case(text.encode(), what, damaged=True)
        case "header":
            odd = ("x y", "lon lat height", "x y z w", "x,y;z", "x x z", "\0")
            first = rng.choice(odd).replace(" ", separator)
            rows = [first, *(row.replace(" ", separator) for row in rows)]
            return Case("\n".join(rows).encode(), what, damaged=True)
    text = "\n".join((["x y z"] if header else []) + rows).replace(" ", separator)
    if what == "bytes":
        odd_bytes = rng.choice((b"\0", b"\xff\xfe", b"\x80", b"PK\x03\x04", b"\xed\xa0\x80"))
        place = rng.randrange(len(text))
        return Case(text[:place].encode() + odd_bytes + text[place:].encode(), what, damaged=True)
    if what == "random":
        return at_random(rng, text.encode())
    return Case(text.encode(), what, damaged=True)


def kitti(rng: random.Random) -> Case:
    body = np.column_stack([_table(rng), np.zeros(NUM_POINTS, "f4")]).astype("<f4").tobytes()
    what = rng.choice(("cut", "surplus", "far", "random"))
    if what in ("cut", "surplus"):
        size = rng.choice([k for k in range(1, 40) if k % 16])
        return Case(body[:-size] if what == "cut" else body + bytes(size), what, damaged=True)
    if what == "far":
        return Case(struct.pack("<4f", 1e30, 0, 0, 0) + body[16:], what, damaged=True)
    return at_random(rng, body)


MUTATORS: dict[str, Mutator] = {
    ".bin": kitti,
    ".csv": table,
    ".las": las,
    ".laz": laz,
    ".npy": npy,
    ".npz": npz,
    ".pcd": pcd,
    ".ply": ply,
    ".xyz": table,
}
"""By the ending of the files. Of other formats an example is damaged anywhere."""
