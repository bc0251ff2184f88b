"""Read the text of a TOML file that may come from anybody.

The standard library's parser takes time that grows with the square of a key's parts, and recurses
into what is nested: 98 kB of ``a.a.a.…`` cost 17 s and 10 GB. So the text is bounded first.
"""

import re
import tomllib
from pathlib import Path

from gpgrad_core.errors import InputError

MOST_BYTES = 100_000
"""Of a file of parameters or a session; a real one has a hundredth."""
MOST_DEPTH = 32
"""Brackets within brackets, and parts of a dotted key; a real file has three."""

# Strings and comments; one that is not closed reaches to the end, so that no text is looked at
# twice. What a bracket or a dot in them says is of no concern.
_QUOTED = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"""|\\?\Z)'
    r"|'''(?:[^']|'(?!''))*+(?:'''|\Z)"
    r'|"(?:[^"\\\n]|\\.)*+(?:"|\\?$)'
    r"|'[^'\n]*+(?:'|$)"
    r"|#[^\n]*+",
    re.DOTALL | re.MULTILINE,
)


def read_toml(path: Path) -> dict[str, object]:
    """Read a TOML file.

    Raises:
        InputError: As `load_toml_text`.
        OSError: If the file cannot be read.
    """
    with path.open("rb") as file:
        return load_toml_text(file.read(MOST_BYTES + 1), str(path))


def load_toml_text(text: str | bytes, name: str) -> dict[str, object]:
    """Read the text of a TOML file.

    Args:
        text: What it holds, in UTF-8 if it is not decoded yet.
        name: What messages call it.

    Raises:
        InputError: If it is too large, nested too deeply, or not TOML.
    """
    if len(text) > MOST_BYTES:
        raise InputError(
            f"{name}: is too large for a file of parameters, which has up to {MOST_BYTES:,} bytes"
        )
    try:
        text = text.decode("utf-8") if isinstance(text, bytes) else text
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: is not a TOML file: it is not a text in UTF-8") from error
    bare = _QUOTED.sub("''", text)
    if _depth(bare) > MOST_DEPTH or _most_dots(bare) > MOST_DEPTH:
        raise InputError(f"{name}: is nested more than {MOST_DEPTH} deep")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # a number of 5,000 digits is a plain ValueError
        raise InputError(f"{name}: is not a TOML file: {' '.join(str(error).split())}") from error


def _depth(bare: str) -> int:
    """Count the brackets that are open at once.

    >>> _depth("a = [[1], {b = 2}]")
    2
    """
    depth = deepest = 0
    for mark in re.findall(r"[\[\]{}]", bare):
        depth = max(0, depth + (1 if mark in "[{" else -1))
        deepest = max(deepest, depth)
    return deepest


def _most_dots(bare: str) -> int:
    r"""Count the dots of the longest dotted key, or number.

    >>> _most_dots("[a.b.c]\nd.e = 1.0")
    2
    """
    return max(part.count(".") for part in re.split(r"[=,\n\[\]{}]", bare))
