"""A way to run the command as its users do: as a process."""

import contextlib
import io
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol
from unittest.mock import patch

import pytest

from app.cli import run

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Finished:
    """What a process left."""

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


class Run(Protocol):
    """Type of `run_gpgrad`."""

    def __call__(self, *arguments: str | Path) -> Finished:
        """Run it."""
        ...


def environment() -> dict[str, str]:
    """Let the checkout be found from anywhere, installed or not."""
    return os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUTF8": "1", "COLUMNS": "100"}


def run_gpgrad(*arguments: str | Path) -> Finished:
    """Run ``gpgrad`` to its end."""
    finished = subprocess.run(
        [sys.executable, "-m", "app", *map(str, arguments)],
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=180,
        check=False,
        env=environment(),
        cwd=ROOT,
    )
    return Finished(finished.returncode, finished.stdout, finished.stderr)


def run_here(*arguments: str | Path) -> Finished:
    """Run ``gpgrad`` in this process: for what ends before any work, where starting is the cost."""
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
    with subprocess.Popen(
        [sys.executable, "-m", "app", *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        stderr=theirs,
        env=environment(),
        cwd=ROOT,
    ) as process:
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
