"""Runs each system in a process of its own."""

import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[4]


def gpgrad(*arguments: str) -> float:
    """Run a verb of gpgrad; gives its seconds, the start of Python among them."""
    return run_module("app", *arguments)


def run_module(name: str, *arguments: str, cap: float | None = None) -> float:
    """Run a module; gives its seconds.

    Raises:
        RuntimeError: If it fails, or takes more seconds than the cap; the message says why, by the
            last line that it said.
    """
    start = time.perf_counter()
    try:
        ended = subprocess.run(
            [sys.executable, "-m", name, *arguments],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
            timeout=cap,
        )
    except subprocess.TimeoutExpired:
        raise RuntimeError(f"over {cap:g} s") from None
    if ended.returncode:
        said = (ended.stderr.strip() or ended.stdout.strip() or "nothing").splitlines()
        raise RuntimeError(f"{name} {arguments[0]} ended with {ended.returncode}: {said[-1][:200]}")
    return time.perf_counter() - start
