"""With too little memory for the libraries, every verb ends in one line."""

import subprocess
from pathlib import Path

import pytest

from app.cli.terminal import exit_code
from tests.end_to_end.process import start

resource = pytest.importorskip("resource", reason="this system limits no memory")


@pytest.mark.parametrize("megabytes", [150, 400, 700, 900])
@pytest.mark.parametrize("verb", ["detect", "map", "slam"])
def test_too_little_memory(tmp_path: Path, traverse: Path, megabytes: int, verb: str) -> None:
    limited = ("bash", "-c", f'ulimit -v {1024 * megabytes}; exec "$@"', "limited")
    source = traverse / "submaps" / "000.xyz" if verb == "map" else traverse
    out = tmp_path / {"detect": "c.json", "map": "m.npz"}.get(verb, "out")
    with start(*(verb, source, "--out", out), before=limited, stderr=subprocess.PIPE) as process:
        _, said = process.communicate(timeout=180)
    assert process.returncode == 2
    assert said.startswith("gpgrad: ")
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        ImportError("libssl.so: failed to map segment from shared object"),
        RuntimeError("can't start new thread"),
    ],
)
def test_what_the_system_refuses_later(
    error: Exception, capsys: pytest.CaptureFixture[str]
) -> None:
    def work() -> None:
        raise error

    assert exit_code(work) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("gpgrad: there is too little memory, or a library")
