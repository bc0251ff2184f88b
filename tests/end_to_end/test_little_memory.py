"""With too little memory for the libraries, every verb ends in one line."""

import subprocess
from pathlib import Path

import pytest

from tests.end_to_end.process import start

resource = pytest.importorskip("resource", reason="this system limits no memory")


@pytest.mark.parametrize("megabytes", [150, 400])
@pytest.mark.parametrize("verb", ["detect", "map", "slam"])
def test_too_little_memory(tmp_path: Path, traverse: Path, megabytes: int, verb: str) -> None:
    limited = ("bash", "-c", f'ulimit -v {1024 * megabytes}; exec "$@"', "limited")
    source = traverse / "submaps" / "000.xyz" if verb == "map" else traverse
    out = tmp_path / {"detect": "c.json", "map": "m.npz"}.get(verb, "out")
    with start(*(verb, source, "--out", out), before=limited, stderr=subprocess.PIPE) as process:
        _, said = process.communicate(timeout=180)
    assert process.returncode in (0, 2)  # there may be enough
    assert "Traceback" not in said
    if process.returncode:
        assert said.splitlines()[-1].startswith("gpgrad: ")
