"""The fields of params dataclasses: how to list, check, read and change them."""

from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Annotated, Any, Literal, TypeVar, cast, get_args, get_origin, get_type_hints

from typing_extensions import Doc

from gpgrad_core.errors import InputError
from gpgrad_core.params.bounds import Bounds

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


def with_unit(name: str, bounds: Bounds | None) -> str:
    """Write a name with its unit: ``noise std [m]``."""
    return f"{name} [{bounds.unit}]" if bounds is not None and bounds.unit else name


@cache
def fields_of(params: type, prefix: str = "") -> tuple[Field, ...]:
    """List the fields of a params dataclass, in order of definition.

    Checks, files, flags and widgets all use this list. So a type that one of them cannot handle is
    an error here, instead of a parameter that is missing there.
    """
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
    """Give the bounds of a dataclass's own fields that have any, by name."""
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
