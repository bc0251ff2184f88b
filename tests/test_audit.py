"""Advisories against the libraries: a warning, and never a failure."""

import importlib.util
import json
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

SCRIPT = Path(__file__).parents[1] / ".ci" / "audit.py"
SOUND = {"name": "numpy", "version": "2.1.0", "vulns": []}
ADVISED: dict[str, Any] = {
    "name": "pillow",
    "version": "9.0.0",
    "vulns": [{"id": "PYSEC-1", "fix_versions": ["9.1", "9.2"]}, {"id": "X", "fix_versions": []}],
}
SKIPPED = {"name": "viser", "skip_reason": "Dependency not found on PyPI"}


@pytest.fixture(scope="module")
def audit() -> ModuleType:
    spec = importlib.util.spec_from_file_location("audit", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def answer(*libraries: dict[str, Any]) -> str:
    return json.dumps({"dependencies": libraries, "fixes": []})


@pytest.mark.parametrize("forge", [False, True])
@pytest.mark.parametrize(
    ("answers", "said"),
    [
        ([answer(SOUND, SKIPPED)], ["1 libraries checked by pypi: 0 advisories"]),
        (
            ["no route to host", answer(SOUND, ADVISED)],
            [
                "!pillow 9.0.0: PYSEC-1, mended in 9.1, 9.2",
                "!pillow 9.0.0: X",
                "2 libraries checked by osv: 2 advisories",
            ],
        ),
        # pip-audit calls this sound.
        ([answer(SKIPPED), ""], ["!no database of advisories can be reached from here"]),
        (["[]", '{"dependencies": [{}]}'], ["!no database of advisories can be reached from here"]),
    ],
)
def test_it_warns_and_never_fails(
    audit: ModuleType,
    answers: list[str],
    said: list[str],
    forge: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = iter(answers)
    monkeypatch.setattr(audit, "ask", lambda _: next(given))
    monkeypatch.delenv("GITHUB_ACTIONS", raising=False)
    if forge:
        monkeypatch.setenv("GITHUB_ACTIONS", "true")
    assert audit.main() == 0
    lines = capsys.readouterr().out.splitlines()
    marked = [line.replace("!", "::warning::" if forge else "WARNING: ") for line in said]
    assert len(lines) == len(marked)
    assert all(line.startswith(mark) for line, mark in zip(lines, marked, strict=True))
