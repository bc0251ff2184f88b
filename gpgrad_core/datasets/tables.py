"""Rows of numbers in text: XYZ, CSV, and the ascii bodies of PLY and PCD."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError

COMMENT_MARKS = ("#", "//")


def read_text(path: Path) -> str:
    """Read a text file.

    Raises:
        InputError: If it is not text.
    """
    try:
        # Spreadsheets write a byte-order mark, which utf-8-sig removes.
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not text; is its ending right?") from None


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Write a text file, one line each; the line ends are the same on every system."""
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def read_table(path: Path) -> Float[Array, "n 3"]:
    """Read an XYZ or CSV file.

    Columns are separated by commas, semicolons, tabs or spaces. If the first row is a header, it
    must name the columns x, y and z, in any order and in lower or upper case; without a header
    they are the first three columns. Further columns are ignored, and so are empty lines and lines
    that start with ``#`` or ``//``.

    Args:
        path: The file.

    Returns:
        Positions [m], possibly none. An empty field is read as NaN.

    Raises:
        InputError: If a row lacks a column, or a field is not a number; the message names the
            line.
    """
    lines = read_text(path).splitlines()
    first = next((k for k, line in enumerate(lines) if _is_data(line)), None)
    if first is None:
        return np.empty((0, 3))
    separator = next((mark for mark in ";,\t" if mark in lines[first]), None)
    fields = _fields(lines[first], separator)
    columns = _named_columns(fields)
    if columns is not None:
        return parse_rows(lines[first + 1 :], columns, separator, path, first_line=first + 2)
    # CloudCompare writes its header as a comment with as many words as there are columns.
    for line in lines[:first]:
        words = _fields(re.sub(r"^\s*(#|//)+", "", line), separator)
        columns = columns or (_named_columns(words) if len(words) == len(fields) else None)
    return parse_rows(lines[first:], columns or (0, 1, 2), separator, path, first_line=first + 1)


def _named_columns(words: list[str]) -> tuple[int, int, int] | None:
    names = [word.lower() for word in words]
    if not all(name in names for name in "xyz"):
        return None
    return names.index("x"), names.index("y"), names.index("z")


def read_body(
    text: str,
    count: int,
    columns: tuple[int, ...],
    path: Path,
    *,
    skipped: int = 0,
    first_line: int,
) -> Float[Array, "n columns"]:
    """Read the rows of an ascii body, whose number the header gives.

    Args:
        text: Everything after the header.
        count: Number of rows according to the header.
        columns: Which columns to read, such as those of x, y and z.
        path: The file, for the error message.
        skipped: Number of lines before the rows that belong to something else.
        first_line: Number of the body's first line in the file.

    Raises:
        InputError: If there are fewer rows, a row lacks a column, or a field is not a number.
    """
    rows = text.splitlines()[skipped : skipped + count]
    whole = len(rows)
    if rows and not text.endswith("\n") and skipped + whole == len(text.splitlines()):
        # The last line has no line end: if the file is cut short, the line may lack digits.
        whole -= whole < count or len(rows[-1].split()) <= max(columns)
    if whole < count:
        raise cut_short(path, count, whole)
    return parse_rows(rows, columns, None, path, first_line=first_line + skipped)


def as_floats(
    columns: NDArray[np.floating] | NDArray[np.integer],
) -> NDArray[np.floating]:
    """Convert numbers to floats without loss: float32 stays, everything else becomes float64."""
    kept = np.float32 if columns.dtype.kind == "f" and columns.dtype.itemsize == 4 else np.float64
    return columns.astype(kept, copy=False)


def cut_short(path: Path, promised: int, found: int) -> InputError:
    """Make the error for a file with fewer points than its header says."""
    return InputError(
        f"{path}: is cut short: its header promises {promised:,} points, but the file ends after "
        f"{found:,}; copy or save it again"
    )


def parse_rows(
    lines: Sequence[str],
    columns: tuple[int, ...],
    separator: str | None,
    path: Path,
    *,
    first_line: int,
) -> Float[Array, "n columns"]:
    """Parse columns out of rows of numbers, at full precision.

    Args:
        lines: One row per line; empty lines and comments are skipped.
        columns: Which columns to read, such as those of x, y and z, counted from 0.
        separator: What separates the columns; None means spaces.
        path: The file, for the error message.
        first_line: Number of the first of these lines in the file, for the error message.

    Raises:
        InputError: If a row lacks a column, or a field is not a number.
    """
    rows = [line for line in lines if _is_data(line)]
    if not rows:
        return np.empty((0, len(columns)))
    try:
        return np.loadtxt(rows, delimiter=separator, usecols=columns, comments=None, ndmin=2)
    except ValueError:
        # NumPy's reader accepts no empty fields, and its errors do not name the file's line.
        return _parse_slowly(lines, columns, separator, path, first_line)


def _parse_slowly(
    lines: Sequence[str],
    columns: tuple[int, ...],
    separator: str | None,
    path: Path,
    first_line: int,
) -> Float[Array, "n columns"]:
    points: list[list[float]] = []
    for number, line in enumerate(lines, start=first_line):
        if not _is_data(line):
            continue
        fields = _fields(line, separator)
        if len(fields) <= max(columns):
            raise InputError(
                f"{path}, line {number}: has {len(fields)} column{'s' * (len(fields) != 1)}, "
                f"{'x, y and z need' if len(columns) == 3 else 'it needs'} {max(columns) + 1}: "
                f"{_shorten(line)!r}"
            )
        point: list[float] = []
        for column in columns:
            try:
                point.append(float(fields[column]) if fields[column] else float("nan"))
            except ValueError:
                hint = "; a header must name the columns x, y and z" if not points else ""
                raise InputError(
                    f"{path}, line {number}: {_shorten(fields[column])!r} is not a number{hint}"
                ) from None
        points.append(point)
    return np.array(points, dtype=np.float64).reshape(-1, len(columns))


def _is_data(line: str) -> bool:
    stripped = line.strip()
    return bool(stripped) and not stripped.startswith(COMMENT_MARKS)


def _fields(line: str, separator: str | None) -> list[str]:
    return [field.strip().strip('"') for field in line.split(separator)]


def _shorten(text: str) -> str:
    text = text.strip()
    return text if len(text) <= 40 else text[:39] + "…"
