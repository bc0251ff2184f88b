"""TOML whose size and nesting are checked before it is parsed."""

import re
import tomllib
from pathlib import Path

from gpgrad_core.errors import InputError
from gpgrad_core.reading.text import LONGEST_NUMBER, decode_text, read_text

LARGEST = 1_000_000
"""Bytes; the files that gpgrad writes have a hundredth."""
DEEPEST = 20
"""Brackets within brackets, and parts of a dotted key. The parser follows brackets by recursion,
and for a key of 49,000 parts it needs ten gigabytes."""

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
_DIGITS = re.compile(rf"[0-9A-Fa-f_]{{{LONGEST_NUMBER + 1},}}")


def read_toml(path: Path, most_bytes: int = LARGEST) -> dict[str, object]:
    """Read a TOML file.

    Raises:
        InputError: As `parse_toml`.
        OSError: If the file cannot be read.
    """
    return parse_toml(read_text(path, most_bytes), str(path), most_bytes)


def parse_toml(content: str | bytes, where: str, most_bytes: int = LARGEST) -> dict[str, object]:
    """Parse TOML.

    Args:
        content: The text, or the bytes of it in UTF-8.
        where: The file, for the error message.
        most_bytes: The largest size.

    Raises:
        InputError: If it is too large, nested too deeply, has a number of too many digits, or is
            not TOML; the message names the file and, as far as known, the line.
    """
    if isinstance(content, str):
        content = content.encode("utf-8", "surrogatepass")
    text = decode_text(content, where, most_bytes)
    _check_shape(text, where)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: is not TOML: {error}") from None


def _check_shape(text: str, where: str) -> None:
    bare = _without_strings(text)

    def line(position: int) -> str:
        return f"{where}, line {bare.count(chr(10), 0, position) + 1}"

    depth = 0
    for bracket in _BRACKET.finditer(bare):
        depth = depth + 1 if bracket[0] in "[{" else max(0, depth - 1)
        if depth > DEEPEST:
            raise InputError(f"{line(bracket.start())}: is nested more than {DEEPEST} deep")
    for key in _KEY.finditer(bare):
        if key[0].count(".") > DEEPEST:
            raise InputError(f"{line(key.start())}: has a key of more than {DEEPEST} parts")
    digits = _DIGITS.search(bare)
    if digits:
        raise InputError(
            f"{line(digits.start())}: has a number or a key of {len(digits[0]):,} digits; "
            f"{LONGEST_NUMBER} is the most"
        )


def _without_strings(text: str) -> str:
    """Leave out comments, and put a letter for each string, since a key may be quoted.

    Then brackets, dots and digits count. Line ends stay, for their number. No pattern repeats a
    group, which would remember each turn or, if possessive, be wrong before Python 3.11.5.
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
