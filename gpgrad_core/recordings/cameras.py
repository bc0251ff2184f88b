"""A camera's calibration: of ``CameraInfo`` messages, and of the files that hold one.

The names of distortion models are those of ROS, Kalibr and EuRoC. `read_camera` reads text in
YAML's simplest form, ``key: value`` and ``key: [numbers]``: the files of ROS's calibrator
(``camera_matrix``), what ``rostopic echo`` prints (``K`` or ``k``), and EuRoC's ``sensor.yaml``.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.io.poses import check_matrices
from gpgrad_core.reading.decoding import MAX_PIXELS
from gpgrad_core.reading.text import parse_numbers, read_text
from gpgrad_core.recordings.pose_files import poses_of_matrices
from gpgrad_core.recordings.trajectory import Poses

LARGEST = 100_000
"""Bytes of a file that holds a calibration."""
PINHOLE = ("", "plumb_bob", "rational_polynomial", "radtan", "radial-tangential", "none")
FISHEYE = ("equidistant", "fisheye", "kannala_brandt4")
COEFFICIENTS = (0, 4, 5, 8, 12, 14)
"""Numbers of coefficients that OpenCV's pinhole model may have."""
MOST = 1e6
"""Largest focal length, offset and coefficient."""
LEAST_FOCAL = 1.0
"""Smallest focal length [pixels]; with a smaller one, nearly all rays would lie in the image."""


@dataclass(frozen=True, eq=False)
class CameraModel:
    """A calibrated camera; z of its frame looks ahead, x to the right and y down."""

    where: str  # file or topic, for messages
    size: tuple[int, int]  # width, height [pixels]
    matrix: Float[Array, "3 3"]  # focal lengths and centre of the image as it was taken [pixels]
    distortion: Float[Array, "k"]
    fisheye: bool = False  # whether the distortion is equidistant
    rectification: Float[Array, "3 3"] | None = None  # ``R_rectified_camera``
    projection: Float[Array, "3 4"] | None = None  # of the rectified image [pixels]
    on_body: Poses | None = None  # ``T_body_camera``, if the file says so

    def check_image(self, image: NDArray[np.generic], where: str) -> None:
        rows, columns = image.shape[:2]
        if (columns, rows) != self.size:
            raise InputError(
                f"{where}: the image has {columns} x {rows} pixels, its calibration {self.where} "
                f"is for {self.size[0]} x {self.size[1]}"
            )

    def rays(self, *, rectified: bool) -> Float[NDArray[np.float32], "rows columns 2"]:
        """X and y of each pixel's ray where z is 1, in the image as taken or rectified."""
        import cv2  # noqa: PLC0415 - loads slowly

        columns, rows = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in self.size))
        pixels = np.stack([columns, rows], axis=-1)
        matrix = self.matrix if self.projection is None or not rectified else self.projection
        centre, focal = matrix[:2, 2], np.array([matrix[0, 0], matrix[1, 1]])
        if rectified or not self.distortion.any():
            return ((pixels - centre) / focal).astype(np.float32)
        flat = pixels.reshape(-1, 1, 2)
        undo = cv2.fisheye.undistortPoints if self.fisheye else cv2.undistortPoints
        return undo(flat, self.matrix, self.distortion).reshape(pixels.shape).astype(np.float32)


def make_camera(values: Mapping[str, object], where: str) -> CameraModel:
    """Make a camera of the fields of a ``CameraInfo``; ``r`` and ``p`` may be missing, or zeros."""
    size = tuple(_whole(values.get(key), key, where) for key in ("width", "height"))
    if size[0] * size[1] > MAX_PIXELS:
        raise InputError(f"{where}: its images have over {MAX_PIXELS:,} pixels")
    matrix = _numbers(values.get("k"), (9,), "K", where).reshape(3, 3)
    model = str(values.get("distortion_model", "")).strip().lower()
    if model not in (*PINHOLE, *FISHEYE):
        models = ", ".join(name for name in (*PINHOLE, *FISHEYE) if name)
        raise InputError(f"{where}: its distortion model is {model:.40}; known are {models}")
    fisheye = model in FISHEYE
    coefficients = values.get("d")
    counts = (0, 4) if fisheye else COEFFICIENTS
    distortion = _numbers([] if coefficients is None else coefficients, counts, "D", where)
    if fisheye and not len(distortion):
        distortion = np.zeros(4)
    turn, projection = values.get("r"), values.get("p")
    r = None if turn is None else _numbers(turn, (9,), "R", where).reshape(3, 3)
    p = None if projection is None else _numbers(projection, (12,), "P", where).reshape(3, 4)
    r = None if r is None or not r.any() else r
    p = None if p is None or not p.any() else p
    for name, checked in (("K", matrix), ("P", p)):
        if checked is not None:
            _check_projection(checked, f"{where}: {name}")
    if r is not None:
        check_matrices(np.column_stack([r, np.zeros(3)])[None], [f"{where}: R"])
    on_body = values.get("t_bs")
    body = None
    if on_body is not None:
        rows = _numbers(on_body, (12, 16), "T_BS", where)[:12].reshape(1, 12)
        body = poses_of_matrices(rows, [f"{where}: T_BS"])
    return CameraModel(where, (size[0], size[1]), matrix, distortion, fisheye, r, p, body)


def camera_of(message: Any, where: str) -> CameraModel:
    """Read a ``CameraInfo`` of ROS 1 or ROS 2."""
    names = ("width", "height", "distortion_model")
    values = {name: getattr(message, name) for name in names}
    for name in "kdrp":
        values[name] = getattr(message, name, getattr(message, name.upper(), None))
    return make_camera(values, where)


def read_camera(path: Path) -> CameraModel:
    """Read a file with the calibration of one camera; see the top of this module for its forms."""
    if not path.exists():
        raise InputError(f"{path}: no such file; it should hold the calibration of a camera")
    fields = _fields(read_text(path, LARGEST))
    size = _list(fields.get("resolution", ""))
    width, height = size if len(size) == 2 else ("", "")
    focal = _list(fields.get("intrinsics", ""))
    matrix = None
    if len(focal) == 4:
        fu, fv, cu, cv = focal
        matrix = [fu, "0", cu, "0", fv, cv, "0", "0", "1"]
    values: dict[str, object] = {
        "width": fields.get("width") or fields.get("image_width") or width,
        "height": fields.get("height") or fields.get("image_height") or height,
        "distortion_model": _plain(fields.get("distortion_model", "")),
        "k": matrix or _first(fields, "k", "camera_matrix"),
        "d": _first(fields, "d", "distortion_coefficients", "distortion_coeffs"),
        "r": _first(fields, "r", "rectification_matrix"),
        "p": _first(fields, "p", "projection_matrix"),
        "t_bs": _first(fields, "t_bs"),
    }
    return make_camera(values, str(path))


def read_kitti_cameras(path: Path, numbers: tuple[int, int]) -> tuple[CameraModel, CameraModel]:
    """Read two cameras, of rectified images of unknown size (0 x 0), of KITTI's ``calib.txt``."""
    rows = {
        words[0].rstrip(":"): words[1:]
        for line in read_text(path, LARGEST).splitlines()
        if (words := line.split())
    }
    cameras: list[CameraModel] = []
    for number in numbers:
        where = f"{path}, P{number}"
        if f"P{number}" not in rows:
            raise InputError(f"{path}: has no row P{number}: of camera {number}")
        p = _numbers(rows[f"P{number}"], (12,), f"P{number}", where).reshape(3, 4)
        _check_projection(p, where)
        cameras.append(CameraModel(where, (0, 0), p[:, :3], np.zeros(0), projection=p))
    return cameras[0], cameras[1]


def _check_projection(matrix: Array, where: str) -> None:
    if min(matrix[0, 0], matrix[1, 1]) < LEAST_FOCAL:
        raise InputError(
            f"{where} has no focal length of {LEAST_FOCAL:g} pixel or more; the camera was not "
            "calibrated"
        )
    if matrix[1, 0] != 0 or not np.array_equal(matrix[2, :3], [0, 0, 1]):
        raise InputError(f"{where} is not of the form fx s cx, 0 fy cy, 0 0 1")


def _fields(text: str) -> dict[str, str]:
    """Find ``key: value``; the list of a nested ``data`` gets the name that it stands under."""
    fields: dict[str, str] = {}
    above = ""
    lines = re.sub(r"#.*", "", text)
    for key, value in re.findall(r"(?m)^[ \t]*(\w+):[ \t]*(\[[^\[\]]*\]|[^\[\n]*)", lines):
        name = key.lower()
        if value.strip():
            fields.setdefault(above if name == "data" and above else name, value.strip())
        else:
            above = name
    return fields


def _first(fields: Mapping[str, str], *names: str) -> list[str] | None:
    return next((_list(fields[name]) for name in names if name in fields), None)


def _list(text: str) -> list[str]:
    return text.strip("[]").replace(",", " ").split() if text.startswith("[") else []


def _plain(text: str) -> str:
    return text.strip("\"' ")


def _numbers(values: Any, counts: tuple[int, ...], name: str, where: str) -> Array:
    parsed = [] if values is None else list(values)
    if len(parsed) not in counts:
        expected = " or ".join(map(str, counts))
        raise InputError(f"{where}: {name} must have {expected} numbers, it has {len(parsed)}")
    numbers = np.array(parse_numbers([str(value) for value in parsed], f"{where}: {name}"))
    if len(numbers) and np.abs(numbers).max() > MOST:
        raise InputError(f"{where}: {name} has a number beyond {MOST:g}")
    return numbers


def _whole(value: object, name: str, where: str) -> int:
    (number,) = parse_numbers([str(value if value is not None else "")], f"{where}: {name}")
    if not number.is_integer() or not 0 < number <= MAX_PIXELS:
        raise InputError(f"{where}: {name} must be a number of pixels, got {number:g}")
    return int(number)
