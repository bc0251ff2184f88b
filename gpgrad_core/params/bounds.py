"""Bounds of a parameter: one source for the checks, the sliders and ``--help``."""

from dataclasses import dataclass

from gpgrad_core.errors import InputError

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
        """Bring a value that lies a hair beyond an end, as of a slider, to it.

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
