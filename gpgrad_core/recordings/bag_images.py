"""Image and CompressedImage messages of ROS -> arrays."""

import struct
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import UInt8

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.reading.decoding import MAX_PIXELS
from gpgrad_core.reading.images import decode_grey, decode_grey_png
from gpgrad_core.recordings.cameras import Camera

Message: TypeAlias = Any
"""A message, or a part of one; rosbags makes its types while it runs."""
Grey: TypeAlias = UInt8[NDArray[np.uint8], "rows columns"]
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
FORMS = {
    "mono8": ("u1", 1), "8UC1": ("u1", 1), "8UC3": ("u1", 3), "mono16": ("u2", 1),
    "rgb8": ("u1", 3), "bgr8": ("u1", 3), "rgba8": ("u1", 4), "bgra8": ("u1", 4),
    "16UC1": ("u2", 1), "32FC1": ("f4", 1), "bayer_rggb8": ("u1", 1), "bayer_bggr8": ("u1", 1),
    "bayer_gbrg8": ("u1", 1), "bayer_grbg8": ("u1", 1),
}  # fmt: skip
"""NumPy's type, and the number of values of a pixel, by the name of the encoding."""
DEPTHS = ("16UC1", "32FC1")
DEPTH_HEAD = struct.Struct("<i2f")
"""What image_transport puts before a compressed depth image: its format, and two numbers."""


def encoding_of(message: Message) -> str:
    """Give the encoding of an image's values; that of a compressed one if it says so, else ""."""
    if hasattr(message, "encoding"):
        return str(message.encoding)
    return str(message.format).split(";", 1)[0].strip()


def is_depth(message: Message) -> bool:
    """Tell whether an image holds depths."""
    packed_otherwise = "compressedDepth" not in getattr(message, "format", "compressedDepth")
    return not packed_otherwise and encoding_of(message) in DEPTHS


def grey_images(messages: Sequence[Message], where: Sequence[str]) -> list[Grey]:
    """Read the grey values of images."""
    packed = [hasattr(message, "format") for message in messages]
    chosen = [k for k, is_packed in enumerate(packed) if is_packed]
    contents = [np.asarray(messages[k].data, np.uint8).tobytes() for k in chosen]
    unpacked = dict(zip(chosen, decode_grey(contents, [where[k] for k in chosen]), strict=True))
    return [
        unpacked[k] if k in unpacked else _grey(message, where[k])
        for k, message in enumerate(messages)
    ]


def _grey(message: Message, where: str) -> Grey:
    import cv2  # noqa: PLC0415 - loads slowly

    values: Any = raw_values(message, where)
    encoding = str(message.encoding)
    if encoding.startswith("bayer_"):
        code = getattr(cv2, f"COLOR_Bayer{encoding[6:10].upper()}2GRAY")
        return cv2.cvtColor(values, code)
    if values.ndim == 3:
        first = "RGB" if encoding.startswith("rgb") else "BGR"
        alpha = "A" if values.shape[2] == 4 else ""
        return cv2.cvtColor(values, getattr(cv2, f"COLOR_{first}{alpha}2GRAY"))
    if values.dtype != np.uint8:
        if encoding in DEPTHS:
            raise InputError(f"{where}: holds depths ({encoding}), not an image of a camera")
        # Cameras of 10 or 12 bits leave the upper ones empty; matching looks at contrasts only.
        return (values / max(int(values.max(initial=0)) / 255.0, 1.0)).astype(np.uint8)
    return values


def raw_values(message: Message, where: str) -> NDArray[np.generic]:
    """Give the values of an ``Image`` (rows, columns) or (rows, columns, channels)."""
    encoding = str(message.encoding)
    if encoding not in FORMS:
        raise InputError(f"{where}: its encoding is {encoding:.40}; known are {', '.join(FORMS)}")
    kind, channels = FORMS[encoding]
    rows, columns = int(message.height), int(message.width)
    if rows * columns > MAX_PIXELS:
        raise InputError(f"{where}: has over {MAX_PIXELS:,} pixels")
    type_ = np.dtype((">" if message.is_bigendian else "<") + kind)
    least = columns * channels * type_.itemsize
    step = max(int(message.step), least)
    data = np.asarray(message.data, np.uint8)
    if len(data) < rows * step or rows * columns == 0:
        raise InputError(
            f"{where}: is cut short: {rows} rows of {step} bytes, but it holds {len(data):,} bytes"
        )
    table = np.ascontiguousarray(data[: rows * step].reshape(rows, step)[:, :least])
    values = table.view(type_).reshape(rows, columns, channels)
    values = values.astype(type_.newbyteorder("="), copy=False)
    return values[:, :, 0] if channels == 1 else values


def depths(message: Message, camera: Camera, where: str) -> NDArray[np.float32]:
    """Give the depth of each pixel [m]; 0 or NaN where there is none."""
    encoding = encoding_of(message)
    if encoding not in DEPTHS:
        raise InputError(f"{where}: its encoding is {encoding:.40}, not {' or '.join(DEPTHS)}")
    if not hasattr(message, "format"):
        values = raw_values(message, where)
    else:
        content = np.asarray(message.data, np.uint8).tobytes()
        if len(content) < DEPTH_HEAD.size:
            raise InputError(f"{where}: is cut short: it holds {len(content)} bytes")
        columns, rows = camera.size
        values = decode_grey_png(content[DEPTH_HEAD.size :], rows, columns, where)
        if encoding == "32FC1":
            # image_transport stores inverse depths, as a / depth + b.
            _, a, b = DEPTH_HEAD.unpack_from(content)
            with np.errstate(divide="ignore", invalid="ignore"):
                inverted = np.float32(a) / (values.astype(np.float32) - np.float32(b))
            values = np.where(values > 0, inverted, np.float32(np.nan))
    camera.check_image(values, where)
    scale = np.float32(0.001 if encoding == "16UC1" else 1.0)
    return values.astype(np.float32) * scale
