"""What a person decided about single closures, over what the thresholds say."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from msgspec import Struct

from gpgrad_core.errors import InputError
from gpgrad_core.io.records.closures import (
    LONGEST_NOTE,
    Decision,
    closure_as_decided,
    read_row,
    rounded,
    row_of,
)
from gpgrad_core.reading.records import as_builtins
from gpgrad_core.types import Dataset, LoopClosure, PairOfIds, Registration

ACCEPTED, REFUSED = "accepted", "refused"
RIGHT, WRONG_MOTION, NO_OVERLAP, MISSED = "right", "wrong motion", "no overlap", "missed"
"""The outcome of a pair: its verdict, and where there is a truth, whether that is right."""

BY_HAND = {accepted: Decision(accepted).reason for accepted in (True, False)}
DECIDES: dict[str, bool | None] = {"accept": True, "refuse": False, "automatic": None}
"""By the words for it, what a person makes of a pair; None leaves it to the thresholds."""
MOST_DECISIONS = 2000
"""Of a session's file."""


@dataclass(frozen=True, eq=False)
class Decisions:
    """A snapshot; the functions below make a changed copy, so that undoing is going back to one."""

    # accepted or refused; of others the thresholds decide
    verdicts: Mapping[PairOfIds, bool] = field(default_factory=lambda: MappingProxyType({}))
    # set by hand and refined, in place of the detected ones
    motions: Mapping[PairOfIds, Registration] = field(default_factory=lambda: MappingProxyType({}))
    notes: Mapping[PairOfIds, str] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def trusted(self) -> tuple[PairOfIds, ...]:
        return tuple(pair for pair, accepted in self.verdicts.items() if accepted)

    @property
    def pairs(self) -> tuple[PairOfIds, ...]:
        """All pairs about which something was decided or noted."""
        return tuple(dict.fromkeys((*self.verdicts, *self.motions, *self.notes)))

    def of_closures(self) -> dict[PairOfIds, Decision]:
        return {
            pair: Decision(self.verdicts.get(pair), self.notes.get(pair, ""))
            for pair in self.pairs
            if pair in self.verdicts or pair in self.notes
        }


def with_verdict(decisions: Decisions, pair: PairOfIds, accepted: bool | None) -> Decisions:
    """Accept or refuse a pair; None leaves it to the thresholds again."""
    verdicts = {named: verdict for named, verdict in decisions.verdicts.items() if named != pair}
    if accepted is not None:
        verdicts[pair] = accepted
    return replace(decisions, verdicts=MappingProxyType(verdicts))


def with_note(decisions: Decisions, pair: PairOfIds, note: str) -> Decisions:
    """Note a line of text on a pair, cut to `LONGEST_NOTE` letters; an empty one takes it away."""
    line = " ".join("".join(c if c.isprintable() else " " for c in note).split())
    notes = {named: text for named, text in decisions.notes.items() if named != pair}
    if line:
        notes[pair] = line[:LONGEST_NOTE].rstrip()
    return replace(decisions, notes=MappingProxyType(notes))


def with_motion(decisions: Decisions, pair: PairOfIds, registration: Registration) -> Decisions:
    """Set a registration by hand, and accept its pair."""
    motions = MappingProxyType({**decisions.motions, pair: registration})
    return with_verdict(replace(decisions, motions=motions), pair, True)


def decide(closures: Iterable[LoopClosure], decisions: Decisions) -> tuple[LoopClosure, ...]:
    """The closures as a person decided; pairs that were set by hand only are added."""
    decided: list[LoopClosure] = []
    for closure in closures:
        registration = decisions.motions.get(closure.pair, closure.registration)
        decision = Decision(decisions.verdicts.get(closure.pair))
        decided.append(closure_as_decided(replace(closure, registration=registration), decision))
    judged = {closure.pair for closure in decided}
    for pair, registration in decisions.motions.items():
        if pair not in judged:
            accepted = decisions.verdicts.get(pair, False)
            reason = BY_HAND[accepted]
            decided.append(LoopClosure(*pair, registration, accepted, reason, by_hand=True))
    return tuple(decided)


def count_kinds(dataset: Dataset, pairs: Iterable[PairOfIds]) -> tuple[int, int]:
    """Count pairs apart: loop closures, and odometry neighbours, which follow each other."""
    index = dataset.index
    listed = list(pairs)
    neighbours = sum(abs(index[query] - index[database]) <= 1 for query, database in listed)
    return len(listed) - neighbours, neighbours


def tables_of(decisions: Decisions) -> list[dict[str, Any]]:
    """Write decisions as tables of a TOML file; `read_decisions` reads them back."""
    tables: list[DecisionTable] = []
    for pair in decisions.pairs:
        motion, row = decisions.motions.get(pair), None
        if motion is not None:
            row = _without_null(row_of(rounded(LoopClosure(*pair, motion, True, ""))))
        verdict, note = decisions.verdicts.get(pair), decisions.notes.get(pair, "")
        tables.append(DecisionTable(*pair, verdict, note, row))
    return as_builtins(tables)


class DecisionTable(Struct, omit_defaults=True):
    """A decision in a session's file."""

    query: str
    database: str
    accepted: bool | None = None
    note: str = ""
    motion: dict[str, object] | None = None

    def __post_init__(self) -> None:
        Decision(self.accepted, self.note)


def read_decisions(rows: list[DecisionTable], where: str) -> Decisions:
    """Read decisions from the tables of a file, which a message names as ``where``."""
    if len(rows) > MOST_DECISIONS:
        raise InputError(
            f"{where}: there are {len(rows):,} decisions; {MOST_DECISIONS:,} is the most"
        )
    decisions = Decisions()
    for k, row in enumerate(rows):
        place, pair = f"{where}, decisions[{k}]", (row.query, row.database)
        if row.query == row.database:
            raise InputError(f"{place}: 'database' must be another submap than the query")
        if row.motion is not None:
            values = {**row.motion, "query": row.query, "database": row.database}
            closure = read_row(values, f"{place}, motion")
            decisions = with_motion(decisions, pair, closure.registration)
        decisions = with_note(with_verdict(decisions, pair, row.accepted), pair, row.note)
    return decisions


def _without_null(table: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _without_null(value) if isinstance(value, dict) else value
        for key, value in table.items()
        if value is not None
    }
