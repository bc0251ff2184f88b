"""Rows of numbers in text: XYZ, CSV, and the ascii bodies of PLY and PCD."""

import csv
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds.format import CloudFormat, PointCloud, cut_short, surplus
from gpgrad_core.reading.text import (
    COMMA_HINT,
    DECIMAL_COMMA,
    OWN_PLACE,
    check_unit,
    column_names,
    lines_of,
    parse_count,
    parse_number,
    read_text,
)

LEAST_NUMBERED, SAMPLE, LEAST_SHAPED, IN_CELL = 5, 1000, 100, 4
"""Least number of points whose first column can show that it numbers them, most lines that show
what the columns are, least number that can show which are terrain, and points in a cell of it."""
SURFACE, WIDE, FLAT = 0.5, 0.04, 0.01
"""Share of the variance of heights that is within cells, up to which they are a surface, and ratios
of that variance to those of x and y: what is no terrain, and what is a plain."""
SURELY = 30
"""Of more points, not all have an x of their own in whole metres."""


@dataclass(frozen=True)
class Columns:
    """How the rows of a table are read."""

    columns: tuple[int, ...]  # which columns to read, counted from 0
    width: int | None = None  # number of columns that each row must have; None if they may differ
    separator: str | None = None  # None means spaces


def read_table(path: Path, _names: Collection[str] = ()) -> PointCloud:
    """Read an XYZ or CSV file, whose columns commas, semicolons, tabs or spaces separate.

    A header names the columns x, y and z; without it they are the first three. Lines that start
    with ``#`` or ``//`` are ignored. The first row may have the number of points alone. An empty
    field is NaN.
    """
    lines = lines_of(read_text(path))
    places = [k for k, line in enumerate(lines) if _is_data(line)]
    count = parse_count(lines[places[0]].strip()) if len(places) > 1 else None
    # A column of numbers is no cloud; then the second line has one too.
    if count is None or parse_count(lines[places[1]].strip()) is not None:
        return PointCloud(_read_positions(lines, places, path))
    points = _read_positions(lines, places[1:], path)
    if len(points) < count:
        raise cut_short(path, count, len(points))
    if len(points) > count:
        raise surplus(path, count, len(points), "points")
    return PointCloud(points)


def _read_positions(lines: Sequence[str], places: Sequence[int], path: Path) -> Float[Array, "n 3"]:
    if not places:
        return np.empty((0, 3))
    first = places[0]
    separator = next((mark for mark in ";,\t" if mark in lines[first]), None)
    fields = _fields(lines[first], separator)
    columns = _named_columns(fields)
    if columns is not None:
        return _parse_rows(lines, places[1:], Columns(columns, len(fields), separator), path)
    columns = _commented_columns(lines[:first], len(fields), separator, path)
    if columns is None and separator == ",":
        _refuse_decimal_commas(lines, places, len(fields), path)
    layout = Columns(columns or (0, 1, 2), len(fields), separator)
    points = _parse_rows(lines, places, layout, path)
    if columns is None and len(fields) > 3:
        some = (_fields(lines[k], separator) for k in places[:: len(places) // SAMPLE + 1])
        further = np.array([[parse_number(text) for text in row] for row in some], np.float64)
        _refuse_doubtful(points, further, f"{path}, line {first + 1}")
    return points


def _commented_columns(
    lines: Sequence[str], width: int, separator: str | None, path: Path
) -> tuple[int, int, int] | None:
    """Find the columns that a comment names, as CloudCompare's do, with a word for each."""
    doubtful = ""
    for number, line in enumerate(lines, start=1):
        where, names = f"{path}, line {number}", column_names(line)
        if not set("xyz") <= set(names):
            names = [name[-1] if OWN_PLACE.fullmatch(name[:-1]) else name for name in names]
        for words in (_fields(re.sub(r"^\s*(#|//)+", "", line), separator), names):
            columns = _named_columns(words)
            if columns is None:
                continue
            check_unit(line, where)
            if len(words) == width and (
                words is not names or all(names.count(axis) == 1 for axis in "xyz")
            ):
                return columns
            doubtful = doubtful or where * (list(columns) != sorted(columns))
    if doubtful:
        raise InputError(
            f"{doubtful}: names x, y and z in another order, but not each of the {width} columns; "
            "name the columns in a first line, with one name a column, or remove the comment"
        )
    return None


def _refuse_doubtful(
    points: Float[Array, "n 3"], sample: Float[Array, "m columns"], where: str
) -> None:
    """Refuse columns without names if the first seems to be no x; a sample has all columns."""
    decimals = bool((np.nan_to_num(sample[:, 3]) % 1).any())
    unit = np.linalg.norm(sample[:, 3:6], axis=1)
    if sample.shape[1] > 5 and np.allclose(unit, 1.0, atol=0.01):
        return  # normals follow x, y and z
    if _are_numbers_of_points(points, decimals=decimals):
        what, name = "to number the points", "id"
    elif _are_rows_and_columns(sample):
        what, name = "to be no x but the number of a row, and the next that of a column", "row,col"
    elif decimals and (_are_times(points) or _is_terrain_later(sample)):
        what, name = "to be no x but a time or a strength, for instance", "t"
    else:
        return
    raise InputError(
        f"{where}: the first column seems {what}; name the columns in a first line: "
        f"{name},x,y,z,… if so, or x,y,z,… if it is x"
    )


def _are_rows_and_columns(sample: Float[Array, "m columns"]) -> bool:
    """Whether two columns of whole numbers are before three that have decimals."""
    decimals = (np.nan_to_num(sample[:, :5]) % 1 != 0).any(axis=0).tolist()
    return len(sample) >= LEAST_NUMBERED and decimals == [False, False, True, True, True]


def _are_times(points: Float[Array, "n 3"]) -> bool:
    """Whether the first column goes up or down throughout, and no grid is sorted by x and y."""
    steps = np.diff(points[np.isfinite(points).all(axis=1), :2], axis=0)
    ways = np.unique(np.sign(steps[steps[:, 0] != 0, 0]))
    across = np.unique(np.sign(steps[steps[:, 0] == 0, 1]))
    by_both = len(across) > 0 and len(across[across != 0]) < 2
    return len(steps) >= LEAST_NUMBERED - 1 and len(ways) == 1 and not by_both


def _is_terrain_later(sample: Float[Array, "m columns"]) -> bool:
    """Whether three later columns are terrain, and the first three are not."""
    loose, height = _shape(sample[:, :3])
    if not (loose > SURFACE and height > WIDE):
        return False
    later = (_shape(sample[:, k : k + 3]) for k in range(1, sample.shape[1] - 2))
    return any(0 < loose < SURFACE or 0 < height < FLAT for loose, height in later)


def _shape(points: Float[Array, "n 3"]) -> tuple[float, float]:
    """Measure the share of the heights' variance within cells, and its ratio to that of x or y."""
    points = points[np.isfinite(points).all(axis=1)]
    x, y, height = points.var(axis=0).tolist() if len(points) >= LEAST_SHAPED else (0.0, 0.0, 0.0)
    if height == 0:
        return 0.0, 0.0
    side = int((len(points) / IN_CELL) ** 0.5)
    strip = np.argsort(np.argsort(points[:, 0], kind="stable")) * side // len(points)
    cells = np.array_split(points[np.lexsort((points[:, 1], strip)), 2], side**2)
    within = float(np.mean([cell.var(ddof=1) for cell in cells]))
    return within / height, height / max(min(x, y), 1e-9 * height)


def _are_numbers_of_points(points: Float[Array, "n 3"], *, decimals: bool) -> bool:
    """Whether the first column seems to be no x, but a number of each point or of some.

    It holds whole numbers. Either some are missing; or they count up or down, or are different
    where others are not; or the next ones have decimals, or the third has none where the fourth
    has `decimals`, as heights do.
    """
    numbers, rest = points[:, 0], points[:, 1:]
    finite = np.isfinite(numbers)
    if len(points) < LEAST_NUMBERED or (numbers[finite] % 1 != 0).any():
        return False
    if not finite.all():
        return bool(np.isfinite(rest[~finite]).all())
    with np.errstate(invalid="ignore"):
        y, z = (rest % 1 != 0).any(axis=0)
    different = len(np.unique(numbers)) == len(numbers)
    if different and (y or len(np.unique(np.diff(numbers))) == 1 or len(points) > SURELY):
        return True
    return bool(decimals and (y or not z))


def _refuse_decimal_commas(
    lines: Sequence[str], places: Sequence[int], width: int, path: Path
) -> None:
    """Refuse commas that are, or may be, those of numbers: ``3,158,8,503`` has 2 or 4 columns."""
    words = lines[places[0]].split()
    what = f"{path}, line {places[0] + 1}: {_shorten(lines[places[0]])!r}"
    if len(words) > 1 and all(DECIMAL_COMMA.fullmatch(word) for word in words):
        raise InputError(f"{what}: {COMMA_HINT}")
    # If no number has a point, every second comma may stand for one.
    if width > 3 and not any("." in lines[k] for k in places):
        raise InputError(
            f"{what} may be {width} whole numbers, or fewer with decimal commas: {COMMA_HINT}; if "
            "they are whole numbers, name the columns in a header: x,y,z,…"
        )


def _named_columns(words: list[str]) -> tuple[int, int, int] | None:
    names = [word.lower() for word in words]
    if not all(name in names for name in "xyz"):
        return None
    return names.index("x"), names.index("y"), names.index("z")


def read_body(
    data: bytes,
    count: int,
    layout: Columns,
    path: Path,
    *,
    before: int = 0,
    after: int = 0,
    first_line: int,
) -> Float[Array, "n columns"]:
    """Read the rows of an ascii body; rows of something else may lie before and after them."""
    if b"\0" in data:
        raise InputError(f"{path}: its header says 'ascii', but zero bytes follow; save it again")
    lines = lines_of(data.decode("latin-1"))
    places = [k for k, line in enumerate(lines) if line and not line.isspace()]
    held = len(places)
    if lines and places and places[-1] == len(lines) - 1 and not data.endswith((b"\n", b"\r")):
        # The last row has no line end: if the file is cut short, the row may lack digits.
        least = layout.width or max(layout.columns) + 1
        whole = held == before + count + after
        held -= not whole or (not after and len(lines[-1].split()) < least)
    if held < before + count:
        raise cut_short(path, count, max(0, held - before))
    if held < before + count + after:
        raise InputError(
            f"{path}: is cut short: its header promises {before + count + after:,} rows, but the "
            f"file ends after {held:,}; copy or save it again"
        )
    if held > before + count + after:
        raise surplus(path, before + count + after, held, "rows")
    return _parse_rows(lines, places[before : before + count], layout, path, first_line)


def _parse_rows(
    lines: Sequence[str], places: Sequence[int], layout: Columns, path: Path, first_line: int = 1
) -> Float[Array, "n columns"]:
    """Parse columns out of the rows at some places, at full precision."""
    rows = [lines[k] for k in places]
    if not rows:
        return np.empty((0, len(layout.columns)))
    try:
        if all(_has_width(row, layout) for row in rows):
            return np.loadtxt(
                rows, delimiter=layout.separator, usecols=layout.columns, comments=None, ndmin=2
            )
    except ValueError:
        pass
    # NumPy's reader accepts no empty fields, and its errors do not name the file's line.
    points = [
        _parse_row(lines[k], layout, f"{path}, line {first_line + k}", is_first=k == places[0])
        for k in places
    ]
    return np.array(points, dtype=np.float64).reshape(-1, len(layout.columns))


def _has_width(row: str, layout: Columns) -> bool:
    if layout.width is None:
        return True
    if layout.separator is None:
        return len(row.split()) == layout.width
    return '"' not in row and row.count(layout.separator) == layout.width - 1


def _parse_row(line: str, layout: Columns, where: str, *, is_first: bool) -> list[float]:
    fields = _fields(line, layout.separator)
    width, least = len(fields), max(layout.columns) + 1
    if width < least:
        needs = "x, y and z need" if len(layout.columns) == 3 else "it needs"
        raise InputError(f"{where}: {_has(width)}, {needs} {least}: {_shorten(line)!r}")
    point: list[float] = []
    for column in layout.columns:
        value = parse_number(fields[column]) if fields[column] else float("nan")
        if value is None:
            hint = "; a header must name the columns x, y and z" if is_first else ""
            if DECIMAL_COMMA.fullmatch(fields[column]):
                hint = f"; {COMMA_HINT}"
            raise InputError(f"{where}: {_shorten(fields[column])!r} is not a number{hint}")
        point.append(value)
    if layout.width is not None and width != layout.width:
        hint = f"; {COMMA_HINT}" if layout.separator == "," and width > layout.width else ""
        raise InputError(
            f"{where}: {_has(width)}, but the table has {layout.width}: {_shorten(line)!r}{hint}"
        )
    return point


def _has(columns: int) -> str:
    return f"has {columns} column{'s' * (columns != 1)}"


def _is_data(line: str) -> bool:
    stripped = line.strip()
    return bool(stripped) and not stripped.startswith(("#", "//"))


def _fields(line: str, separator: str | None) -> list[str]:
    if separator is not None and '"' in line:
        try:
            (split,) = csv.reader([line], delimiter=separator, skipinitialspace=True)
        except (csv.Error, ValueError):  # a quote that does not end
            split = line.split(separator)
        return [field.strip() for field in split]
    return [field.strip().strip('"') for field in line.split(separator)]


def _shorten(text: str) -> str:
    text = text.strip()
    return text if len(text) <= 40 else text[:39] + "…"


HOLDS = "a table of numbers; a first row may name the columns x, y and z"
CSV, XYZ = (CloudFormat(ending, HOLDS, read_table) for ending in (".csv", ".xyz"))
