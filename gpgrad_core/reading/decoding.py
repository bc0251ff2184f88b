"""Native libraries decode foreign bytes in a process of their own, within limits.

A damaged file can make them abort, take all memory or never return, which Python cannot catch.
"""

import contextlib
import importlib
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Callable
from typing import Literal, TypeAlias

DecoderKind: TypeAlias = Literal["laz", "images"]

BASE_MEMORY = 1 << 30
"""Address space for the interpreter and the libraries [bytes]."""
BASE_SECONDS = 5
"""Time to start, and to decode what is small [s]."""
BYTES_PER_SECOND: dict[DecoderKind, int] = {"laz": 8_000_000, "images": 50_000_000}
"""What each decoder makes on a slow computer; a usual one makes four times as much."""
START = "import sys; from gpgrad_core.reading.decoding import main; sys.exit(main(*sys.argv[1:]))"
LAZ_HEAD = struct.Struct("<QI")  # bytes of the points, bytes of the description
IMAGE_HEAD = struct.Struct("<II")  # rows, columns
LENGTH = struct.Struct("<Q")
MAX_PIXELS = 1 << 25
"""Of an image; 8192 x 4096."""


class DecodingError(Exception):
    """A decoder failed, died or was stopped; the message says which in a few words."""


def decode_apart(kind: DecoderKind, data: bytes, most_bytes: int) -> bytes:
    """Decode bytes in another process, whose time and memory the most bytes to return bound."""
    seconds = BASE_SECONDS + most_bytes // BYTES_PER_SECOND[kind]
    memory = BASE_MEMORY + 3 * (most_bytes + len(data))
    # One thread and few arenas: each reserves address space, which the limit counts.
    single = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MALLOC_ARENA_MAX"), "1")
    path = os.pathsep.join(entry or str(os.curdir) for entry in sys.path)
    try:
        # The processor's time is limited within; the clock is only for one that waits for ever.
        finished = subprocess.run(
            [sys.executable, "-c", START, kind, str(memory), str(seconds)],
            input=data,
            capture_output=True,
            check=False,
            timeout=6 * seconds,
            env={**os.environ, **single, "PYTHONPATH": path},
        )
    except subprocess.TimeoutExpired:
        raise DecodingError(f"decoding it takes more than {6 * seconds} s") from None
    if finished.returncode == 0:
        if len(finished.stdout) > most_bytes:
            raise DecodingError(f"it decodes to more than {most_bytes:,} bytes")
        return finished.stdout
    raise DecodingError(_reason(finished.returncode, finished.stderr, memory, seconds))


def _reason(code: int, stderr: bytes, memory: int, seconds: int) -> str:
    if code == 1:  # the decoder's own words are its last line
        return stderr.decode("utf-8", "replace").strip().rpartition("\n")[2]
    if os.name == "posix" and code == -signal.SIGXCPU:
        return f"decoding it takes more than {seconds} s"
    if b"alloc" in stderr:
        return f"decoding it takes more than {memory / 1e9:.1f} GB"
    return f"its decoder died (exit code {code})"


def decode_laz(data: bytes) -> bytes:
    """Decompress LAZ points to LAS; `LAZ_HEAD` and the compression's record come first."""
    size, described = LAZ_HEAD.unpack_from(data)
    begin = LAZ_HEAD.size + described
    lazrs = importlib.import_module("lazrs")
    points = bytearray(size)
    # Threads would share one task among them, and each takes address space.
    lazrs.decompress_points(data[begin:], data[LAZ_HEAD.size : begin], points, False)
    return bytes(points)


def decode_images(data: bytes) -> bytes:
    """Decode image files, each after its `LENGTH`, to `IMAGE_HEAD` (0 rows if none) and rows."""
    os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"] = str(MAX_PIXELS)
    numpy = importlib.import_module("numpy")
    cv2 = importlib.import_module("cv2")
    decoded: list[bytes] = []
    position = 0
    while position < len(data):
        (length,) = LENGTH.unpack_from(data, position)
        position += LENGTH.size
        file = numpy.frombuffer(data, numpy.uint8, length, position)
        position += length
        image = None
        with contextlib.suppress(cv2.error):  # an image of too many pixels
            image = cv2.imdecode(file, cv2.IMREAD_GRAYSCALE) if length else None
        shape = (0, 0) if image is None else image.shape
        decoded += [IMAGE_HEAD.pack(*shape), b"" if image is None else image.tobytes()]
    return b"".join(decoded)


DECODERS: dict[str, Callable[[bytes], bytes]] = {"laz": decode_laz, "images": decode_images}


def main(kind: str, memory: str, seconds: str) -> int:
    """Decode standard input to standard output within limits."""
    _limit(int(memory), int(seconds))
    # Libraries that print must not mix with the reply.
    reply = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    try:
        decoded = DECODERS[kind](sys.stdin.buffer.read())
    except BaseException as error:
        message = " ".join(str(error).split()) or type(error).__name__
        sys.stderr.write(f"\n{message}\n")
        return 1
    with reply:
        reply.write(decoded)
    return 0


def _limit(memory: int, seconds: int) -> None:
    """Limit this process; systems without such limits have the clock of `decode_apart`."""
    try:
        resource = importlib.import_module("resource")
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
