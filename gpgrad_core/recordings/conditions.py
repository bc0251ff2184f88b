"""Which points of a scan are kept, by the further numbers that it has for each point."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.reading.text import parse_number

RELATIONS: dict[str, Callable[[NDArray[np.float64], float], NDArray[np.bool_]]] = {
    ">=": lambda values, limit: values >= limit,
    "<=": lambda values, limit: values <= limit,
    "==": lambda values, limit: values == limit,
    "!=": lambda values, limit: values != limit,
    ">": lambda values, limit: values > limit,
    "<": lambda values, limit: values < limit,
}


@dataclass(frozen=True)
class Condition:
    """A condition on a number of each point, such as ``intensity>3``.

    Attributes:
        field: The number's name, as the file or the message calls it.
        relation: One of `RELATIONS`.
        limit: What it is compared with.
    """

    field: str
    relation: str
    limit: float

    def __str__(self) -> str:
        """Spell it as it is given."""
        return f"{self.field}{self.relation}{self.limit:g}"


@dataclass
class Tally:
    """How many points conditions kept so far, of how many that were read."""

    read: int = 0  # number of points that were read
    kept: int = 0  # number of those that met all conditions

    def add(self, mask: Bool[NDArray[np.bool_], "n"]) -> None:
        """Count the points of a scan."""
        self.read += len(mask)
        self.kept += int(mask.sum())


def parse_condition(text: str) -> Condition:
    """Read a condition.

    >>> parse_condition("intensity > 3")
    Condition(field='intensity', relation='>', limit=3.0)

    Raises:
        InputError: If it is none.
    """
    parts = re.fullmatch(r"\s*([A-Za-z_]\w*)\s*(>=|<=|==|!=|>|<)\s*(\S+)\s*", text)
    limit = None if parts is None else parse_number(parts[3])
    if parts is None or limit is None or not np.isfinite(limit):
        raise InputError(
            f"--keep {text}: a condition is a field, one of {' '.join(RELATIONS)} and a number, "
            "such as intensity>3"
        )
    return Condition(parts[1], parts[2], limit)


def kept_points(
    conditions: Sequence[Condition],
    values_of: Callable[[str], NDArray[np.generic] | None],
    where: str,
    tally: Tally | None = None,
) -> Bool[NDArray[np.bool_], "n"] | None:
    """Find the points that meet all conditions.

    Args:
        conditions: The conditions.
        values_of: Gives a number of each point (n,) by its name; None if there is none.
        where: The scan, for the error message.
        tally: Counts them, if it is given.

    Returns:
        A mask (n,); None if there are no conditions.

    Raises:
        InputError: If a scan does not have a field; the message names it.
    """
    mask: NDArray[np.bool_] | None = None
    for condition in conditions:
        values = values_of(condition.field)
        if values is None:
            raise InputError(
                f"{where}: its points have no field {condition.field} for --keep {condition}"
            )
        met = RELATIONS[condition.relation](np.asarray(values, np.float64), condition.limit)
        mask = met if mask is None else mask & met
    if mask is not None and tally is not None:
        tally.add(mask)
    return mask
