"""Which pairs a person should look at, what the list says of each, and a small picture of it."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Float, UInt8

from app.viewer.scene.colors import colorize
from app.viewer.session.decisions import MISSED, NO_OVERLAP, WRONG_MOTION, Decisions, Pair, decide
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, LoopClosure

Filter: TypeAlias = Literal[
    "worth a look", "undecided", "accepted", "borderline", "wrong", "missed", "decided", "all"
]
FILTERS: tuple[Filter, ...] = get_args(Filter)
BORDER = 0.3
"""A score within this share of the threshold is borderline."""


@dataclass(frozen=True, eq=False)
class Entry:
    """One pair of the list.

    Attributes:
        closure: As it is decided.
        outcome: What the truth says of the thresholds' verdict; empty if it is not known.
        by_hand: What a person decided; None if nobody did.
        note: What a person noted.
        borderline: Whether its score is close to the threshold.
    """

    closure: LoopClosure
    outcome: str
    by_hand: bool | None
    note: str
    borderline: bool

    @property
    def pair(self) -> Pair:
        """Query and database."""
        return self.closure.query_id, self.closure.database_id

    @property
    def wrong(self) -> bool:
        """Whether it is accepted, and the truth contradicts that."""
        return self.closure.accepted and self.outcome in (WRONG_MOTION, NO_OVERLAP)

    @property
    def missed(self) -> bool:
        """Whether it is refused, although it is the same place."""
        return not self.closure.accepted and self.outcome == MISSED

    @property
    def worth_a_look(self) -> bool:
        """Whether a person may want to decide it: most pairs are clearly apart."""
        return self.closure.accepted or self.borderline or self.missed or self.by_hand is not None

    @property
    def verdict(self) -> str:
        """The verdict in a few words."""
        verdict = "accepted" if self.closure.accepted else "refused"
        if self.by_hand is not None:
            verdict += " by hand"
        if self.wrong:
            verdict += f", {self.outcome}"
        elif self.missed:
            verdict += ", missed"
        return verdict + (", borderline" if self.borderline and self.by_hand is None else "")


PASSES: Mapping[Filter, Callable[[Entry], bool]] = {
    "worth a look": lambda entry: entry.worth_a_look,
    "undecided": lambda entry: entry.worth_a_look and entry.by_hand is None,
    "accepted": lambda entry: entry.closure.accepted,
    "borderline": lambda entry: entry.borderline,
    "wrong": lambda entry: entry.wrong,
    "missed": lambda entry: entry.missed,
    "decided": lambda entry: entry.by_hand is not None or bool(entry.note),
    "all": lambda entry: True,  # noqa: ARG005
}
"""By their names, which pairs the list is narrowed to."""


def list_pairs(
    closures: Iterable[LoopClosure],
    decisions: Decisions,
    outcomes: Mapping[Pair, str],
    min_score: float,
) -> tuple[Entry, ...]:
    """List all pairs, the highest score first; the outcomes are those of the thresholds."""
    entries: list[Entry] = []
    for closure in decide(closures, decisions):
        pair = closure.query_id, closure.database_id
        registration = closure.registration
        near = abs(registration.score - min_score) <= BORDER * min_score
        entries.append(
            Entry(
                closure,
                outcomes.get(pair, ""),
                decisions.verdicts.get(pair),
                decisions.notes.get(pair, ""),
                near and registration.T_database_query is not None,
            )
        )
    return tuple(sorted(entries, key=lambda entry: -entry.closure.registration.score))


def next_undecided(entries: tuple[Entry, ...], after: Pair) -> Pair | None:
    """Find the next pair of a list that nobody has decided; after the last comes the first."""
    places = {entry.pair: place for place, entry in enumerate(entries)}
    start = places.get(after, -1) + 1
    for entry in (*entries[start:], *entries[:start]):
        if PASSES["undecided"](entry) and entry.pair != after:
            return entry.pair
    return None


SIDE = 72
"""Of the picture of one map [pixels]."""
GAP = 4


def thumbnail(
    query: GradientMap, database: GradientMap, T_database_query: SE2 | None, max_std_ratio: float
) -> UInt8[NDArray[np.uint8], "rows columns 4"]:
    """Draw the query's gradient on the left and the database's on the right.

    Args:
        query: Map of the query.
        database: Map of the database submap.
        T_database_query: The motion by which the query is laid beside the database, in a window
            over both; None leaves each in its own.
        max_std_ratio: Of the variance mask; what it rejects stays transparent.
    """
    if T_database_query is None:
        left = _sample(query, _window(_corners(query)), max_std_ratio)
        window = _window(_corners(database))
    else:
        # Over both, so that neither is cut however little they have in common.
        laid = T_database_query.apply(_corners(query))
        window = _window(np.concatenate([laid, _corners(database)]))
        left = _sample(query, T_database_query.inverse().apply(window), max_std_ratio)
    right = _sample(database, window, max_std_ratio)
    slopes = np.concatenate([left[np.isfinite(left)], right[np.isfinite(right)]])
    high = float(np.quantile(slopes, 0.98)) if len(slopes) else 1.0
    picture = np.zeros((SIDE, 2 * SIDE + GAP, 4), np.uint8)
    for values, start in ((left, 0), (right, SIDE + GAP)):
        tile = np.zeros((SIDE * SIDE, 4), np.uint8)
        seen = np.isfinite(values)
        tile[seen, :3] = colorize(values[seen], 0.0, max(high, 1e-9), "magma")
        tile[seen, 3] = 255
        # North is up: the first row of a picture has the highest y.
        picture[:, start : start + SIDE] = tile.reshape(SIDE, SIDE, 4)[::-1]
    return picture


def _corners(gradient_map: GradientMap) -> Float[Array, "4 2"]:
    rows, columns = gradient_map.grid.shape
    x, y = np.meshgrid([0.0, columns - 1.0], [0.0, rows - 1.0])
    return gradient_map.grid.to_position(np.column_stack([x.ravel(), y.ravel()]))


def _window(corners: Float[Array, "k 2"]) -> Float[Array, "n 2"]:
    """Place the pixels over points (n, 2) [m]: rows of rising y, as wide as the longer side."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    steps = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * float((high - low).max())
    x, y = np.meshgrid(*(steps + 0.5 * (low + high)[k] for k in (0, 1)))
    return np.column_stack([x.ravel(), y.ravel()])


def _sample(
    gradient_map: GradientMap, positions: Float[Array, "n 2"], max_std_ratio: float
) -> Float[NDArray[np.float64], "n"]:
    """Read the gradient [m/m] in the nearest cell; NaN outside and where it is not trusted."""
    grid = gradient_map.grid
    columns, rows = np.rint(grid.to_pixel(positions)).T.astype(np.intp)
    inside = (rows >= 0) & (rows < grid.shape[0]) & (columns >= 0) & (columns < grid.shape[1])
    values = np.full(len(positions), np.nan)
    slopes = gradient_map.gradient[rows[inside], columns[inside]].astype(np.float64)
    trusted = gradient_map.trusted(max_std_ratio)[rows[inside], columns[inside]]
    values[inside] = np.where(trusted, slopes, np.nan)
    return values
