"""Text and the numbers in it."""

import math
import re
from collections.abc import Iterable
from pathlib import Path

from gpgrad_core.errors import InputError
from gpgrad_core.reading.files import open_regular

NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|[+-]?(?:nan|inf)", re.I)
"""What counts as a number. Python itself would also take 1_000 and the digits of other scripts."""
DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+")
LONGEST_NUMBER = 64
"""Digits of a whole number; Python turns 5,000 digits into an error of its own."""
LENGTH = (
    r"[cdkmnuµμ]m|(?:milli|centi|deci|kilo|micro|nano)met\w+|ft|feet|foot|inch(?:es)?"
    r"|in(?=\s*[\])])|miles?|mi|yards?|yd"
)
OTHER_UNIT = re.compile(rf"(?<![a-z0-9]{{2}})[wxyz](?:_|\s*[\[(]\s*(?:in\s+)?)({LENGTH})\b")
"""A unit of length that is not the metre, after the name of an axis: ``tx [mm]`` or ``x_cm``."""
OWN_PLACE = re.compile(r"(.*\.)?([pt]\w*\.?)?")
"""What is before the last letter of ``x``, ``tx``, ``p_x`` or ``pose.position.x``."""
COMMA_HINT = "write decimal points instead of decimal commas: 3.158, not 3,158"


def read_text(path: Path, most_bytes: int | None = None) -> str:
    """Read a text file; InputError if it is not UTF-8, or larger than allowed."""
    with open_regular(path) as file:
        data = file.read() if most_bytes is None else file.read(most_bytes + 1)
    return decode_text(data, str(path), most_bytes)


def decode_text(data: bytes, where: str, most_bytes: int | None = None) -> str:
    """Decode a text file's content; see `read_text`."""
    if most_bytes is not None and len(data) > most_bytes:
        raise InputError(f"{where}: is larger than {most_bytes:,} bytes, the most for such a file")
    try:
        # Spreadsheets write a byte-order mark, which utf-8-sig removes.
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{where}: is not text in UTF-8 (byte {error.start:,}); is its ending right?"
        ) from None
    if "\0" in text:
        raise InputError(
            f"{where}: is not text: it holds a zero byte (character {text.index(chr(0)):,}); "
            "is its ending right?"
        )
    return text


def lines_of(text: str) -> list[str]:
    r"""Split text at the line ends of any system, and at nothing else.

    >>> lines_of("a\r\nb\x0bc\n")
    ['a', 'b\x0bc']
    """
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if not lines[-1]:
        lines.pop()
    return lines


def split_rows(
    path: Path, most_bytes: int | None = None, *, comment: str | None = "#"
) -> list[tuple[str, list[str]]]:
    """Split each row into words between spaces or commas, with its place for error messages."""
    if not path.exists():
        raise InputError(f"{path}: no such file")
    rows: list[tuple[str, list[str]]] = []
    for number, line in enumerate(lines_of(read_text(path, most_bytes)), start=1):
        row = line if comment is None else line.split(comment, 1)[0]
        words = row.split()
        if not any(map(DECIMAL_COMMA.fullmatch, words)):
            words = row.replace(",", " ").split()
        if words:
            rows.append((f"{path}, line {number}", words))
    return rows


def column_names(line: str) -> list[str]:
    """Find the words of a line that may name columns, in small letters and without units.

    >>> column_names("# fields: P_x [m], P_y(m); rotation (w, x)")
    ['p_x', 'p_y', 'rotation', 'w', 'x']
    """
    line = re.sub(r"^\W*(fields?|columns?|names?|header)\s*[:=]", "", line.lower())
    line = re.sub(r"[\[(](?!\s*[wxyz]([\s,]+[wxyz])+\s*[\])]).*?[\])]", " ", line)
    return [
        re.sub(rf"_(m|met\w+|{LENGTH})$", "", word)
        for word in re.findall(r"[a-z_]\w*(?:\.\w+)*", line)
    ]


def check_unit(line: str, where: str) -> None:
    """Refuse a line that names columns in another unit of length than metres."""
    unit = OTHER_UNIT.search(line.lower())
    if unit:
        raise InputError(f"{where}: names columns in {unit[1]}; give metres, and say [m] there")


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Write a text file, one line each; the line ends are the same on every system."""
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def parse_number(word: str) -> float | None:
    """Read a number; None if the word is not one.

    >>> parse_number("1e3"), parse_number("1_000")
    (1000.0, None)
    """
    return float(word) if NUMBER.fullmatch(word) else None


def parse_numbers(words: list[str], where: str) -> list[float]:
    """Parse the columns of a row; InputError, from `where` on, if one is no finite number."""
    values: list[float] = []
    for word in words:
        value = parse_number(word)
        if value is None:
            hint = f"; {COMMA_HINT}" if DECIMAL_COMMA.fullmatch(word) else ""
            raise InputError(f"{where}: holds something that is not a number: {word[:40]!r}{hint}")
        values.append(value)
    if not all(map(math.isfinite, values)):
        raise InputError(f"{where}: holds a value that is not finite")
    return values


def parse_count(word: str) -> int | None:
    """Read a whole number, 0 or more; None if the word is not one, or is one of absurd size."""
    return int(word) if len(word) <= 18 and word.isascii() and word.isdecimal() else None
