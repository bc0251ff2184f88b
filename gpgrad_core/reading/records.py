"""JSON and TOML files, bounded before they are parsed, and their values as typed records.

A record is a dataclass or a ``msgspec.Struct``; `as_record` makes it of what a parser gives, and
`as_builtins` makes of it what a writer takes.
"""

import json
import re
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias, TypeVar, cast

import msgspec
import numpy as np
from msgspec import Meta

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.reading.text import LONGEST_NUMBER, decode_text, read_text

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
LARGEST_TOML = 1_000_000
"""Bytes; the files that gpgrad writes have a hundredth."""
DEEPEST_TOML = 20
"""Most brackets within brackets, and parts of a dotted key: the parser recurses, and a key of
49,000 parts needs ten gigabytes."""
_OPENING = re.compile(r'"""|\'\'\'|["\'#]')
_CLOSING = {
    '"""': re.compile(r'\\.|"{3,5}', re.DOTALL),
    "'''": re.compile(r"'{3,5}"),
    '"': re.compile(r'\\.|"|(?=\n)', re.DOTALL),
    "'": re.compile(r"'|(?=\n)"),
    "#": re.compile(r"(?=\n)"),
}
"""What ends each kind of string, and a comment; a backslash takes the next character with it."""
_BRACKET = re.compile(r"[\[\]{}]")
_KEY = re.compile(r"[\w\-. \t]+")
_TOML_DIGITS = re.compile(rf"[0-9A-Fa-f_]{{{LONGEST_NUMBER + 1},}}")
LARGEST_JSON = 256_000_000
"""Bytes; ``closures.json`` of 900 submaps, every pair compared, is as large."""
DEEPEST_JSON = 32
"""Brackets within brackets; the parser follows them by recursion."""
_STRINGS = re.compile(rb'"[^"]*"?')
_NOT_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))
_JSON_DIGITS = re.compile(rb"[0-9]{%d,}" % (LONGEST_NUMBER + 1))


def as_record(
    content: object, kind: type[Kind], where: str, rules: Mapping[str, str] | None = None
) -> Kind:
    """Make a record of what a file holds; an InputError names the place, the rule and the value."""
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        raise InputError(_message_of(str(error), content, where, rules or {})) from None


def as_builtins(record: Any) -> Any:
    """Make dictionaries, lists and plain numbers of records and of arrays, for any format."""
    return msgspec.to_builtins(record, enc_hook=_of_numpy)


def _of_numpy(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return cast("NDArray[np.generic]", value).tolist()
    raise TypeError(f"a {type(value).__qualname__} cannot be written")


def _message_of(error: str, content: object, where: str, rules: Mapping[str, str]) -> str:
    """Word what msgspec says: ``Expected `int` >= 0 - at `$.a[1].b```."""
    problem, _, path = error.partition(" - at ")
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
    if missing := re.fullmatch(r"Object missing required field `(\w+)`", problem):
        return f"{place}: {missing[1]!r} is missing"
    if unknown := re.fullmatch(r"Object contains unknown field `(.+)`", problem):
        return f"{place}: has the unknown key {unknown[1]!r}"
    expected = re.match(r"Expected `(\w+)[^`]*`(.*?)(?:, got .*)?$", problem)
    if key in rules:
        rule = rules[key]
    elif expected:
        rule = WORDS[expected[1]] + _bound(expected[2])
    else:  # what a type says of itself
        return f"{place}: {problem}"
    if len(names) == 1:
        return f"{place}: must be {rule}, got {shown(value)}"
    quoted = f", got {shown(value)}" if got else ""
    label = key if key in rules else names[-1]
    return f"{', '.join(names[:-1])}: {label!r} must be {rule}{quoted}"


def _bound(text: str) -> str:
    """Word a bound such as `` <= 5`` in words; that of all finite numbers goes without saying."""
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


def read_toml(path: Path) -> dict[str, object]:
    """Read a TOML file."""
    return parse_toml(read_text(path, LARGEST_TOML), str(path))


def parse_toml(
    content: str | bytes, where: str, most_bytes: int = LARGEST_TOML
) -> dict[str, object]:
    """Parse TOML."""
    if isinstance(content, str):
        content = content.encode("utf-8", "surrogatepass")
    text = decode_text(content, where, most_bytes)
    _check_toml(text, where)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: is not TOML: {error}") from None


def _check_toml(text: str, where: str) -> None:
    bare = _without_strings(text)

    def line(position: int) -> str:
        return f"{where}, line {bare.count(chr(10), 0, position) + 1}"

    depth = 0
    for bracket in _BRACKET.finditer(bare):
        depth = depth + 1 if bracket[0] in "[{" else max(0, depth - 1)
        if depth > DEEPEST_TOML:
            raise InputError(f"{line(bracket.start())}: is nested more than {DEEPEST_TOML} deep")
    for key in _KEY.finditer(bare):
        if key[0].count(".") > DEEPEST_TOML:
            raise InputError(f"{line(key.start())}: has a key of more than {DEEPEST_TOML} parts")
    digits = _TOML_DIGITS.search(bare)
    if digits:
        raise InputError(
            f"{line(digits.start())}: has a number or a key of {len(digits[0]):,} digits; "
            f"{LONGEST_NUMBER} is the most"
        )


def _without_strings(text: str) -> str:
    """Drop comments and replace each string by a letter, so that only syntax remains.

    Line ends stay, for their number. No pattern repeats a group, which would remember each turn or,
    if possessive, be wrong before Python 3.11.5.
    """
    pieces: list[str] = []
    end = 0
    while opening := _OPENING.search(text, end):
        pieces.append(text[end : opening.start()])
        marks = _CLOSING[opening[0]].finditer(text, opening.end())
        end = next((mark.end() for mark in marks if mark[0][:1] != "\\"), len(text))
        if opening[0] != "#":
            pieces.append("s" + "\n" * text.count("\n", opening.start(), end))
    return "".join([*pieces, text[end:]])


def read_json(path: Path, most_bytes: int = LARGEST_JSON) -> object:
    """Read a JSON file."""
    return parse_json(read_text(path, most_bytes), str(path))


def parse_json(text: str, where: str) -> object:
    """Parse JSON, without the NaN and Infinity that Python's reader would take."""
    _check_json(text.encode("utf-8", "surrogatepass"), where)

    def refuse(word: str) -> float:
        raise InputError(f"{where}: holds {word}, which is not JSON")

    def once(pairs: list[tuple[str, object]]) -> dict[str, object]:
        table = dict(pairs)
        if len(table) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for k, name in enumerate(names) if name in names[:k])
            raise InputError(f"{where}: has the key {twice[:40]!r} twice in one place")
        return table

    try:
        return json.loads(text, parse_constant=refuse, object_pairs_hook=once)
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: not a JSON file: {error}") from None


def _check_json(data: bytes, where: str) -> None:
    # Without its escaped backslashes, then quotes, a string ends at the next quote. Where a
    # backslash is outside of a string, the parser goes no further.
    bare = _STRINGS.sub(b"", data.replace(b"\\\\", b"").replace(b'\\"', b""))
    marks = np.frombuffer(bare.translate(None, _NOT_BRACKETS), np.uint8)
    steps = np.where((marks == ord("[")) | (marks == ord("{")), 1, -1)
    if len(steps) and int(np.cumsum(steps, dtype=np.int64).max()) > DEEPEST_JSON:
        raise InputError(f"{where}: is nested more than {DEEPEST_JSON} deep")
    digits = _JSON_DIGITS.search(bare)
    if digits:
        raise InputError(
            f"{where}: has a number of {len(digits[0]):,} digits; {LONGEST_NUMBER} is the most"
        )
