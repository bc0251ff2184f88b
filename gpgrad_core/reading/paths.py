"""Names of files: those from outside are checked, and equal ones are made different."""

import re
import unicodedata
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from gpgrad_core.errors import InputError

LONGEST_NAME = 200
"""Bytes of one name; file systems take 255, and endings are added."""
DEEPEST, DEEPEST_OF_ALL = 20, 500
"""Most folders within folders: of a name from outside, and of any path, before Python's functions
exhaust their recursion."""


def check_path(path: Path | str) -> Path:
    """Give a path back if the system can be asked about it, and if its name can be written."""
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
    made: list[str] = []
    for name in names:
        count, different = 1, name
        while different in made:
            count += 1
            different = f"{name}{before_number}{count}"
        made.append(different)
    return tuple(made)


def file_names(names: Iterable[str], nameless: str) -> tuple[str, ...]:
    """Make parts of file names, all different.

    >>> file_names(["a b", "a/b", "../"], "method")
    ('a_b', 'a_b_2', 'method')
    """
    plain = (re.sub(r"[^\w-]+", "_", name).strip("_") or nameless for name in names)
    return different_names(plain, "_")
