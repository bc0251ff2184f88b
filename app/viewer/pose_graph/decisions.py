"""What a person decided about single closures, over what the thresholds say."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TypeAlias

from gpgrad_core.types import LoopClosure, Registration

Pair: TypeAlias = tuple[str, str]
"""(query id, database id)."""

BY_HAND = {True: "accepted by hand", False: "refused by hand"}


@dataclass(frozen=True, eq=False)
class Decisions:
    """A snapshot; the functions below make a changed copy, so that undoing is going back to one.

    Attributes:
        verdicts: Accepted or refused, by pair; of others the thresholds decide.
        motions: Registrations that were set by hand and refined, in place of the found ones.
    """

    verdicts: Mapping[Pair, bool] = field(default_factory=lambda: MappingProxyType({}))
    motions: Mapping[Pair, Registration] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def trusted(self) -> tuple[Pair, ...]:
        """Pairs that a person accepted by hand."""
        return tuple(pair for pair, accepted in self.verdicts.items() if accepted)


def with_verdict(decisions: Decisions, pair: Pair, accepted: bool | None) -> Decisions:
    """Accept or refuse a pair; None leaves it to the thresholds again."""
    verdicts = {name: one for name, one in decisions.verdicts.items() if name != pair}
    if accepted is not None:
        verdicts[pair] = accepted
    return replace(decisions, verdicts=MappingProxyType(verdicts))


def with_motion(decisions: Decisions, pair: Pair, registration: Registration) -> Decisions:
    """Take a registration set by hand, and accept its pair."""
    motions = MappingProxyType({**decisions.motions, pair: registration})
    return with_verdict(replace(decisions, motions=motions), pair, True)


def decide(closures: Iterable[LoopClosure], decisions: Decisions) -> tuple[LoopClosure, ...]:
    """Give the closures as decided.

    Args:
        closures: As the thresholds judge them.
        decisions: Over them; pairs that were never judged but set by hand are added.
    """
    decided: list[LoopClosure] = []
    for closure in closures:
        pair = closure.query_id, closure.database_id
        registration = decisions.motions.get(pair, closure.registration)
        verdict = decisions.verdicts.get(pair)
        accepted = closure.accepted if verdict is None else verdict
        if registration.T_database_query is None:
            accepted = False  # there is nothing to accept
        reason = closure.reason if verdict is None else BY_HAND[verdict]
        decided.append(
            replace(closure, registration=registration, accepted=accepted, reason=reason)
        )
    known = {(closure.query_id, closure.database_id) for closure in decided}
    for pair, registration in decisions.motions.items():
        if pair not in known:
            accepted = decisions.verdicts.get(pair, False)
            decided.append(LoopClosure(*pair, registration, accepted, BY_HAND[accepted]))
    return tuple(decided)
