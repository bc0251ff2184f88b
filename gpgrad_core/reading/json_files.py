"""JSON whose size and nesting are checked before it is parsed, and its values one by one."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from gpgrad_core.errors import InputError
from gpgrad_core.reading.text import LONGEST_NUMBER, read_text

LARGEST = 256_000_000
"""Bytes; ``closures.json`` of 900 submaps, every pair compared, is as large."""
DEEPEST = 32
"""Brackets within brackets; the parser follows them by recursion."""

_STRINGS = re.compile(rb'"[^"]*"?')
_NOT_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))
_DIGITS = re.compile(rb"[0-9]{%d,}" % (LONGEST_NUMBER + 1))
MAX_COUNT = 2**53
"""Whole numbers from there on are not exact in every tool's JSON."""


def read_json(path: Path, most_bytes: int = LARGEST) -> object:
    """Read a JSON file.

    Raises:
        InputError: As `parse_json`.
        OSError: If the file cannot be read.
    """
    return parse_json(read_text(path, most_bytes), str(path))


def parse_json(text: str, where: str) -> object:
    """Parse JSON, without the NaN and Infinity that Python's reader would take.

    Args:
        text: The text.
        where: The file, for the error message.

    Raises:
        InputError: If it is nested too deeply, has a number of too many digits, names a key twice,
            or is not JSON; the message names the file and, as far as known, the line.
    """
    _check_shape(text.encode("utf-8", "surrogatepass"), where)

    def refuse(word: str) -> float:
        raise InputError(f"{where}: holds {word}, which is not JSON")

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for k, name in enumerate(names) if name in names[:k])
            raise InputError(f"{where}: has the key {twice[:40]!r} twice in one place")
        return found

    try:
        return json.loads(text, parse_constant=refuse, object_pairs_hook=once)
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: not a JSON file: {error}") from None


def _check_shape(data: bytes, where: str) -> None:
    # Without its escaped backslashes, then quotes, a string ends at the next quote. Where a
    # backslash is outside of a string, the parser goes no further.
    bare = _STRINGS.sub(b"", data.replace(b"\\\\", b"").replace(b'\\"', b""))
    marks = np.frombuffer(bare.translate(None, _NOT_BRACKETS), np.uint8)
    steps = np.where((marks == ord("[")) | (marks == ord("{")), 1, -1)
    if len(steps) and int(np.cumsum(steps, dtype=np.int64).max()) > DEEPEST:
        raise InputError(f"{where}: is nested more than {DEEPEST} deep")
    digits = _DIGITS.search(bare)
    if digits:
        raise InputError(
            f"{where}: has a number of {len(digits[0]):,} digits; {LONGEST_NUMBER} is the most"
        )


@dataclass(frozen=True)
class Record:
    """An object of a JSON file whose values are read with their types and bounds.

    Attributes:
        values: The object.
        where: The file, and where in it the object is: the beginning of every error message.
    """

    values: Mapping[str, Any]
    where: str

    @classmethod
    def of(cls, value: object, where: str) -> "Record":
        """Make a record of a JSON object.

        Raises:
            InputError: If it is something else.
        """
        if not isinstance(value, dict):
            raise InputError(f"{where}: must be an object, {{…}}, got {shown(value)}")
        return cls(cast("dict[str, Any]", value), where)

    def get(self, key: str) -> Any:
        """Give a value of any type.

        Raises:
            InputError: If the key is missing.
        """
        if key not in self.values:
            raise InputError(f"{self.where}: {key!r} is missing")
        return self.values[key]

    def text(self, key: str) -> str:
        """Give a text.

        Raises:
            InputError: If there is none.
        """
        value = self.get(key)
        if not isinstance(value, str):
            raise self.wrong(key, "a text")
        return value

    def flag(self, key: str) -> bool:
        """Give true or false.

        Raises:
            InputError: If there is something else, the text "false" for instance.
        """
        value = self.get(key)
        if not isinstance(value, bool):
            raise self.wrong(key, "true or false")
        return value

    def count(self, key: str, most: int = MAX_COUNT) -> int:
        """Give a whole number from 0 to ``most``.

        Raises:
            InputError: If there is something else.
        """
        value = self.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
            raise self.wrong(key, f"a whole number from 0 to {most:,}")
        return value

    def number(self, key: str, low: float = -math.inf, high: float = math.inf) -> float:
        """Give a finite number within bounds.

        Raises:
            InputError: If there is something else.
        """
        value = self.get(key)
        if not is_number(value) or not low <= value <= high:
            within = "" if low == -math.inf and high == math.inf else f" from {low:g} to {high:g}"
            raise self.wrong(key, f"a finite number{within}")
        return float(value)

    def optional_number(self, key: str, low: float = -math.inf) -> float | None:
        """Give a finite number, or None where the key is missing or null.

        Raises:
            InputError: If there is something else.
        """
        return None if self.values.get(key) is None else self.number(key, low)

    def record(self, key: str) -> "Record":
        """Give an object.

        Raises:
            InputError: If there is none.
        """
        return Record.of(self.get(key), f"{self.where}, {key}")

    def records(self, key: str) -> "list[Record]":
        """Give a list of objects.

        Raises:
            InputError: If there is something else.
        """
        value = self.get(key)
        if not isinstance(value, list):
            raise self.wrong(key, "a list")
        entries = cast("list[object]", value)
        return [Record.of(entry, f"{self.where}, {key}[{k}]") for k, entry in enumerate(entries)]

    def wrong(self, key: str, rule: str) -> InputError:
        """Make the error of a value that breaks a rule."""
        return InputError(f"{self.where}: {key!r} must be {rule}, got {shown(self.values[key])}")


def is_number(value: object) -> bool:
    """Say whether a value is a finite number; true and false are none."""
    # A whole number may be too large for a float; 64 digits are not.
    return not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value)


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
