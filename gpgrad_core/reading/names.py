"""The order of files, and the numbers in their names."""

import re
from collections.abc import Sequence
from pathlib import Path

from gpgrad_core.errors import InputError

TIME = re.compile(r"(?:\d\.|(?<!\d)\d{9,10}_)(\d{1,9})$")
"""The end of a name that is a time: its parts of a second, after a point or an underscore."""
NANOSECONDS = 8
"""Digits of a second from which on they may be a whole number of nanoseconds."""


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
    """Say how files belong to as many rows, unless their names number the rows from 0."""
    numbers = [re.findall("[0-9]+", file.stem)[-1:] for file in files]
    if [int(number[0]) if number else None for number in numbers] == [*range(len(files))]:
        return ()
    return (
        f"the {rows} belong to the files in the order of their names: the first to "
        f"{files[0].name}, the last to {files[-1].name}",
    )


def with_distinct_numbers(names: Sequence[str]) -> list[str]:
    """Shorten names so that each ends with the number by which it differs from the others.

    Names whose last numbers differ stay as they are; and so do all, if no number differs in all of
    them. Nanoseconds without leading zeros get them.

    >>> with_distinct_numbers(["map_0_voxel0.05", "map_1_voxel0.05"])
    ['map_0', 'map_1']
    """
    names = with_nanoseconds(names)
    numbers = [[*re.finditer(r"\d+(?:\.\d+)?", name)][::-1] for name in names]
    if len({*map(len, numbers)}) != 1:
        return list(names)
    for place, column in enumerate(zip(*numbers, strict=True)):  # the last number comes first
        if len({float(number[0]) for number in column}) == len(names):
            return [n[0].string[: n[place].end()] if place else n[0].string for n in numbers]
    return list(names)


def with_nanoseconds(names: Sequence[str]) -> Sequence[str]:
    """Write out leading zeros of nanoseconds; InputError if they may be decimals."""
    ends = [TIME.search(name) for name in names]
    parts = [end[1] for end in ends if end is not None]
    wrote_zeros = any(part.startswith("0") and part != "0" for part in parts)
    widths = {*map(len, parts)}
    if len(parts) < len(names) or len(widths) < 2 or max(widths) < NANOSECONDS or wrote_zeros:
        return names
    if "_" not in names[0] and not any(part.endswith("0") and part != "0" for part in parts):
        raise InputError(
            f"{names[0]} and so on: the digits after the point may be decimals of a second or "
            "nanoseconds; write nine digits in each"
        )
    return [f"{name[: -len(part)]}{part:0>9}" for name, part in zip(names, parts, strict=True)]
