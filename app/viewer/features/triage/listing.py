"""Which pairs a person should look at."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from app.viewer.session.decisions import MISSED, NO_OVERLAP, WRONG_MOTION, Decisions, decide
from gpgrad_core.types import LoopClosure, PairOfIds

Filter: TypeAlias = Literal[
    "worth a look", "undecided", "accepted", "borderline", "wrong", "missed", "decided", "all"
]
FILTERS: tuple[Filter, ...] = get_args(Filter)
BORDER = 0.3
"""A score within this share of the threshold is borderline."""


@dataclass(frozen=True, eq=False)
class ListedPair:
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
    def pair(self) -> PairOfIds:
        """Query and database."""
        return self.closure.pair

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


PASSES: Mapping[Filter, Callable[[ListedPair], bool]] = {
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
    outcomes: Mapping[PairOfIds, str],
    min_score: float,
) -> tuple[ListedPair, ...]:
    """List all pairs, the highest score first; the outcomes are those of the thresholds."""
    entries: list[ListedPair] = []
    for closure in decide(closures, decisions):
        pair = closure.pair
        registration = closure.registration
        near = abs(registration.score - min_score) <= BORDER * min_score
        entries.append(
            ListedPair(
                closure,
                outcomes.get(pair, ""),
                decisions.verdicts.get(pair),
                decisions.notes.get(pair, ""),
                near and registration.T_database_query is not None,
            )
        )
    return tuple(sorted(entries, key=lambda entry: -entry.closure.registration.score))


def next_undecided(entries: tuple[ListedPair, ...], after: PairOfIds) -> PairOfIds | None:
    """Find the next pair of a list that nobody has decided; after the last comes the first."""
    places = {entry.pair: place for place, entry in enumerate(entries)}
    start = places.get(after, -1) + 1
    for entry in (*entries[start:], *entries[:start]):
        if PASSES["undecided"](entry) and entry.pair != after:
            return entry.pair
    return None
