"""Small files that each once failed: with a foreign exception, an abort, a stall, or in silence."""

import io
import json
import struct
import zipfile
from dataclasses import dataclass

import msgspec
import numpy as np

from gpgrad_core.live.frames import Hello, frame_of
from tests.long.fuzz.clouds import HEADER, las_file, literal_lzf, npy_bytes, npy_with, zipped
from tests.long.fuzz.live import entries_of_record, record_of
from tests.long.fuzz.packed import METRES, geotiff_bomb, geotiff_of, with_tag
from tests.long.fuzz.texts import PAIR, REPORT, UPPER


@dataclass(frozen=True)
class Failure:
    """A file that must be refused.

    Attributes:
        format: Which of `FORMATS` reads it.
        content: The file.
        said: What the message says.
    """

    format: str
    content: bytes
    said: str


ROWS = np.random.default_rng(0).normal(size=(4, 3)).astype("<f4")
TEXT = "0 0 0\n1 0 0\n0 1 0\n1 1 1\n"
PLY = (
    "ply\nformat {}\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    "end_header\n"
)
PCD = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT {}\nWIDTH {}\nHEIGHT 1\nPOINTS {}\nDATA {}\n"
LITTLE, ASCII = "binary_little_endian 1.0", "ascii 1.0"


def _ply(layout: str, count: object, body: bytes) -> Failure:
    said = "is cut short" if str(count) == "9" * 15 else "holds more than its header says"
    if len(str(count)) > 18:
        said = "is not a line of a PLY header"
    return Failure("ply", PLY.format(layout, count).encode() + body, said)


def _pcd(
    said: str, body: bytes, layout: str, count: object = "1 1 1", width: object = 4
) -> Failure:
    return Failure("pcd", PCD.format(count, width, 4, layout).encode() + body, said)


def _pcd_points(said: str, points: str, body: bytes, layout: str) -> Failure:
    return Failure("pcd", PCD.format("1 1 1", points, points, layout).encode() + body, said)


def _pair(said: str, **changed: object) -> Failure:
    report = REPORT | {"pairs": [PAIR | changed]}
    return Failure("closures", json.dumps(report).encode(), said)


def _las_with(*, compressed: bool, place: int, kind: str, value: int) -> bytes:
    data = bytearray(las_file(0, compressed=compressed, version="1.2"))
    struct.pack_into(kind, data, place, value)
    return bytes(data)


def _zip_of_version(version: int) -> bytes:
    data = bytearray(zipped({"points.npy": npy_bytes(ROWS)}, zipfile.ZIP_STORED))
    start = data.index(b"PK\x01\x02")
    data[4:6] = data[start + 6 : start + 8] = struct.pack("<H", version)
    return bytes(data)


def _zip_that_begins_too_early() -> bytes:
    data = bytearray(zipped({"points.npy": npy_bytes(ROWS)}, zipfile.ZIP_STORED))
    end = data.index(b"PK\x05\x06")
    data[end + 16 : end + 20] = struct.pack("<I", 2**31)  # where the directory would be
    return bytes(data)


def _npz(**extra: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez(file, points=ROWS, **extra)
    return file.getvalue()


def _zeros(number: int) -> bytes:
    """A compressed PCD of zeros: 264 bytes of them out of three."""
    size = 12 * number
    packed = b"\x00\x00" + b"\xe0\xff\x00" * ((size - 1) // 264 + 1)
    header = PCD.format("1 1 1", number, number, "binary_compressed").encode()
    return header + struct.pack("<II", len(packed), size) + packed


def _named(name: str) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("000.npy", npy_bytes(ROWS))
        archive.writestr(name, npy_bytes(ROWS))
    return file.getvalue()


def _run(said: str, entry: int = 1, **changed: object) -> Failure:
    entries = entries_of_record()
    entries[entry] |= changed
    return Failure("run", record_of(map(msgspec.msgpack.encode, entries)), said)


def _tag(said: str, code: int, **changed: int) -> Failure:
    return Failure("tif", with_tag(geotiff_of(METRES), code, **changed), said)


PLACES = (
    "frame,site,drive,northing,easting,elevation,yaw,pitch,roll\n"
    f"ROVER,1,{'9' * 25},5000,-300,12,30,1,-2\n"
)

CORPUS: dict[str, Failure] = {
    # TOML that froze the server, and numbers and brackets that no parser survives.
    "toml_of_49000_dots": Failure("session", b"a." * 49_000 + b"a = 1", "more than 20 parts"),
    "toml_parameters_of_49000_dots": Failure("params", b"[" + b"a." * 49_000 + b"a]", "20 parts"),
    "toml_of_5000_brackets": Failure("params", b"x = " + b"[" * 5000, "nested more than 20 deep"),
    "toml_dataset_of_5000_brackets": Failure("about", b"x = " + b"[" * 5000, "nested more than 20"),
    "toml_number_of_5000_digits": Failure("params", b"[map]\nx = " + b"9" * 5000, "5,000 digits"),
    "toml_of_a_megabyte": Failure("params", b"#" * 1_000_001, "larger than 1,000,000 bytes"),
    "session_path_with_a_zero_byte": Failure("session", b'dataset = "a\\u0000"', "zero byte"),
    # LAS and LAZ.
    "las_cut_short": Failure(
        "las", las_file(0, compressed=False, version="1.2")[:-60], "is cut short"
    ),
    "las_of_fewer_points_than_it_holds": Failure(
        "las", _las_with(compressed=False, place=107, kind="<I", value=9), "more returns than"
    ),
    "laz_of_a_billion_points": Failure(
        "laz", _las_with(compressed=True, place=107, kind="<I", value=10**9), "cannot be the"
    ),
    "laz_of_a_million_points": Failure(
        "laz", _las_with(compressed=True, place=107, kind="<I", value=400_000), "not a complete LAS"
    ),
    # Compressed PCD that grows.
    "pcd_of_compressed_zeros": Failure("pcd", _zeros(2_000_000), "would unpack to 24,000,000"),
    # closures.json.
    "closures_of_nothing": Failure("closures", b"{}", "'dataset' is missing"),
    "closures_inliers_below_zero": _pair("'num_inliers' must be a whole", num_inliers=-1),
    "closures_inliers_as_text": _pair("'num_inliers' must be a whole", num_inliers="9"),
    "closures_inliers_of_a_trillion": _pair("'num_inliers' must be a whole", num_inliers=10**12),
    "closures_text_in_the_motion": _pair(
        "'x' must be a finite number", T_database_query={"x": "1", "y": 0, "yaw": 0}
    ),
    "closures_nan_in_the_motion": _pair(
        "NaN, which is not JSON", T_database_query={"x": float("nan"), "y": 0, "yaw": 0}
    ),
    "closures_nan_score": _pair("NaN, which is not JSON", score=float("nan")),
    "closures_infinite_score": Failure(
        "closures",
        json.dumps(REPORT).replace('"score": 0.5', '"score": 1e999').encode(),
        "'score' must be a finite number",
    ),
    "closures_ragged_covariance": _pair("three rows", covariance=[[1, 0, 0], [0, 1], [0, 0, 1]]),
    "closures_accepted_as_text": _pair("'accepted' must be true or false", accepted="false"),
    "closures_nested": Failure("closures", b"[" * 100_000, "nested more than 32 deep"),
    "closures_number_of_5000_digits": Failure(
        "closures", b'{"seed": ' + b"9" * 5000 + b"}", "5,000 digits"
    ),
    "closures_a_key_twice": Failure("closures", b'{"seed": 1, "seed": 2}', "'seed' twice"),
    # Foreign exceptions.
    "npy_header_cut": Failure("npy", npy_with("{'descr': '<f8', 'sha", b""), "does not give"),
    "npy_header_of_brackets": Failure("npy", npy_with("(" * 9000, b""), "does not give"),
    "npy_shape_of_5000_digits": Failure(
        "npy", npy_with(HEADER.format("'<f8'", False, f"({'9' * 5000}, 3)"), b""), "does not give"
    ),
    "npy_shape_of_18_digits": Failure(
        "npy", npy_with(HEADER.format("'<f8'", False, f"({'9' * 18}, 3)"), b""), "but 0 follow"
    ),
    "npy_of_python_objects": Failure(
        "npy", npy_with(HEADER.format("'|O'", False, "(4, 3)"), b"x"), "never loaded"
    ),
    "zip_of_an_unknown_version": Failure("npz", _zip_of_version(99), "is not a complete NPZ file"),
    "zip_that_begins_too_early": Failure("npz", _zip_that_begins_too_early(), "not a complete NPZ"),
    "noise_as_text": Failure("npz", _npz(noise_std=np.array(list("abcd"))), "must be numbers"),
    "noise_of_another_length": Failure("npz", _npz(noise_std=np.full(3, 0.1)), "has 3 rows"),
    "noise_of_two_dimensions": Failure("npz", _npz(noise_std=np.full((4, 1), 0.1)), "shape (n,)"),
    "ply_count_of_5000_digits": _ply(LITTLE, "9" * 5000, ROWS.tobytes()),
    "ply_long_element_before_no_vertex": Failure(
        "ply",
        PLY.format(LITTLE, 0).replace(
            "element vertex", "element other 99999\nproperty double a\nelement vertex"
        ).encode(),
        "is cut short",
    ),
    "ply_ascii_of_too_many_rows": _ply(ASCII, "9" * 15, TEXT.encode()),
    "pcd_count_of_zero": _pcd("FIELDS have no y", ROWS.tobytes(), "binary", "1 0 1"),
    "pcd_count_of_99999999999": _pcd(
        "each COUNT must", ROWS.tobytes(), "binary", "1 99999999999 1"
    ),
    "pcd_count_of_5000_digits": _pcd("not a whole", ROWS.tobytes(), "binary", f"1 {'9' * 5000} 1"),
    "pcd_ascii_of_too_many_rows": _pcd_points("is cut short", "9" * 15, TEXT.encode(), "ascii"),
    "g2o_that_is_not_text": Failure("g2o", b"VERTEX_SE3:QUAT 0 \xff", "is not text in UTF-8"),
    "g2o_of_a_huge_information": Failure(
        "g2o",
        b"VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 1\n"
        + " ".join(["EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1", *UPPER]).encode()[:-1]
        + b"1e300",
        "is above 1e+18",
    ),
    "upload_name_of_300_characters": Failure("zip", _named("a" * 300 + ".npy"), "longer than 200"),
    "upload_name_of_2000_levels": Failure("zip", _named("a/" * 2000 + "0.npy"), "folders deep"),
    "upload_name_with_a_line_end": Failure("zip", _named("a\nb.npy"), "control character"),
    # Silent acceptance.
    "ply_more_rows_than_its_count": _ply(LITTLE, 3, ROWS.tobytes()),
    "ply_ascii_more_rows_than_its_count": _ply(ASCII, 3, TEXT.encode()),
    "pcd_more_rows_than_its_count": _pcd_points("more than its", "3", ROWS.tobytes(), "binary"),
    "pcd_ascii_more_rows_than_its_count": _pcd_points("more than", "3", TEXT.encode(), "ascii"),
    "pcd_compressed_more_than_its_count": _pcd(
        "more than its header says",
        struct.pack("<II", 50, 48) + literal_lzf(ROWS.tobytes()) + b"x",
        "binary_compressed",
    ),
    "pcd_points_unlike_width_times_height": _pcd(
        "are not POINTS", ROWS.tobytes(), "binary", width=5
    ),
    "npy_of_a_smaller_shape_than_its_data": Failure(
        "npy",
        npy_with(HEADER.format("'<f4'", False, "(3, 3)"), ROWS.tobytes()),
        "promises float32 (3, 3), 36 bytes, but 48 follow",
    ),
    "csv_of_decimal_commas": Failure("csv", b"3,158,8,503\n4,2,5,1\n4,1,5,3\n", "decimal points"),
    "csv_of_decimal_commas_and_semicolons": Failure("csv", b"3,1;8,5;1,2\n", "decimal points"),
    "csv_of_decimal_commas_under_a_header": Failure(
        "csv", b"x,y,z\n1,5,2,5,3,5\n", "decimal points"
    ),
    "xyz_of_decimal_commas_and_spaces": Failure(
        "xyz", b"3,1 8,5 1,2\n4,1 5,2 6,3\n", "decimal points"
    ),
    "csv_of_underscores": Failure("csv", b"1_0,2.5,3\n1,2,3\n", "'1_0' is not a number"),
    "csv_of_uneven_rows": Failure("csv", b"1.5,2,3\n1,2,3,4\n", "but the table has 3"),
    "coordinates_of_1e30": Failure("xyz", TEXT.encode() + b"1e30 0 0\n", "a coordinate of 1e+30 m"),
    "poses_of_1e30": Failure("poses", b"0 1e30 0 0 0 0 0 1", "further from the origin than 1e+09"),
    # Elevation models that ended in a traceback, or were read as zeros.
    "tif_keys_as_text": _tag('Incompatible type for "GeoKeyDirectory"', 34735, kind=2),
    "tif_keys_as_numbers": _tag('Incompatible type for "GeoKeyDirectory"', 34735, kind=12),
    "tif_keys_of_64_bits": _tag('Incorrect value for "GeoKeyDirectory"', 34735, kind=16),
    "tif_cells_as_text": _tag("has no cell size", 33550, kind=2),
    "tif_place_as_text": _tag('Incompatible type for "GeoTiePoints"', 33922, kind=2),
    "tif_strip_of_nothing": _tag('Bogus "StripByteCounts"', 279, value=0),
    "tif_strip_outside": _tag("strip 1 of 1 lies outside", 273, value=2**31),
    "tif_strip_in_the_header": _tag("strip 1 of 1 lies outside", 273, value=0),
    "tif_too_few_strips": _tag('Incorrect count for "StripOffsets"', 278, value=9),
    "tif_of_no_samples": _tag('Bad value 0 for "SamplesPerPixel"', 277, value=0),
    "tif_strip_that_grows": Failure("tif", geotiff_bomb(), "has not as many cells as it should"),
    "places_of_25_digits": Failure("places", PLACES.encode(), "must be whole numbers"),
    # Records and frames that were refused without their name, warned of, or read.
    "run_point_not_finite": _run(
        "entry 2, submap '000': a value",
        points={"single": True, "columns": 3, "values": b"\1\0\x80\x7f" * 36},
    ),
    "run_noise_of_one_point": _run(
        "has 12 points and values for 1",
        noise_std={"single": False, "columns": 1, "values": bytes(8)},
    ),
    "run_no_candidates": _run("entry 1: the candidates must be 1", 0, candidates=0),
    "run_pose_of_1e308": _run("not the length 1", pose_odometry=[0.0, 0.0, 0.0, *[1e308] * 4]),
    "frames_of_another_version": Failure("frames", frame_of(Hello(version=2)), "update gpgrad"),
    "image_cut_short": Failure("image", b"\xff\xd8\xff\xe0" + bytes(99), "is cut short"),
}  # fmt: skip
"""By what they are."""
