"""Examples in docstrings say what happens."""

import doctest
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LONG = {"gpgrad_core.slam.drive", "gpgrad_core.slam.loop_closer"}
"""Examples of whole drives, which take seconds."""
MODULES = [
    pytest.param(name, marks=pytest.mark.slow) if name in LONG else name
    for package in ("app", "gpgrad_core")
    for path in sorted((ROOT / package).rglob("*.py"))
    if ">>>" in path.read_text(encoding="utf-8")
    for name in [".".join(path.relative_to(ROOT).with_suffix("").parts)]
]


@pytest.mark.parametrize("name", MODULES)
def test_examples(name: str) -> None:
    results = doctest.testmod(importlib.import_module(name))
    assert results.attempted > 0
    assert results.failed == 0
