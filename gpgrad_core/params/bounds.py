"""Bounds of a parameter: one source for the checks, the sliders and ``--help``."""

from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from typing_extensions import Doc

from gpgrad_core.errors import InputError


@dataclass(frozen=True)
class Bounds:
    """What a parameter may be, and what a slider offers of it.

    Attributes:
        low: Smallest value allowed.
        high: Largest value allowed.
        step: What a slider moves by; slider values are rounded to it.
        unit: Of the value, as printed; "" where it has none.
        slider: The stretch within low..high that a slider offers; None means all of it.
    """

    low: float
    high: float
    step: float
    unit: str = ""
    slider: tuple[float, float] | None = None

    @property
    def slider_range(self) -> tuple[float, float]:
        """Ends of the slider."""
        return self.slider or (self.low, self.high)

    def round(self, value: float) -> float:
        """Round to the step, so that 0.30000000000000004 is not a new key.

        >>> Bounds(0.0, 1.0, 0.05).round(0.30000000000000004)
        0.3
        """
        return float(f"{round(value / self.step) * self.step:.9g}")


@dataclass(frozen=True)
class Field:
    """One bounded parameter of a params dataclass."""

    name: str
    bounds: Bounds
    default: Any
    doc: str


def bounded_fields(params: type) -> tuple[Field, ...]:
    """List the fields of a params dataclass that carry bounds, in order of definition.

    Args:
        params: A dataclass whose fields are ``Annotated[float, Bounds(…), Doc("…")]``.
    """
    hints = get_type_hints(params, include_extras=True)
    found: list[Field] = []
    for field in fields(params):
        hint = hints[field.name]
        if get_origin(hint) is not Annotated:
            continue
        extras = get_args(hint)[1:]
        bounds = next((extra for extra in extras if isinstance(extra, Bounds)), None)
        doc = next((extra.documentation for extra in extras if isinstance(extra, Doc)), "")
        if bounds is not None:
            found.append(Field(field.name, bounds, field.default, doc))
    return tuple(found)


def check_bounds(params: object) -> None:
    """Check every bounded field of a params object; call it from ``__post_init__``.

    Raises:
        InputError: If a value lies outside its bounds; names the field, the rule, the value.
    """
    if not is_dataclass(params) or isinstance(params, type):
        raise TypeError(f"check_bounds needs a dataclass object, got {params!r}")
    for field in bounded_fields(type(params)):
        value = getattr(params, field.name)
        if value is None:
            continue
        bounds = field.bounds
        if not bounds.low <= value <= bounds.high:  # also refuses NaN
            unit = f" {bounds.unit}" if bounds.unit else ""
            raise InputError(
                f"{field.name} must be from {bounds.low:g} to {bounds.high:g}{unit}, got {value!r}"
            )
