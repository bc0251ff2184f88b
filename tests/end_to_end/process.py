"""Ways to run the command: in this process, as a process, and on a terminal."""

import contextlib
import io
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from app.cli import run

ROOT = Path(__file__).resolve().parents[2]
VERBS = (
    *("view", "demo", "detect", "evaluate", "reproduce", "map", "fit", "build", "slam", "locate"),
    "simulate",
)
QUICK_MAP = (
    *("--map.resolution", "0.1", "--map.length-scale", "0.3"),
    *("--map.noise-std", "0.02", "--map.scale", "0.2"),
)
"""Flags with which a map needs no fit."""


@dataclass(frozen=True)
class Finished:
    """What a command left."""

    code: int
    out: str
    err: str

    @property
    def refusal(self) -> str:
        """The one line of an error; fails if it is anything else."""
        assert self.code == 2, (self.code, self.out, self.err)
        assert "Traceback" not in self.err
        lines = self.err.splitlines()
        assert len(lines) == 1, self.err
        assert lines[0].startswith("gpgrad: ")
        return lines[0].removeprefix("gpgrad: ")


def environment() -> dict[str, str]:
    """Let the checkout be found from anywhere, installed or not."""
    return os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUTF8": "1", "COLUMNS": "100"}


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Let processes that are started in the block hear Ctrl-C.

    A shell starts programs in the background with SIGINT ignored, and they hand that on.
    """
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        yield
        return
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def start(
    *arguments: str | Path, before: tuple[str, ...] = (), **options: Any
) -> "subprocess.Popen[str]":
    """Start ``gpgrad``, with options of `subprocess.Popen`; nobody hears it unless they say so.

    What comes before it in the command line starts it.
    """
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with interruptible():
        return subprocess.Popen(
            [*before, sys.executable, "-m", "app", *map(str, arguments)],
            text=True,
            encoding="utf-8",
            cwd=ROOT,
            **{"env": environment()} | quiet | options,
        )


def gpgrad_process(*arguments: str | Path) -> Finished:
    """Run ``gpgrad`` as its users do, as a process, to its end."""
    with start(*arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            out, err = process.communicate(timeout=180)
        finally:
            process.kill()
    return Finished(process.returncode, out, err)


def gpgrad(*arguments: str | Path) -> Finished:
    """Run ``gpgrad`` in this process, where it starts at once."""
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        patch.dict(os.environ, environment()),
    ):
        try:
            code = run([str(argument) for argument in arguments])
        except SystemExit as leaving:  # after help
            code = int(leaving.code or 0)
    return Finished(code, out.getvalue(), err.getvalue())


def run_on_terminal(*arguments: str | Path, interrupt_at: bytes | None = None) -> tuple[int, str]:
    """Run ``gpgrad`` on a terminal, where it draws a bar; give its code and what was seen.

    Args:
        arguments: Of the command.
        interrupt_at: Press Ctrl-C once this was seen.
    """
    termios = pytest.importorskip("termios", reason="this system has no terminals to set up")
    pty = pytest.importorskip("pty", reason="this system has no pseudo-terminals")
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(ours, (24, 80))  # a new one is 0 wide: no room for a bar
    with start(*arguments, stderr=theirs) as process:
        os.close(theirs)
        seen, interrupted = b"", False
        try:
            while chunk := os.read(ours, 65536):
                seen += chunk
                if interrupt_at is not None and interrupt_at in seen and not interrupted:
                    process.send_signal(signal.SIGINT)
                    interrupted = True
        except OSError:  # how Linux says that the other end was closed
            pass
        finally:
            os.close(ours)
        return process.wait(timeout=60), seen.decode(errors="replace")
