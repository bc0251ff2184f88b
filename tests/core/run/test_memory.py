"""Memory that is free goes back to the system."""

import subprocess
import sys

import pytest

from gpgrad_core.run.memory import _trim

# Freed blocks below one that is still held stay with the process, unless it gives them back.
HOARD = """
import psutil
from gpgrad_core.run.memory import give_back
blocks = [bytearray(b"x" * 100_000) for _ in range(1000)]
last = bytearray(b"x" * 100_000)
del blocks
before = psutil.Process().memory_info().rss
give_back()
print(before - psutil.Process().memory_info().rss)
"""


@pytest.mark.skipif(_trim() is None, reason="only the GNU C library can be told")
def test_what_was_freed_goes_back_to_the_system() -> None:
    done = subprocess.run(
        [sys.executable, "-c", HOARD], check=True, capture_output=True, text=True, timeout=60
    )
    assert int(done.stdout) > 50_000_000
