"""Params out of TOML: ``[map] length_scale = 0.3`` into the dataclass field of that name."""

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from gpgrad_core.errors import InputError
from gpgrad_core.types import Dataset

P = TypeVar("P")

AUTOMATIC = "automatic"
"""What files say for None, which TOML does not have."""


def read_parameters(path: Path | str, base: P) -> P:
    """Read a TOML file of parameters over a base.

    Args:
        path: A table a group: ``[map]`` holds ``length_scale = 0.3``, and so on.
        base: Params that hold wherever the file is silent.

    Returns:
        Params of the same type as the base.

    Raises:
        InputError: If the file is not TOML, or names a parameter that there is not, or gives it a
            value of the wrong type or outside its bounds; names the file and the key.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a TOML file: {_one_line(error)}") from error
    return with_tables(base, tables, str(path))


def preferred_parameters(dataset: Dataset, base: P) -> P:
    """Lay the parameters that a dataset prefers over a base.

    Args:
        dataset: Its ``dataset.toml`` may have tables such as ``[preferred.map]``.
        base: Params that hold wherever the dataset is silent.

    Raises:
        InputError: As `read_parameters`.
    """
    # Beside the tables of parameters there are the names of the submaps to open first.
    tables = {key: value for key, value in dataset.preferred.items() if isinstance(value, Mapping)}
    return with_tables(base, tables, f"{dataset.name}: dataset.toml, [preferred]")


def with_tables(base: P, tables: Mapping[str, object], where: str) -> P:
    """Replace the parameters that nested tables name.

    Args:
        base: A params dataclass, which may hold others.
        tables: Values by field name; a table for a field that is itself a params dataclass.
        where: What the tables come from, for the error message.

    Raises:
        InputError: As `read_parameters`.
    """
    return _replaced(base, tables, where, "")


def to_tables(params: object) -> dict[str, object]:
    """Write params as the nested tables that `with_tables` reads; nothing is left out."""
    tables: dict[str, object] = {}
    for field in fields(cast("Any", params)):
        value = getattr(params, field.name)
        tables[field.name] = to_tables(value) if is_dataclass(value) else value
        if value is None:
            tables[field.name] = AUTOMATIC
    return tables


def _replaced(base: P, tables: Mapping[str, object], where: str, prefix: str) -> P:
    group = cast("Any", base)
    hints = get_type_hints(type(base), include_extras=True)
    known = [field.name for field in fields(group)]
    changes: dict[str, object] = {}
    for name, value in tables.items():
        key = f"{prefix}{name}"
        if name not in known:
            raise InputError(
                f"{where}: unknown parameter {key}; {_suggestion(name, known, prefix)}"
            )
        current = getattr(group, name)
        if is_dataclass(current):
            if not isinstance(value, Mapping):
                raise InputError(f"{where}: {key} must be a table, [{key}], got {value!r}")
            table = cast("Mapping[str, object]", value)
            changes[name] = _replaced(current, table, where, f"{key}.")
        else:
            changes[name] = _checked(hints[name], value, where, key)
    try:
        return cast("P", replace(group, **changes))
    except InputError as error:
        raise InputError(f"{where}: {prefix}{error}") from error


def _checked(hint: object, value: object, where: str, key: str) -> object:
    """Return the value as the annotated type wants it."""
    if get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    wanted = _alternatives(hint)
    if value == AUTOMATIC and NoneType in wanted:
        return None
    # bool is an int to Python, but `trials = true` is a slip.
    if isinstance(value, bool):
        fits = bool in wanted
    elif isinstance(value, int):
        fits = int in wanted or float in wanted or value in wanted
    else:
        fits = type(value) in wanted or (isinstance(value, str) and value in wanted)
    if not fits:
        raise InputError(f"{where}: {key} must be {_spelled(wanted)}, got {value!r}")
    if isinstance(value, int) and not isinstance(value, bool) and int not in wanted:
        return float(value)
    return value


def _alternatives(hint: object) -> tuple[Any, ...]:
    """Types, or literal values, that a hint allows."""
    if get_origin(hint) in (Union, UnionType):
        return tuple(one for part in get_args(hint) for one in _alternatives(part))
    if get_origin(hint) is Literal:
        return get_args(hint)
    return (hint,)


def _spelled(wanted: tuple[Any, ...]) -> str:
    words: dict[object, str] = {
        float: "a number",
        int: "a whole number",
        bool: "true or false",
        str: "a text",
        NoneType: f'"{AUTOMATIC}"',
    }
    named = [words.get(one, repr(one)) for one in wanted]
    return " or ".join(named)


def _suggestion(name: str, known: list[str], prefix: str) -> str:
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f"did you mean {prefix}{close[0]}?"
    return f"known: {', '.join(prefix + one for one in known)}"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
