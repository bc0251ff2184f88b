"""Values of JSON and TOML files as typed records: the bounds stand in the types."""

import json
import re
import sys
from collections.abc import Mapping
from typing import Annotated, TypeAlias, TypeVar, cast

import msgspec
from msgspec import Meta

from gpgrad_core.errors import InputError

Kind = TypeVar("Kind")

Finite: TypeAlias = Annotated[float, Meta(ge=-sys.float_info.max, le=sys.float_info.max)]
NotNegative: TypeAlias = Annotated[float, Meta(ge=0.0, le=sys.float_info.max)]
Count: TypeAlias = Annotated[int, Meta(ge=0, le=2**53)]
"""Whole numbers from there on are not exact in every tool's JSON."""

WORDS = {
    "int": "a whole number",
    "float": "a finite number",
    "str": "a text",
    "bool": "true or false",
    "object": "an object",
    "array": "a list",
}
"""What msgspec's names of types are to a reader."""


def as_record(
    content: object, kind: type[Kind], where: str, rules: Mapping[str, str] | None = None
) -> Kind:
    """Make a record of what a file holds.

    Args:
        content: Dictionaries, lists, texts and numbers, as a parser gives them.
        kind: The type to make; the bounds are in its annotations.
        where: The file, for the beginning of the error message.
        rules: What values of some keys must be, in words, where the type does not say it well.

    Raises:
        InputError: If a value is missing or is none that it can be; the message names its place and
            the rule, and quotes the value.
    """
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        raise InputError(_spelled(str(error), content, where, rules or {})) from None


def _spelled(error: str, content: object, where: str, rules: Mapping[str, str]) -> str:
    """Say in the words of this house what msgspec says: ``Expected `int` >= 0 - at `$.a[1].b```."""
    said, _, path = error.partition(" - at ")
    value, names = content, [where]
    got = True
    for name, index in re.findall(r"\.(\w+)|\[(\d+|\.\.\.)\]", path):
        if name:
            value = cast("dict[str, object]", value)[name]
            names.append(name)
        elif index == "...":  # some value of a table; msgspec does not say which
            names[-1], got = f"{names[-1]}[…]", False
            break
        else:
            value = cast("list[object]", value)[int(index)]
            names[-1] += f"[{index}]"
    place, key = ", ".join(names), names[-1].split("[")[0]
    if missing := re.fullmatch(r"Object missing required field `(\w+)`", said):
        return f"{place}: {missing[1]!r} is missing"
    if unknown := re.fullmatch(r"Object contains unknown field `(.+)`", said):
        return f"{place}: has the unknown key {unknown[1]!r}"
    expected = re.match(r"Expected `(\w+)[^`]*`(.*?)(?:, got .*)?$", said)
    if key in rules:
        rule = rules[key]
    elif expected:
        rule = WORDS[expected[1]] + _bound(expected[2])
    else:  # what a type says of itself
        return f"{place}: {said}"
    if len(names) == 1:
        return f"{place}: must be {rule}, got {shown(value)}"
    quoted = f", got {shown(value)}" if got else ""
    label = key if key in rules else names[-1]
    return f"{', '.join(names[:-1])}: {label!r} must be {rule}{quoted}"


def _bound(text: str) -> str:
    """Say a bound such as `` <= 5`` in words; that of all finite numbers goes without saying."""
    words = text.split()
    if words[:1] == ["of"]:
        return f" {text.strip()}"
    if len(words) != 2 or abs(float(words[1])) == sys.float_info.max:
        return ""
    return f", {float(words[1]):,.10g} or {'more' if words[0] == '>=' else 'less'}"


def shown(value: object) -> str:
    """Write a value as an error message quotes it.

    >>> shown("false"), shown(None), shown([1, 2])
    ("'false'", 'null', 'a list')
    """
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list):
        return "a list"
    text = json.dumps(value) if value is None or isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else f"{text[:59]}…"
