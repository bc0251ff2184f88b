"""Waiting for what happens, on a machine that may be busy."""

import time
from collections.abc import Callable

PATIENCE = 120.0
"""After so long nothing more is expected to happen [s]; on an idle machine all comes at once."""


def until(condition: Callable[[], object], what: str, patience: float = PATIENCE) -> None:
    """Wait until a condition holds; fail with its description."""
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, f"waited {patience:.0f} s for {what}"
        time.sleep(0.01)
