"""The Triage tab: wires its panel to the decisions of the session, and to what lists and draws."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeAlias

import msgspec
import viser

from app.viewer.charts import png_uri
from app.viewer.features.desk import Desk, Feature
from app.viewer.features.triage.listing import (
    PASSES,
    Filter,
    ListedPair,
    list_pairs,
    next_undecided,
)
from app.viewer.features.triage.panel import NEXT_KEY, ROWS, PairListing, TriagePanel
from app.viewer.features.work import message_of
from app.viewer.scene.thumbnails import thumbnail
from app.viewer.session.decisions import DECIDES, Decisions, with_note, with_verdict
from app.viewer.session.jobs import Lane
from app.viewer.session.methods import METHODS, map_params
from app.viewer.session.news import AllPairs, SessionState, Verdicts
from app.viewer.session.state import NEEDS_TWO, ViewState, same_search
from app.viewer.widgets.actions import on_choice, on_option, on_press
from app.viewer.widgets.bridge import PairMsg, Whole
from app.viewer.widgets.commands import Commands
from gpgrad_core.detection.pipeline import infer_quick_map
from gpgrad_core.run import Progress
from gpgrad_core.types import PairOfIds

MOST_PICTURES = 400
"""That are kept, the newest; each has about ten kilobytes."""


@dataclass(frozen=True, eq=False)
class _Wanted:
    """What a page of the list depends on."""

    state: ViewState
    verdicts: Verdicts
    decisions: Decisions
    narrowed_to: Filter
    first: int | None  # place of the first row; None goes to the pair shown


_Listed: TypeAlias = tuple[tuple[ListedPair, ...], PairListing]
"""All pairs, and the page of them that is shown."""


_Painting: TypeAlias = tuple[ViewState, tuple[ListedPair, ...]]
"""Pairs whose pictures are to be made."""


class KeyMsg(msgspec.Struct):
    """A key that decides the pair shown, or goes to the next one."""

    key: Literal["a", "x", "g"]


class PlaceMsg(msgspec.Struct):
    """The place of the first pair of the list that is to be shown."""

    first: Whole


class TriageTab(Feature):
    """Lists the pairs worth a look, and takes what a person decides about the pair shown."""

    def __init__(self, desk: Desk, commands: Commands, compare_pairs: Callable[[], None]) -> None:
        """Make the panel in the current container; ``compare_pairs`` finds what it lists."""
        self._desk = desk
        self._first: int | None = None
        self._noted: PairOfIds | None = None  # whose note the box shows
        self._typed: Decisions | None = None  # with the note that is in the box already
        self._entries: tuple[ListedPair, ...] = ()
        self._pictures: dict[Hashable, str] = {}
        self.panel = TriagePanel(desk.host)
        on_choice(self.panel.narrow, lambda _: self._turn(None))
        on_option(self.panel.verdicts, lambda label: self.decide(DECIDES[label]))
        on_press(self.panel.next, self._go_on)
        on_choice(self.panel.note, self._take_note)
        on_press(self.panel.find, compare_pairs)
        self._lister: Lane[_Wanted, _Listed] = Lane(
            desk.jobs, self._list, self._on_listed, self._on_error
        )
        self._painter: Lane[_Painting, bool] = Lane(
            desk.jobs,
            self._paint,
            lambda _job, painted, _seconds: self._submit() if painted else None,
            self._on_error,
            slots=desk.capacity.long,
        )
        for name, accepted in (
            ("Accept", True),
            ("Refuse", False),
            ("Leave it to the thresholds", None),
        ):
            commands.add(
                "Triage",
                f"{name}: the pair shown",
                partial(self.decide, accepted),
                heard={True: "A", False: "X", None: ""}[accepted],
            )
        commands.add("Triage", "Next undecided pair", self._go_on, heard=NEXT_KEY)
        commands.add("Triage", "Take the last decision back", desk.take_back)
        desk.bridge.on_message("triage-key", KeyMsg, self._hear_key)
        desk.bridge.on_message(
            "triage-open", PairMsg, lambda _, said: desk.choose(said.query, said.database)
        )
        desk.bridge.on_message("triage-page", PlaceMsg, self._hear_page)

    # What the session tells.

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Follow the session: another dataset or method, another pair, and what was decided."""
        pair = state.view.compared_pair
        if not same_search(state.view, before.view):
            self._first, self._noted = None, None
            self.panel.clear()
        elif pair != before.view.compared_pair:
            self.panel.tell("")
            self._turn(None)
        if state.decisions is not before.decisions:
            self._noted = pair if state.decisions is self._typed else None
            self._submit()
        if self._noted != pair:  # else somebody may be typing it
            self._noted = pair
            self.panel.note.value = state.decisions.notes.get(pair, "")

    def on_pairs(self, before: AllPairs, pairs: AllPairs) -> None:
        """List all pairs as the thresholds judge them."""
        if pairs.verdicts is not before.verdicts:
            self._submit()

    # What a person asks for.

    def decide(self, accepted: bool | None) -> None:
        """Accept or refuse the pair shown; None leaves it to the thresholds."""
        pair = self._desk.state.compared_pair
        closures = self._desk.verdicts.found.closures
        closure = next((closure for closure in closures if closure.pair == pair), None)
        if not self._desk.state.is_pair:
            self.panel.tell(NEEDS_TWO, bad=True)
            return
        if closure is None:
            self.panel.tell(
                f"{pair[0]} and {pair[1]} were not compared. Choose a pair of the list.", bad=True
            )
            return
        has_motion = (
            closure.registration.T_database_query is not None
            or pair in self._desk.now.decisions.motions
        )
        if accepted and not has_motion:
            self.panel.tell(
                "There is no motion to accept. Set one by Nudge, in Inspect, first.", bad=True
            )
            return
        self._desk.decide(lambda decisions: with_verdict(decisions, pair, accepted))
        done = {True: "accepted", False: "refused", None: "left to the thresholds"}[accepted]
        self.panel.tell(f"{pair[0]} → {pair[1]} is {done}.")

    def _take_note(self, note: str) -> None:
        if not self._desk.state.is_pair:
            self.panel.tell(NEEDS_TWO, bad=True)
            return
        pair = self._desk.state.compared_pair

        def noted(decisions: Decisions) -> Decisions:
            self._typed = with_note(decisions, pair, note)
            return self._typed

        self._desk.decide(noted, step=False)

    def _go_on(self) -> None:
        pair = next_undecided(self._entries, self._desk.state.compared_pair)
        if pair is None:
            self.panel.tell("No other pair waits for a decision.")
        else:
            self._desk.choose(*pair)

    def _hear_key(self, _page: viser.ClientHandle, said: KeyMsg) -> None:
        if said.key == "g":
            self._go_on()
        else:
            self.decide(said.key == "a")

    def _hear_page(self, _page: viser.ClientHandle, said: PlaceMsg) -> None:
        if 0 <= said.first <= len(self._desk.verdicts.found.closures):
            self._turn(int(said.first))

    def _turn(self, first: int | None) -> None:
        """Go to another part of the list; None goes to the pair shown."""
        self._first = first
        self._submit()

    def _submit(self) -> None:
        now, verdicts = self._desk.now, self._desk.verdicts
        if verdicts.found.closures:
            narrowed_to = self.panel.narrow.value
            wanted = _Wanted(now.view, verdicts, now.decisions, narrowed_to, self._first)
            self._lister.submit(wanted)

    # What the workers do.

    def _list(self, wanted: _Wanted, _progress: Progress) -> _Listed:
        state = wanted.state
        entries = list_pairs(
            wanted.verdicts.found.closures,
            wanted.decisions,
            wanted.verdicts.outcomes,
            METHODS[state.method].lowest(state.params),
        )
        passes = PASSES[wanted.narrowed_to]
        listed = tuple(entry for entry in entries if passes(entry))
        shown = state.compared_pair
        first = wanted.first
        if first is None:
            places = {entry.pair: place for place, entry in enumerate(listed)}
            first = places.get(shown, 0)
        first = ROWS * (min(first, max(len(listed) - 1, 0)) // ROWS)
        page = listed[first : first + ROWS]
        pictures = {
            entry.pair: uri
            for entry in page
            if (uri := self._pictures.get(_key(state, entry))) is not None
        }
        undecided = sum(map(PASSES["undecided"], entries))
        listing = PairListing(
            page,
            pictures,
            first,
            len(listed),
            undecided,
            sum(entry.by_hand is not None for entry in entries),
            shown,
        )
        return entries, listing

    def _on_listed(self, wanted: _Wanted, listed: _Listed, _seconds: float) -> None:
        if not same_search(wanted.state, self._desk.state):
            return
        self._entries, listing = listed
        self.panel.show(listing)
        self._desk.host.flush()
        if len(listing.pictures) < len(listing.entries):
            self._painter.submit((wanted.state, listing.entries))

    def _paint(self, painting: _Painting, progress: Progress) -> bool:
        """Make the next picture that is missing; says whether there was one."""
        state, entries = painting
        for entry in entries:
            key = _key(state, entry)
            if self._pictures.get(key) is None:
                query, database = (state.dataset.submap(name) for name in entry.pair)
                memo = self._desk.memo
                query_map, database_map = (
                    infer_quick_map(
                        submap,
                        map_params(submap, state.given, memo, progress, state.method).map,
                        memo,
                        progress,
                    )
                    for submap in (query, database)
                )
                motion = entry.closure.registration.T_database_query
                ratio = state.params.features.max_std_ratio
                picture = thumbnail(query_map, database_map, motion, ratio)
                if len(self._pictures) >= MOST_PICTURES:
                    self._pictures.pop(next(iter(self._pictures)))
                self._pictures[key] = png_uri(picture)
                return True
        return False

    def _on_error(self, _job: object, error: Exception) -> None:
        self.panel.tell(message_of(error), bad=True)


def _key(state: ViewState, entry: ListedPair) -> Hashable:
    """Give what the picture of a pair depends on."""
    query, database = (state.dataset.submap(name) for name in entry.pair)
    return (
        query.fingerprint,
        database.fingerprint,
        entry.closure.registration.T_database_query,
        state.method,
        state.given.map,
        state.params.features.max_std_ratio,
    )
