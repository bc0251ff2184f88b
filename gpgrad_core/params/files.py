"""Reads and writes params as TOML: ``[map] length_scale = 0.3`` sets the field of that name."""

import difflib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar, cast

from gpgrad_core.errors import InputError
from gpgrad_core.params.fields import AUTOMATIC, Field, fields_of
from gpgrad_core.reading.records import read_toml
from gpgrad_core.types import Dataset

P = TypeVar("P")

MAX_NUMBER = 2**63 - 1
"""The largest whole number that NumPy and the pages of the viewer have."""


def read_parameters(path: Path | str, base: P) -> P:
    """Read a TOML file of parameters; it overrides a base.

    Args:
        path: The file. It has one table for each group: ``[map]`` holds ``length_scale = 0.3``.
        base: Params that are used where the file has no value.

    Returns:
        Params of the same type as the base.

    Raises:
        InputError: If the file is not TOML, names an unknown parameter, or gives one a value of
            the wrong type or outside its bounds; the message names the file and the key.
        OSError: If the file cannot be read.
    """
    return with_tables(base, read_toml(Path(path)), str(path))


def preferred_parameters(dataset: Dataset, base: P) -> P:
    """Use the parameters that a dataset prefers; they override a base.

    Args:
        dataset: The dataset; its ``dataset.toml`` may have tables such as ``[preferred.map]``.
        base: Params that are used where the dataset has no value.

    Returns:
        Params of the same type as the base.

    Raises:
        InputError: If a parameter is unknown, or its value has the wrong type or is outside its
            bounds.
    """
    # The same table also names the submaps to open first, which are not parameters.
    tables = {key: value for key, value in dataset.preferred.items() if isinstance(value, Mapping)}
    return with_tables(base, tables, f"{dataset.name}: dataset.toml, [preferred]")


def with_tables(base: P, tables: Mapping[str, object], where: str, prefix: str = "") -> P:
    """Replace the parameters that nested tables name; `where` is their source, for messages."""
    group = cast("Any", base)
    allowed = {field.name: field for field in fields_of(type(base), prefix)}
    changes: dict[str, object] = {}
    for name, value in tables.items():
        field = allowed.get(name)
        if field is None:
            raise InputError(
                f"{where}: unknown parameter {prefix}{name}; "
                f"{_suggestion(name, list(allowed), prefix)}"
            )
        if not field.is_group:
            changes[name] = _checked(field, value, where)
        elif isinstance(value, Mapping) and all(isinstance(key, str) for key in cast("Any", value)):
            table = cast("Mapping[str, object]", value)
            changes[name] = with_tables(getattr(group, name), table, where, f"{field.path}.")
        else:
            raise InputError(
                f"{where}: {field.path} must be a table, [{field.path}], got {value!r}"
            )
    try:
        return cast("P", replace(group, **changes))
    except InputError as error:
        raise InputError(f"{where}: {prefix}{error}") from error


def to_tables(params: object) -> dict[str, object]:
    """Write all params as the nested tables that `with_tables` reads."""
    tables: dict[str, object] = {}
    for field in fields_of(type(params)):
        value = getattr(params, field.name)
        tables[field.name] = to_tables(value) if field.is_group else value
        if value is None:
            tables[field.name] = AUTOMATIC
    return tables


def _checked(field: Field, value: object, where: str) -> object:
    """Check a value, and convert it to the parameter's type."""
    if field.optional and value == AUTOMATIC:
        return None
    if isinstance(field.kind, tuple):
        fits = value in field.kind
    elif isinstance(value, bool) or field.kind is bool:
        # bool is an int to Python, but `trials = true` is a mistake.
        fits = type(value) is field.kind
    else:
        fits = isinstance(value, int | float if field.kind is float else int)
        # Numbers without bounds of their own must at least be numbers that NumPy has.
        if field.bounds is None:
            fits = fits and abs(cast("float", value)) <= MAX_NUMBER
    if not fits:
        raise InputError(f"{where}: {field.path} must be {_spelled(field)}, got {value!r}")
    return float(cast("float", value)) if field.kind is float else value


def _spelled(field: Field) -> str:
    words: dict[object, str] = {float: "a number", int: "a whole number", bool: "true or false"}
    if isinstance(field.kind, tuple):
        named = [repr(choice) for choice in field.kind]
    else:
        named = [words[field.kind]]
    return " or ".join([*named, f'"{AUTOMATIC}"'] if field.optional else named)


def _suggestion(name: str, allowed: list[str], prefix: str) -> str:
    close = difflib.get_close_matches(name, allowed, n=1)
    if close:
        return f"did you mean {prefix}{close[0]}?"
    return f"known: {', '.join(prefix + name for name in allowed)}"
