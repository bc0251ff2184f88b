"""Params dataclasses: the bounds of their fields, how to list, check and change these, and TOML.

Checks, files, flags, sliders and ``--help`` all have this one source.
"""

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from typing_extensions import Doc

from gpgrad_core.errors import InputError

if TYPE_CHECKING:
    import gpgrad_core.types

DECADES_FROM = 20.0
"""From this ratio of a slider's ends on, equal ways on it are equal factors."""
DIGITS = 3
"""Of the values of such a slider."""
HAIR = 1e-9
"""Of a range: floating point carries a slider no further beyond its end."""


@dataclass(frozen=True)
class Bounds:
    """The range of a parameter, and the part of it that a slider offers."""

    low: float
    high: float
    step: float  # step of a slider; slider values are rounded to it, unless they span decades
    unit: str = ""  # unit of the value, as printed; "" if it has none
    # the range that a slider offers, within low and high; None means all of it
    slider: tuple[float, float] | None = None

    @property
    def slider_range(self) -> tuple[float, float]:
        return self.slider or (self.low, self.high)

    @property
    def range(self) -> str:
        """The values allowed, as all messages write them.

        >>> Bounds(0.01, 100.0, 0.01, "m", slider=(0.05, 2.0)).range
        '0.01 to 100 m'
        """
        return f"{self.low:.10g} to {self.high:.10g} {self.unit}".rstrip()

    @property
    def spans_decades(self) -> bool:
        """Whether factors matter on the slider, and not differences.

        >>> Bounds(0.01, 100.0, 0.01, "m", slider=(0.05, 2.0)).spans_decades
        True
        >>> Bounds(0.0, 12.0, 0.1).spans_decades
        False
        """
        low, high = self.slider_range
        return low > 0 and high >= DECADES_FROM * low

    def round(self, value: float) -> float:
        """Round to the step, so that 0.30000000000000004 is not a new key.

        Over decades, to three digits where that is finer.

        >>> Bounds(0.0, 1.0, 0.05).round(0.30000000000000004)
        0.3
        >>> Bounds(0.01, 100.0, 0.01, "m", slider=(0.05, 2.0)).round(0.051234)
        0.0512
        >>> Bounds(3, 10_000_000, 1, "points", slider=(500, 30_000)).round(12_345)
        12345.0
        """
        if self.spans_decades and 0 < value < self.step * 10 ** (DIGITS - 1):
            return float(f"{value:.{DIGITS}g}")
        return float(f"{round(value / self.step) * self.step:.12g}")

    def nearest(self, value: float) -> float:
        """Clip a value that lies a hair beyond an end, as of a slider, to that end.

        >>> Bounds(0.0, 0.3, 0.1).nearest(0.30000000000000004), Bounds(0.0, 0.3, 0.1).nearest(0.31)
        (0.3, 0.31)
        """
        hair = HAIR * (self.high - self.low)
        if self.low - hair <= value < self.low:
            return self.low
        return self.high if self.high < value <= self.high + hair else value

    def holds(self, value: float) -> bool:
        """Whether a value lies within; NaN lies within none."""
        return self.low <= value <= self.high

    def check(self, name: str, value: float) -> None:
        """Raise an InputError of the name, the rule and the value if it lies outside."""
        if not self.holds(value):
            raise InputError(f"{name} must be from {self.range}, got {number_text(value)}")


def number_text(value: float) -> str:
    """Write a number in a message: a whole one without a point, and no negative zero.

    >>> number_text(994881405000.0), number_text(-0.0), number_text(0.25)
    ('994881405000', '0', '0.25')
    """
    whole = isinstance(value, float) and value.is_integer() and abs(value) < 1e15
    return f"{value:z.0f}" if whole else str(value)


SEEDS = Bounds(0, 2**32 - 1, 1)
"""Of random choices: what every generator takes, and every file and message can hold."""


P = TypeVar("P")

AUTOMATIC = "automatic"
"""The word for None in files, because TOML has no None."""


@dataclass(frozen=True)
class Field:
    """One field of a params dataclass: a parameter, or a group of them."""

    path: str  # in the params, such as ``map.length_scale``
    # ``bool``, ``int`` or ``float``; the values of a choice; or, for a group, its dataclass
    kind: type | tuple[str, ...]
    bounds: Bounds | None  # of a number that has any
    optional: bool  # whether None ("automatic") is a value too
    default: Any  # None if there is none
    doc: str  # its description, in a sentence for people

    @property
    def name(self) -> str:
        return self.path.rpartition(".")[2]

    @property
    def is_group(self) -> bool:
        return is_dataclass(self.kind)

    @property
    def label(self) -> str:
        return with_unit(self.name.replace("_", " "), self.bounds)

    def rounded(self, value: float) -> float:
        """Round a number to a step of the slider within the bounds, if there are any."""
        if self.bounds is None:
            return value
        # The first position of a slider need not be a whole number of steps from zero.
        value = min(max(self.bounds.round(value), self.bounds.low), self.bounds.high)
        return int(value) if self.kind is int else value


def with_unit(name: str, bounds: Bounds | None) -> str:
    """Write a name with its unit: ``noise std [m]``."""
    return f"{name} [{bounds.unit}]" if bounds is not None and bounds.unit else name


@cache
def fields_of(params: type, prefix: str = "") -> tuple[Field, ...]:
    """List the fields of a params dataclass, in order of definition."""
    listed: list[Field] = []
    hints = get_type_hints(params, include_extras=True)
    for field in fields(params):
        hint: Any = hints[field.name]
        extras: tuple[object, ...] = ()
        if get_origin(hint) is Annotated:
            hint, *rest = get_args(hint)
            extras = tuple(rest)
        optional = type(None) in get_args(hint)
        if optional:
            hint = next(member for member in get_args(hint) if member is not type(None))
        kind: type | tuple[str, ...] = hint
        if get_origin(hint) is Literal:
            kind = tuple(str(choice) for choice in get_args(hint))
        elif hint not in (bool, int, float) and not is_dataclass(hint):
            raise TypeError(f"{params.__name__}.{field.name}: no parameter can be a {hint}")
        default = field.default
        if default is MISSING:
            default = None if field.default_factory is MISSING else field.default_factory()
        listed.append(
            Field(
                prefix + field.name,
                kind,
                next((extra for extra in extras if isinstance(extra, Bounds)), None),
                optional,
                default,
                next((extra.documentation for extra in extras if isinstance(extra, Doc)), ""),
            )
        )
    return tuple(listed)


def parameters_of(params: type, prefix: str = "") -> tuple[Field, ...]:
    """List the parameters of a dataclass and of the groups within it."""
    listed: list[Field] = []
    for field in fields_of(params, prefix):
        if isinstance(field.kind, type) and field.is_group:
            listed += parameters_of(field.kind, f"{field.path}.")
        else:
            listed.append(field)
    return tuple(listed)


def bounds_of(params: type) -> dict[str, Bounds]:
    """The bounds of a dataclass's own fields that have any, by name."""
    return {field.name: field.bounds for field in fields_of(params) if field.bounds is not None}


def check_bounds(params: object) -> None:
    """Check the numbers and choices of a params object; call it from ``__post_init__``."""
    if not is_dataclass(params) or isinstance(params, type):
        raise TypeError(f"check_bounds needs a dataclass object, got {params!r}")
    for field in fields_of(type(params)):
        value = getattr(params, field.name)
        if field.bounds is not None and value is not None:
            field.bounds.check(field.name, value)
        elif isinstance(field.kind, tuple) and value not in field.kind:
            choices = ", ".join(field.kind)
            raise InputError(f"{field.name} must be one of {choices}, got {value!r}")


def get_path(params: object, path: str) -> object:
    """Read a parameter: ``get_path(params, "map.length_scale")``."""
    for name in path.split("."):
        params = getattr(params, name)
    return params


def with_path(params: P, path: str, value: object) -> P:
    """Copy params with one parameter changed."""
    name, _, rest = path.partition(".")
    inner = with_path(getattr(params, name), rest, value) if rest else value
    return cast("P", replace(cast("Any", params), **{name: inner}))


def changes(params: P, base: P) -> Iterator[tuple[Field, object]]:
    """List the parameters that differ from those of a base, with their values."""
    for field in parameters_of(type(base)):
        value = get_path(params, field.path)
        if value != get_path(base, field.path):
            yield field, value


def value_text(value: object) -> str:
    """Write a parameter's value in a word: None is automatic, and numbers keep all digits."""
    if value is None:
        return AUTOMATIC
    return str(value).lower() if isinstance(value, bool) else str(value)


def flag_of(path: str, value: object) -> list[str]:
    """The words of a command line that set a parameter.

    >>> flag_of("map.length_scale", 0.3), flag_of("matching.mutual", False)
    (['--map.length-scale', '0.3'], ['--matching.no-mutual'])
    """
    group, dot, name = path.replace("_", "-").rpartition(".")
    if isinstance(value, bool):
        return [f"--{group}{dot}{'' if value else 'no-'}{name}"]
    return [f"--{group}{dot}{name}", value_text(value)]


def parameters_in_words(params: P, requested: P, base: P) -> list[tuple[str, str, bool]]:
    """List name, value with unit, and whether another than a base was asked for; fits say so."""
    rows, changed = (
        list[tuple[str, str, bool]](),
        {field.path for field, _ in changes(requested, base)},
    )
    for field in parameters_of(type(base)):
        value = get_path(params, field.path)
        text = f"{value:g}" if type(value) is float else AUTOMATIC if value is None else str(value)
        if value is not None and field.bounds is not None:
            text = f"{text} {field.bounds.unit}".rstrip()
        if value is not None and get_path(requested, field.path) is None:
            text += f", {AUTOMATIC}"
        rows.append((field.path, text, field.path in changed))
    return rows


MAX_NUMBER = 2**63 - 1
"""The largest whole number that NumPy and the pages of the viewer have."""


def with_tables(base: P, tables: Mapping[str, object], where: str, prefix: str = "") -> P:
    """Replace the parameters that nested tables name; `where` is their source, for messages."""
    group = cast("Any", base)
    allowed = {field.name: field for field in fields_of(type(base), prefix)}
    changes: dict[str, object] = {}
    for name, value in tables.items():
        field = allowed.get(name)
        if field is None:
            close = difflib.get_close_matches(name, allowed, n=1)
            choices = f"known: {', '.join(prefix + name for name in allowed)}"
            hint = f"did you mean {prefix}{close[0]}?" if close else choices
            raise InputError(f"{where}: unknown parameter {prefix}{name}; {hint}")
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


def read_parameters(path: Path | str, base: P) -> P:
    """Read a TOML file of parameters; it overrides a base.

    Args:
        path: The file. It has one table for each group: ``[map]`` holds ``length_scale = 0.3``.
        base: Params that are used where the file has no value.

    Raises:
        InputError: If the file is not TOML, names an unknown parameter, or gives one a value of
            the wrong type or outside its bounds; the message names the file and the key.
        OSError: If the file cannot be read.
    """
    from gpgrad_core.reading.records import read_toml  # noqa: PLC0415 - a verb's help needs no NumPy

    return with_tables(base, read_toml(Path(path)), str(path))


def preferred_parameters(dataset: "gpgrad_core.types.Dataset", base: P) -> P:
    """Use the parameters that a dataset prefers; they override a base.

    Args:
        dataset: The dataset; its ``dataset.toml`` may have tables such as ``[preferred.map]``.
        base: Params that are used where the dataset has no value.

    Raises:
        InputError: If a parameter is unknown, or its value has the wrong type or is outside its
            bounds.
    """
    # The same table also names the submaps to open first, which are not parameters.
    tables = {key: value for key, value in dataset.preferred.items() if isinstance(value, Mapping)}
    return with_tables(base, tables, f"{dataset.name}: dataset.toml, [preferred]")


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
        raise InputError(f"{where}: {field.path} must be {_allowed(field)}, got {value!r}")
    return float(cast("float", value)) if field.kind is float else value


def _allowed(field: Field) -> str:
    words: dict[object, str] = {float: "a number", int: "a whole number", bool: "true or false"}
    if isinstance(field.kind, tuple):
        named = [repr(choice) for choice in field.kind]
    else:
        named = [words[field.kind]]
    return " or ".join([*named, f'"{AUTOMATIC}"'] if field.optional else named)
