"""Bounds of a parameter: one source for the checks, the sliders and ``--help``."""

from dataclasses import dataclass

from gpgrad_core.errors import InputError


@dataclass(frozen=True)
class Bounds:
    """The range of a parameter, and the part of it that a slider offers.

    Attributes:
        low: Smallest value allowed.
        high: Largest value allowed.
        step: Step of a slider; slider values are rounded to it.
        unit: Unit of the value, as printed; "" if it has none.
        slider: The range that a slider offers, within low and high; None means all of it.
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

    def check(self, name: str, value: float) -> None:
        """Check that a value lies within the bounds.

        Args:
            name: What the message calls the parameter.
            value: The value; NaN is outside of all bounds.

        Raises:
            InputError: If the value is outside; the message names the parameter, the rule and the
                value.
        """
        if not self.low <= value <= self.high:
            unit = f" {self.unit}" if self.unit else ""
            raise InputError(
                f"{name} must be from {self.low:g} to {self.high:g}{unit}, got {value!r}"
            )
