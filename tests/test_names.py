"""The guide's table of names that changed says what is true of each."""

import contextlib
import importlib
import re

import pytest

import gpgrad_core as gg
from gpgrad_core.former import MODULES
from tests.test_readme import GUIDE, read

_, _, SECTION = read(GUIDE / "python.md").partition("## Names that changed\n")
ROWS = [
    (old, re.findall(r"`([\w.()]+)`", now), state)
    for line in re.findall(r"^\| `.*$", SECTION, flags=re.MULTILINE)
    for before, now, state in [line.strip("| ").split(" | ")]
    for old in re.findall(r"`([\w.()]+)`", before)
]


def is_there(name: str) -> bool:
    """Whether a module, or an attribute of a public class, exists."""
    if name.startswith("gpgrad_core."):
        return bool(importlib.import_module(name))
    there: object = gg
    for part in name.split("."):
        if not hasattr(there, part):
            return part in getattr(there, "__dataclass_fields__", {})
        there = getattr(there, part)
    return True


def call(function: str, parameter: str) -> None:
    """Call a function with a parameter by its former name, whatever else it needs."""
    there: object = gg
    for part in function.split("."):
        there = getattr(there, part)
    assert callable(there)
    with contextlib.suppress(TypeError):
        there(**{parameter: {}})


def test_the_table_is_read() -> None:
    assert len(ROWS) > 12
    assert {old for old, _, state in ROWS if state == "gone"} == {
        f"gpgrad_core.{name}" for name in MODULES
    }


@pytest.mark.parametrize(("old", "now", "state"), ROWS)
def test_names(old: str, now: list[str], state: str) -> None:
    function, _, parameter = old.rstrip(")").partition("(")
    if parameter:
        new = now[0].rstrip(")").partition("(")[2] if now else "no effect"
        with pytest.warns(DeprecationWarning, match=f"{parameter} .*{new}"):
            call(function, parameter)
    elif state == "works":
        assert is_there(old)
        assert all(map(is_there, now))
    else:
        assert is_there(now[0])
        with pytest.raises(ImportError, match=f"^{old} is now {now[0]};"):
            exec(f"from gpgrad_core import {old.partition('.')[2]}")


def test_a_former_parameter_does_what_it_did() -> None:
    poses = {name: gg.Pose.from_planar(gg.SE2(x, 0.0, 0.0)) for x, name in enumerate("abc")}
    with pytest.warns(DeprecationWarning, match="trajectory_error: found is now estimated"):
        assert gg.trajectory_error(poses, found=poses).absolute < 1e-9  # pyright: ignore[reportCallIssue]
