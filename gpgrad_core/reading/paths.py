"""Names of files: their order and numbers, checks of those from outside, and different ones."""

import re
import unicodedata
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath

from gpgrad_core.errors import InputError

LONGEST_NAME = 200
"""Bytes of one name; file systems take 255, and endings are added."""
DEEPEST, DEEPEST_OF_ALL = 20, 500
"""Most folders within folders: of a name from outside, and of any path, before Python's functions
exhaust their recursion."""
TIME = re.compile(r"(?:\d\.|(?<!\d)\d{9,10}[_-])(\d{1,9})(?!\d)")
"""A time in a name, from before the point, underscore or dash that its parts of a second follow."""
DAY = r"(?<!\d)(?:\d{4}(?:[_-]\d\d){2}[_T-]\d\d(?:[_-]\d\d){2}|\d{8}[_T-]\d{6})(?!\d)"
"""Day and time in a name: year, month, day, hour, minute, second."""
NUMBER = re.compile(DAY + r"|(?<!\d)\d{9,10}[_-]\d{9}(?!\d)|\d+(?:\.\d+)?")
"""A number in a name; day and time are one, and so are seconds and nanoseconds."""
NANOSECONDS = 8
"""Digits of a second from which on they may be a whole number of nanoseconds."""


def check_path(path: Path | str) -> Path:
    """Check that the system can look a path up, and that its name can be written."""
    path = Path(path)
    if "\0" in str(path):
        raise InputError(f"{_short(str(path))}: a path cannot hold a zero byte")
    check_depth(path)
    try:
        path.exists()
    except OSError as error:
        raise InputError(
            f"{_short(str(path))}: cannot be read: {error.strerror or error}"
        ) from None
    if any(unicodedata.category(character) == "Cs" for character in path.absolute().name):
        raise InputError(f"{path}: this name is not UTF-8; rename it")
    return path


def check_depth(path: Path) -> None:
    """Raise InputError for more than `DEEPEST_OF_ALL` folders, which Python cannot follow."""
    if (deep := len(path.parts)) > DEEPEST_OF_ALL:
        raise InputError(
            f"{_short(str(path))}: lies {deep:,} folders deep; {DEEPEST_OF_ALL} is the most"
        )


def check_name(name: str) -> PurePosixPath:
    """Check a relative path that a page or an archive gives, before a file is made of that name."""
    place = PurePosixPath(name.replace("\\", "/"))
    if place.is_absolute() or ".." in place.parts or ":" in name or not place.parts:
        raise InputError(f"names a path outside of its folder: {_short(name)}")
    if any(unicodedata.category(character) in ("Cc", "Cs") for character in name):
        raise InputError(f"the name {_short(name)} holds a control character; rename it")
    if len(place.parts) > DEEPEST:
        raise InputError(
            f"{_short(name)} lies {len(place.parts):,} folders deep; {DEEPEST} is the most"
        )
    if any(len(part.encode("utf-8", "surrogatepass")) > LONGEST_NAME for part in place.parts):
        raise InputError(f"the name {_short(name)} is longer than {LONGEST_NAME} bytes; rename it")
    return place


def _short(name: str) -> str:
    return repr(name if len(name) <= 60 else f"{name[:59]}…")


def different_names(names: Iterable[str], before_number: str = "-") -> tuple[str, ...]:
    """Make equal names different by adding a number.

    >>> different_names(["yard", "crater", "yard"])
    ('yard', 'crater', 'yard-2')
    """
    unique: list[str] = []
    for name in names:
        count, different = 1, name
        while different in unique:
            count += 1
            different = f"{name}{before_number}{count}"
        unique.append(different)
    return tuple(unique)


def file_names(names: Iterable[str], nameless: str) -> tuple[str, ...]:
    """Make parts of file names, all different.

    >>> file_names(["a b", "a/b", "../"], "method")
    ('a_b', 'a_b_2', 'method')
    """
    plain = (re.sub(r"[^\w-]+", "_", name).strip("_") or nameless for name in names)
    return different_names(plain, "_")


def in_order(files: Sequence[Path]) -> list[Path]:
    """Sort files by their names, in which numbers count as such.

    >>> [file.name for file in in_order([Path("10.ply"), Path("2.ply")])]
    ['2.ply', '10.ply']
    """

    def key(file: Path) -> tuple[list[tuple[str, int]], Path]:
        pieces = re.findall(r"([^0-9]*)([0-9]*)", file.name)
        return [(text, int(digits or -1)) for text, digits in pieces], file

    return sorted(files, key=key)


def order_notes(files: Sequence[Path], rows: str) -> tuple[str, ...]:
    """Describe how files belong to as many rows, unless their names number the rows from 0."""
    numbers = [re.findall("[0-9]+", file.stem)[-1:] for file in files]
    if [int(number[0]) if number else None for number in numbers] == [*range(len(files))]:
        return ()
    return (
        f"the {rows} belong to the files in the order of their names: the first to "
        f"{files[0].name}, the last to {files[-1].name}",
    )


def seconds_in(name: str) -> tuple[str, str] | None:
    """Find the time at the end of a name: its seconds, and the decimals of a second.

    >>> seconds_in("cloud_1311868164_363181000"), seconds_in("1700000000.25"), seconds_in("map_7")
    (('1311868164', '363181000'), ('1700000000', '25'), None)
    """
    time = re.search(r"(?<!\d)(\d{9,10})(?:\.(\d{1,9})|[_-](\d{9}))$", name)
    return None if time is None else (time[1], time[2] or time[3])


def with_distinct_numbers(names: Sequence[str]) -> list[str]:
    """Shorten names so that each ends with the number by which it differs from the others.

    Names whose last numbers differ stay as they are; and so do all, if no number differs in all of
    them. Nanoseconds without leading zeros get them.

    >>> with_distinct_numbers(["map_0_voxel0.05", "map_1_voxel0.05"])
    ['map_0', 'map_1']
    """
    names = with_nanoseconds(names)
    numbers = [[*NUMBER.finditer(name)][::-1] for name in names]
    if len({*map(len, numbers)}) != 1:
        return list(names)
    for place, column in enumerate(zip(*numbers, strict=True)):  # the last number comes first
        if len({_value(number[0]) for number in column}) == len(names):
            return [n[0].string[: n[place].end()] if place else n[0].string for n in numbers]
    return list(names)


def _value(number: str) -> float:
    parts = re.split("[_T-]", number)
    return float(".".join(parts) if len(parts[0]) > 8 else "".join(parts))


def with_nanoseconds(names: Sequence[str]) -> Sequence[str]:
    """Write out leading zeros of nanoseconds; InputError if they may be decimals.

    >>> with_nanoseconds(["1700000000_5_v2", "1700000000_50000000_v2"])
    ['1700000000_000000005_v2', '1700000000_050000000_v2']
    """
    # A version may follow the time.
    for times in zip(*([*TIME.finditer(name)][::-1] for name in names), strict=False):
        parts, after_point = [time[1] for time in times], "." in times[0][0]
        wrote_zeros = any(part.startswith("0") and part != "0" for part in parts)
        widths = {*map(len, parts)}
        if wrote_zeros or max(widths) < NANOSECONDS or (len(widths) < 2 and after_point):
            continue
        if after_point and not any(part.endswith("0") and part != "0" for part in parts):
            raise InputError(
                f"{names[0]} and so on: the digits after the point may be decimals of a second or "
                "nanoseconds; write nine digits in each"
            )
        pairs = zip(times, parts, strict=True)
        return [f"{t.string[: t.start(1)]}{part:0>9}{t.string[t.end(1) :]}" for t, part in pairs]
    return names
