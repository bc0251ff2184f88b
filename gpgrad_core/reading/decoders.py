"""What `decode_apart` runs in the other process: it reads bytes, and writes bytes or one line."""

import contextlib
import importlib
import os
import struct
import sys
from collections.abc import Callable
from typing import Any

LAZ_HEAD = struct.Struct("<QI")  # bytes of the points, bytes of the description
IMAGE_HEAD = struct.Struct("<II")  # rows, columns
LENGTH = struct.Struct("<Q")
MAX_PIXELS = 1 << 25
"""Of an image; 8192 x 4096."""


def decode_laz(data: bytes) -> bytes:
    """Decompress the points of a LAZ file.

    Args:
        data: A `LAZ_HEAD`, the record that describes the compression, and the compressed points.

    Returns:
        The points as in a LAS file.
    """
    size, described = LAZ_HEAD.unpack_from(data)
    begin = LAZ_HEAD.size + described
    lazrs: Any = importlib.import_module("lazrs")
    points = bytearray(size)
    # Threads would share one task among them, and each takes address space.
    lazrs.decompress_points(data[begin:], data[LAZ_HEAD.size : begin], points, False)
    return bytes(points)


def decode_images(data: bytes) -> bytes:
    """Decode image files to grey values.

    Args:
        data: Each file after its `LENGTH`.

    Returns:
        For each file an `IMAGE_HEAD` and the values, row by row; 0 rows if it is no image.
    """
    os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"] = str(MAX_PIXELS)
    numpy: Any = importlib.import_module("numpy")
    cv2: Any = importlib.import_module("cv2")
    decoded: list[bytes] = []
    position = 0
    while position < len(data):
        (length,) = LENGTH.unpack_from(data, position)
        position += LENGTH.size
        file = numpy.frombuffer(data, numpy.uint8, length, position)
        position += length
        image: Any = None
        with contextlib.suppress(cv2.error):  # an image of too many pixels
            image = cv2.imdecode(file, cv2.IMREAD_GRAYSCALE) if length else None
        shape = (0, 0) if image is None else image.shape
        decoded += [IMAGE_HEAD.pack(*shape), b"" if image is None else image.tobytes()]
    return b"".join(decoded)


DECODERS: dict[str, Callable[[bytes], bytes]] = {"laz": decode_laz, "images": decode_images}


def main(kind: str, memory: str, seconds: str) -> int:
    """Decode standard input to standard output, within limits.

    Args:
        kind: Name of the decoder.
        memory: Address space [bytes].
        seconds: Of the processor [s].

    Returns:
        The exit code: 1 if the decoder refuses; its last line on standard error says why.
    """
    _limit(int(memory), int(seconds))
    # Libraries that print must not mix with the reply.
    reply = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    try:
        decoded = DECODERS[kind](sys.stdin.buffer.read())
    except BaseException as error:
        said = " ".join(str(error).split()) or type(error).__name__
        sys.stderr.write(f"\n{said}\n")
        return 1
    with reply:
        reply.write(decoded)
    return 0


def _limit(memory: int, seconds: int) -> None:
    """Limit this process; systems without such limits have the clock of `decode_apart`."""
    try:
        resource: Any = importlib.import_module("resource")
    except ImportError:  # Windows
        return
    limits = {
        resource.RLIMIT_AS: (memory, memory),
        resource.RLIMIT_CPU: (seconds, seconds + 1),
        resource.RLIMIT_CORE: (0, 0),
    }
    for kind, limit in limits.items():
        with contextlib.suppress(OSError, ValueError):  # not every system has every limit
            resource.setrlimit(kind, limit)
