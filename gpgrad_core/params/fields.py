"""The single parameters of a params dataclass: what each may be, and how to read and change it."""

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Annotated, Any, Literal, TypeVar, cast, get_args, get_origin, get_type_hints

from typing_extensions import Doc

from gpgrad_core.params.bounds import Bounds

P = TypeVar("P")


@dataclass(frozen=True)
class Setting:
    """One parameter as the panel sees it.

    Attributes:
        path: Where it lies in the params, such as ``map.length_scale``.
        kind: ``bool``, ``int`` or ``float``, or the values of a choice.
        bounds: Of a number; None if it has none.
        optional: Whether None, "automatic", is a value too.
        doc: One sentence for the tooltip.
    """

    path: str
    kind: type | tuple[str, ...]
    bounds: Bounds | None
    optional: bool
    doc: str

    @property
    def label(self) -> str:
        """Its name in words, with the unit."""
        return with_unit(self.path.rpartition(".")[2].replace("_", " "), self.bounds)


def with_unit(name: str, bounds: Bounds | None) -> str:
    """Write a name with its unit: ``noise std [m]``."""
    return f"{name} [{bounds.unit}]" if bounds is not None and bounds.unit else name


def settings_of(params: type, prefix: str = "") -> tuple[Setting, ...]:
    """List the parameters of a dataclass, those of dataclasses within it included.

    A field of a type that no widget shows is an error here, not a slider missing there.

    Raises:
        TypeError: If a field is neither a number, a truth value, a choice nor a dataclass.
    """
    found: list[Setting] = []
    hints = get_type_hints(params, include_extras=True)
    for field in fields(params):
        hint, path = hints[field.name], prefix + field.name
        extras: tuple[Any, ...] = ()
        if get_origin(hint) is Annotated:
            hint, *rest = get_args(hint)
            extras = tuple(rest)
        bounds = next((extra for extra in extras if isinstance(extra, Bounds)), None)
        doc = next((extra.documentation for extra in extras if isinstance(extra, Doc)), "")
        members = get_args(hint)
        optional = type(None) in members
        if optional:
            hint = next(member for member in members if member is not type(None))
        if isinstance(hint, type) and is_dataclass(hint):
            found += settings_of(hint, path + ".")
        elif get_origin(hint) is Literal:
            choices = tuple(str(choice) for choice in get_args(hint))
            found.append(Setting(path, choices, None, optional, doc))
        elif hint in (bool, int, float):
            found.append(Setting(path, hint, bounds, optional, doc))
        else:
            raise TypeError(f"{params.__name__}.{field.name}: no widget shows a {hint}")
    return tuple(found)


def get_path(params: object, path: str) -> object:
    """Read a parameter: ``get_path(params, "map.length_scale")``."""
    for name in path.split("."):
        params = getattr(params, name)
    return params


def with_path(params: P, path: str, value: object) -> P:
    """Copy params with one parameter changed.

    Raises:
        InputError: If the value lies outside its bounds.
    """
    name, _, rest = path.partition(".")
    inner = with_path(getattr(params, name), rest, value) if rest else value
    return cast("P", replace(cast("Any", params), **{name: inner}))
