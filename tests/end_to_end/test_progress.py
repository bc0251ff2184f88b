"""A bar on a terminal, and only there."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.end_to_end.process import ROOT, environment

termios = pytest.importorskip("termios", reason="this system has no terminals to set up")
pty = pytest.importorskip("pty", reason="this system has no pseudo-terminals")


def test_a_terminal_sees_a_bar(traverse: Path, tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(ours, (24, 80))  # a new one is 0 wide: no room for a bar
    out = tmp_path / "closures.json"
    with subprocess.Popen(
        [sys.executable, "-m", "app", "detect", str(traverse), "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=theirs,
        env=environment(),
        cwd=ROOT,
    ) as process:
        os.close(theirs)
        seen = b""
        try:
            while chunk := os.read(ours, 65536):
                seen += chunk
        except OSError:  # how Linux says that the other end was closed
            pass
        finally:
            os.close(ours)
        assert process.wait(timeout=60) == 0
    text = seen.decode(errors="replace")
    assert "pairs" in text
    assert "100 %" in text
    assert out.exists()
