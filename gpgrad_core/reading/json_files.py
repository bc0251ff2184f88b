"""JSON whose size and nesting are checked before it is parsed."""

import json
import re
from pathlib import Path

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
