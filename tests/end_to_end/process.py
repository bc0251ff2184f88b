"""A way to run the command as its users do: as a process."""

import contextlib
import io
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol
from unittest.mock import patch

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
