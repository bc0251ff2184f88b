"""Native libraries decode foreign bytes in a process of their own.

A damaged file can make them abort, take all memory or never return, and nothing in Python can
catch that. Another process can be given limits, and when it dies this one says so in a line.
"""

import os
import signal
import subprocess
import sys
from typing import Literal, TypeAlias

Kind: TypeAlias = Literal["laz", "images"]

BASE_MEMORY = 1 << 30
"""Address space for the interpreter and the libraries [bytes]."""
BASE_SECONDS = 5
"""Time to start, and to decode what is small [s]."""
BYTES_PER_SECOND: dict[Kind, int] = {"laz": 8_000_000, "images": 50_000_000}
"""What each decoder makes on a slow computer; a usual one makes four times as much."""
START = "import sys; from gpgrad_core.reading.decoders import main; sys.exit(main(*sys.argv[1:]))"


class DecodingError(Exception):
    """A decoder failed, died or was stopped; the message says which in a few words."""


def decode_apart(kind: Kind, data: bytes, most_bytes: int) -> bytes:
    """Decode bytes in another process.

    Args:
        kind: Which decoder; see `gpgrad_core.reading.decoders`.
        data: What it is given.
        most_bytes: The most that it may return. Time and memory are bounded by it.

    Returns:
        What the decoder returned.

    Raises:
        DecodingError: If it fails, needs more than its limits, or dies.
    """
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
