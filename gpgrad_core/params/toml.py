"""TOML out of values; the standard library reads it only."""

from collections.abc import Mapping
from typing import cast

from gpgrad_core.errors import InputError


def toml_lines(table: Mapping[str, object], name: str = "") -> list[str]:
    """Write a table: its own values first, then the tables within it, each under its header.

    Args:
        table: Values by key; a mapping is a table within.
        name: Of the table, with those that it lies in; empty for the document.
    """
    lines = [f"{key} = {toml_value(v)}" for key, v in table.items() if not isinstance(v, Mapping)]
    for key, value in table.items():
        if isinstance(value, Mapping):
            inner = f"{name}.{key}" if name else key
            lines += ["", f"[{inner}]", *toml_lines(cast("Mapping[str, object]", value), inner)]
    return lines


def toml_value(value: object) -> str:
    """Write one value.

    Raises:
        InputError: If TOML has no such type.
    """
    match value:
        case bool():
            return str(value).lower()
        case int():
            return str(int(value))
        case float():
            return repr(float(value))  # NumPy's own repr names its type
        case str():
            return '"' + "".join(_escape(letter) for letter in value) + '"'
        case list() | tuple():
            return f"[{', '.join(toml_value(item) for item in cast('list[object]', value))}]"
        case _:
            raise InputError(f"TOML cannot hold {value!r}")


def _escape(letter: str) -> str:
    if letter in '"\\':
        return f"\\{letter}"
    return letter if letter.isprintable() else f"\\U{ord(letter):08x}"
