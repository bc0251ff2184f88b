"""The guide's table of names that changed says what is true of each."""

import importlib
import importlib.util
import inspect
import re

import pytest

import gpgrad_core as gg
from tests.test_readme import GUIDE, read

_, _, SECTION = read(GUIDE / "python.md").partition("## Names that changed\n")
ROWS = [
    (old, re.findall(r"`([\w.()]+)`", now), state)
    for line in re.findall(r"^\| `.*$", SECTION, flags=re.MULTILINE)
    for before, now, state in [line.strip("| ").split(" | ")]
    for old in re.findall(r"`([\w.()]+)`", before)
]


def is_there(name: str) -> bool:
    """Whether a module, an attribute of a public class or a parameter, as `f(x)`, exists."""
    if name.startswith("gpgrad_core."):
        module, _, last = name.rpartition(".")
        if importlib.util.find_spec(module) is None:
            return False
        return hasattr(importlib.import_module(module), last) or bool(
            importlib.util.find_spec(name)
        )
    path, _, parameter = name.rstrip(")").partition("(")
    there: object = gg
    for part in path.split("."):
        if not hasattr(there, part):
            return part in getattr(there, "__dataclass_fields__", {})
        there = getattr(there, part)
    return not parameter or (callable(there) and parameter in inspect.signature(there).parameters)


def test_the_table_is_read() -> None:
    assert len(ROWS) > 12


@pytest.mark.parametrize(("old", "now", "state"), ROWS)
def test_names(old: str, now: list[str], state: str) -> None:
    assert is_there(old) == (state == "works")
    assert all(map(is_there, now))
