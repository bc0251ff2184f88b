"""Tries files of one format, within limits, and writes a line for each, for `tests.long.fuzz`."""

import json
import resource
import signal
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from types import FrameType

from tests.long.fuzz.formats import SECONDS, make_case, try_case

MEMORY = 2 << 30
"""Address space [bytes]; that of libraries is in it."""


def _too_long(signum: int, frame: FrameType | None) -> None:
    raise TimeoutError(f"signal {signum} at {frame}")


def main(name: str, seed: int, start: int, stop: int) -> None:
    """Try the files numbered start to stop - 1."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGALRM, _too_long)
    with tempfile.TemporaryDirectory(prefix="gpgrad-fuzz-") as folder:
        for number in range(start, stop):
            case = make_case(name, seed, number)
            signal.setitimer(signal.ITIMER_REAL, SECONDS)
            result = try_case(name, case, Path(folder))
            signal.setitimer(signal.ITIMER_REAL, 0)
            sys.stdout.write(json.dumps({"number": number, **asdict(result)}) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1], *(int(word) for word in sys.argv[2:5]))
