"""Triage: the pairs worth a person's look, one after the other, and what is decided about them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from html import escape
from typing import Literal, TypeAlias, get_args

import msgspec
import numpy as np
import viser
from jaxtyping import UInt8

from app.viewer.charts import png_uri
from app.viewer.features.desk import Desk, Feature
from app.viewer.features.pairs.matrix import OPEN_PAIR, cut_name
from app.viewer.features.work import message_of
from app.viewer.scene.thumbnails import thumbnail
from app.viewer.session.decisions import (
    DECIDES,
    MISSED,
    NO_OVERLAP,
    WRONG_MOTION,
    Decisions,
    with_note,
    with_verdict,
)
from app.viewer.session.jobs import Lane
from app.viewer.session.methods import METHODS, MethodName
from app.viewer.session.news import AllPairs, SessionState
from app.viewer.session.state import NEEDS_TWO, ViewState, same_search
from app.viewer.widgets.actions import on_choice, on_option, on_press
from app.viewer.widgets.bridge import Whole, page_script, send
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import ACCENT, BAD, FAINT, GOOD, message_line, paragraph
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PipelineParams
from gpgrad_core.detection.pipeline import infer_quick_map
from gpgrad_core.errors import count, score_in_words
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, LoopClosure, PairOfIds, Submap

Filter: TypeAlias = Literal[
    "worth a look", "undecided", "accepted", "borderline", "wrong", "missed", "decided", "all"
]
FILTERS: tuple[Filter, ...] = get_args(Filter)
BORDER = 0.3
"""A score within this share of the threshold is borderline."""
NEXT_KEY = "G"
ROWS = 6
"""Pairs that are listed at once: a few hundred pictures would make a page slow."""
LONGEST_NAME = 24
INTRODUCTION = (
    "Decide what the thresholds cannot: A accepts the pair shown, X refuses it, and "
    f"{NEXT_KEY} goes to the next undecided one. Sessions and closures.json keep it."
)


@dataclass(frozen=True, eq=False)
class ListedPair:
    """One pair of the list."""

    closure: LoopClosure  # as it is decided
    outcome: str  # the thresholds' verdict by the truth; empty without a truth
    by_hand: bool | None  # what a person decided; None if nobody did
    note: str
    borderline: bool  # whether its score is close to the threshold

    @property
    def pair(self) -> PairOfIds:
        return self.closure.pair

    @property
    def wrong(self) -> bool:
        """Whether it is accepted, and the truth contradicts that."""
        return self.closure.accepted and self.outcome in (WRONG_MOTION, NO_OVERLAP)

    @property
    def missed(self) -> bool:
        return not self.closure.accepted and self.outcome == MISSED

    @property
    def worth_a_look(self) -> bool:
        """Whether a person may want to decide it: most pairs are clearly apart."""
        return self.closure.accepted or self.borderline or self.missed or self.by_hand is not None

    @property
    def undecided(self) -> bool:
        return self.worth_a_look and self.by_hand is None

    @property
    def verdict(self) -> str:
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
    "undecided": lambda entry: entry.undecided,
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
    """List decided pairs, the highest score first; the outcomes are those of the thresholds."""
    entries: list[ListedPair] = []
    for closure in closures:
        pair, found = closure.pair, closure.registration
        near = abs(found.score - min_score) <= BORDER * min_score
        entries.append(
            ListedPair(
                closure,
                outcomes.get(pair, ""),
                decisions.verdicts.get(pair),
                decisions.notes.get(pair, ""),
                near and found.T_database_query is not None,
            )
        )
    return tuple(sorted(entries, key=lambda entry: -entry.closure.registration.score))


def next_undecided(entries: tuple[ListedPair, ...], after: PairOfIds) -> PairOfIds | None:
    """Find the next pair of a list that nobody has decided; after the last comes the first."""
    places = {entry.pair: place for place, entry in enumerate(entries)}
    start = places.get(after, -1) + 1
    for entry in (*entries[start:], *entries[:start]):
        if entry.undecided and entry.pair != after:
            return entry.pair
    return None


@dataclass(frozen=True, eq=False)
class _Listing:
    """The list of a state, which has the pair shown and the settings of pictures."""

    state: ViewState
    entries: tuple[ListedPair, ...]  # all pairs
    listed: tuple[ListedPair, ...]  # those that it is narrowed to
    first: int  # place of the first one on the page, from 0

    @property
    def page(self) -> tuple[ListedPair, ...]:
        return self.listed[self.first : self.first + ROWS]


class KeyMsg(msgspec.Struct):
    """A key that decides the pair shown, or goes to the next one."""

    key: Literal["a", "x", "g"]


class PlaceMsg(msgspec.Struct):
    """The place of the first pair of the list that is to be shown."""

    first: Whole


class TriageTab(Feature):
    """Lists the pairs worth a look, and takes what a person decides about the pair shown."""

    def __init__(self, desk: Desk, commands: Commands, folder: viser.GuiFolderHandle) -> None:
        """Add the panel to the current container, a folder that is visible once there are pairs."""
        self._desk, self._folder = desk, folder
        self._first: int | None = None  # place of the first row; None goes to the pair shown
        self._noted: PairOfIds | None = None  # whose note the box shows
        self._typed: Decisions | None = None  # with the note that is in the box already
        self._entries: tuple[ListedPair, ...] = ()
        gui = desk.host.gui
        gui.add_html(paragraph(INTRODUCTION, FAINT) + page_script("triage.js"))
        self.summary = gui.add_html("")
        self._narrow: viser.GuiDropdownHandle[Filter] = gui.add_dropdown(
            "List of",
            FILTERS,
            initial_value=FILTERS[0],
            hint="worth a look: accepted, borderline, missed or decided pairs. undecided: those of "
            "them that nobody has decided. borderline: the score is within 30 % of the threshold. "
            "wrong and missed: the true poses say so.",
        )
        on_choice(self._narrow, lambda _: self._turn(None))
        verdicts = gui.add_button_group(
            "Pair shown",
            tuple(DECIDES),
            hint="accept: the pair is used, whatever its score. refuse: it is not used. automatic: "
            "the thresholds decide again.",
        )
        on_option(verdicts, lambda label: self.decide(DECIDES[label]))
        go_on = gui.add_button(
            f"Next undecided ({NEXT_KEY})", hint="Shows the next pair that nobody has decided."
        )
        on_press(go_on, self._go_on)
        self._note = gui.add_text(
            "Note", "", hint="A line on the pair shown. It is kept with the decision."
        )
        on_choice(self._note, self._take_note)
        self.message = gui.add_html("")
        self.list = gui.add_html("")
        self._clear()
        self._lister: Lane[Callable[[], _Listing], _Listing] = Lane(
            desk.jobs,
            lambda make, _progress: make(),
            lambda _make, listing, _seconds: self._show(listing),
            self._on_error,
        )
        self._painter: Lane[_Listing, bool] = Lane(
            desk.jobs,
            self._paint,
            lambda _listing, painted, _seconds: self._submit() if painted else None,
            self._on_error,
            slots=desk.capacity.long,
        )
        for name, key, accepted in (
            ("Accept", "A", True),
            ("Refuse", "X", False),
            ("Leave it to the thresholds", "", None),
        ):
            act = partial(self.decide, accepted)
            commands.add("Triage", f"{name}: the pair shown", act, heard=key)
        commands.add("Triage", "Next undecided pair", self._go_on, heard=NEXT_KEY)
        commands.add("Triage", "Take the last decision back", desk.take_back)
        desk.bridge.on_message("triage-key", KeyMsg, self._on_key)
        desk.bridge.on_message("triage-page", PlaceMsg, self._on_page)

    # What the session tells.

    def on_state(self, before: SessionState, state: SessionState) -> None:
        pair = state.view.compared_pair
        if not same_search(state.view, before.view):
            self._first, self._noted = None, None
            self._clear()
        elif pair != before.view.compared_pair:
            self._tell("")
            self._turn(None)
        if state.decisions is not before.decisions:
            self._noted = pair if state.decisions is self._typed else None
            self._submit()
        if self._noted != pair:  # else somebody may be typing it
            self._noted = pair
            self._note.value = state.decisions.notes.get(pair, "")

    def on_pairs(self, before: AllPairs, pairs: AllPairs) -> None:
        if pairs.verdicts is not before.verdicts:
            self._submit()

    # What a person asks for.

    def decide(self, accepted: bool | None) -> None:
        """Accept or refuse the pair shown; None leaves it to the thresholds."""
        pair, decisions = self._desk.state.compared_pair, self._desk.now.decisions
        found = {closure.pair: closure for closure in self._desk.verdicts.found.closures}
        if not self._desk.state.is_pair:
            self._tell(NEEDS_TWO, bad=True)
        elif pair not in found:
            self._tell(
                f"{pair[0]} and {pair[1]} were not compared. Choose a pair of the list.", bad=True
            )
        elif (
            accepted
            and found[pair].registration.T_database_query is None
            and pair not in decisions.motions
        ):
            self._tell(
                "There is no motion to accept. Set one by Nudge, in Inspect, first.", bad=True
            )
        else:
            self._desk.decide(lambda decisions: with_verdict(decisions, pair, accepted))
            done = {True: "accepted", False: "refused", None: "left to the thresholds"}[accepted]
            self._tell(f"{pair[0]} → {pair[1]} is {done}.")

    def _take_note(self, note: str) -> None:
        if not self._desk.state.is_pair:
            self._tell(NEEDS_TWO, bad=True)
            return
        pair = self._desk.state.compared_pair

        def noted(decisions: Decisions) -> Decisions:
            self._typed = with_note(decisions, pair, note)
            return self._typed

        self._desk.decide(noted, step=False)

    def _go_on(self) -> None:
        pair = next_undecided(self._entries, self._desk.state.compared_pair)
        if pair is None:
            self._tell("No other pair waits for a decision.")
        else:
            self._desk.choose(*pair)

    def _on_key(self, _page: viser.ClientHandle, msg: KeyMsg) -> None:
        if msg.key == "g":
            self._go_on()
        else:
            self.decide(msg.key == "a")

    def _on_page(self, _page: viser.ClientHandle, msg: PlaceMsg) -> None:
        if 0 <= msg.first <= len(self._desk.verdicts.found.closures):
            self._turn(int(msg.first))

    def _turn(self, first: int | None) -> None:
        """Show another part of the list; None: that of the pair shown."""
        self._first = first
        self._submit()

    # What the workers do.

    def _submit(self) -> None:
        verdicts, decisions, closures = (
            self._desk.verdicts,
            self._desk.now.decisions,
            self._desk.closures,
        )
        state, passes, first = self._desk.state, PASSES[self._narrow.value], self._first

        def make() -> _Listing:
            lowest = METHODS[state.method].lowest(state.params)
            entries = list_pairs(closures, decisions, verdicts.outcomes, lowest)
            listed = tuple(filter(passes, entries))
            place = first
            if place is None:
                pairs = [entry.pair for entry in listed]
                place = pairs.index(state.compared_pair) if state.compared_pair in pairs else 0
            return _Listing(
                state, entries, listed, ROWS * (min(place, max(len(listed) - 1, 0)) // ROWS)
            )

        if verdicts.found.closures:
            self._lister.submit(make)

    def _paint(self, listing: _Listing, progress: Progress) -> bool:
        """Make the next picture that is missing; says whether there was one."""
        memo = self._desk.memo
        for entry in listing.page:
            inputs = _inputs_of(listing.state, entry)
            if not memo.holds(_picture, *inputs):
                memo(_picture, *inputs, memo=memo, progress=progress)
                return True
        return False

    def _on_error(self, _job: object, error: Exception) -> None:
        self._tell(message_of(error), bad=True)

    # What is shown.

    def _clear(self) -> None:
        self._folder.visible = False
        self.list.content = '<div data-testid="triage"></div>'
        self.message.content = ""
        self._note.value = ""

    def _show(self, listing: _Listing) -> None:
        """Show a page of the list, and request the pictures that it lacks."""
        if not same_search(listing.state, self._desk.state):
            return
        self._entries = entries = listing.entries
        self._folder.visible = True
        undecided = sum(entry.undecided for entry in entries)
        num_decided = sum(entry.by_hand is not None for entry in entries)
        decided = f"{num_decided:,} decided" if num_decided else "None is decided yet"
        self.summary.content = paragraph(
            f"{count(undecided, 'pair')} wait{'s' * (undecided == 1)} for a decision. {decided}.",
            "font-weight:600",
        )
        inputs = [_inputs_of(listing.state, entry) for entry in listing.page]
        memo = self._desk.memo
        pictures = [
            png_uri(memo(_picture, *each, memo=memo)) if memo.holds(_picture, *each) else None
            for each in inputs
        ]
        content = _list_html(listing, pictures)
        if self.list.content != content:
            self.list.content = content
        self._desk.host.flush()
        if None in pictures:
            self._painter.submit(listing)

    def _tell(self, message: str, *, bad: bool = False) -> None:
        """Show the result of a request; an empty one hides it."""
        self.message.content = message_line("triage-message", message, BAD if bad else GOOD)


_Inputs: TypeAlias = tuple[Submap, Submap, SE2 | None, MethodName, MapParams, float]


def _inputs_of(state: ViewState, entry: ListedPair) -> _Inputs:
    query, database = map(state.dataset.submap, entry.pair)
    motion = entry.closure.registration.T_database_query
    ratio = state.params.features.max_std_ratio
    return query, database, motion, state.method, state.given.map, ratio


def _picture(
    query: Submap,
    database: Submap,
    T_database_query: SE2 | None,
    method: MethodName,
    params: MapParams,
    max_std_ratio: float,
    *,
    memo: Memo,
    progress: Progress = silent,
) -> UInt8[NDArray[np.uint8], "rows columns 4"]:
    def quick_map(submap: Submap) -> GradientMap:
        fitted = METHODS[method].of_submap(submap, PipelineParams(map=params), memo, progress)
        return infer_quick_map(submap, fitted.map, memo, progress)

    return thumbnail(quick_map(query), quick_map(database), T_database_query, max_std_ratio)


def _list_html(listing: _Listing, pictures: list[str | None]) -> str:
    """Write a page of the list; ids and notes in it are escaped."""
    page, first, total = listing.page, listing.first, len(listing.listed)
    shown, last = listing.state.compared_pair, first + len(page)
    rows = "".join(
        _row(entry, picture, shown=entry.pair == shown)
        for entry, picture in zip(page, pictures, strict=True)
    )
    where = f"{first + 1:,} to {last:,} of {total:,}" if page else ""
    return (
        f'<div data-testid="triage">{rows or paragraph("No pair is like this.", FAINT)}'
        f'<div style="display:flex;gap:.5em;align-items:center;'
        f'justify-content:space-between;padding:.3em .75em;font-size:.85em">'
        f"{_turn_button('back', first - ROWS, first > 0)}<span>{where}</span>"
        f"{_turn_button('further', first + ROWS, last < total)}</div></div>"
    )


def _row(entry: ListedPair, picture: str | None, *, shown: bool) -> str:
    closure = entry.closure
    name = " → ".join(cut_name(one, LONGEST_NAME) for one in closure.pair)
    small = (
        f'<img alt="gradient of the query and of the database" src="{picture}" '
        f'style="width:111px;height:54px;display:block;border-radius:.2em">'
        if picture is not None
        else '<div style="width:111px;height:54px;background:#8882;border-radius:.2em"></div>'
    )
    edge = ACCENT if shown else "transparent"
    note = f'<div style="{FAINT};overflow-wrap:anywhere">{escape(entry.note)}</div>'
    mark = {True: "✔ ", False: "✘ ", None: ""}[entry.by_hand]
    color = GOOD if closure.accepted else "inherit"
    return (
        f'<button type="button" data-testid="triage-row" data-pair="{escape(name)}" '
        f'aria-pressed="{str(shown).lower()}" onclick="'
        f'{send(OPEN_PAIR, query=closure.query_id, database=closure.database_id)}" '
        f'style="display:flex;gap:.6em;width:100%;padding:.25em .6em;border:0;'
        f"border-left:4px solid {edge};background:transparent;color:inherit;font:inherit;"
        f'font-size:.85em;text-align:left;cursor:pointer;align-items:center">{small}'
        f'<span style="line-height:1.35"><b>{escape(name)}</b><br>score '
        f"{score_in_words(closure.registration.score)}<br>"
        f'<span style="color:{color}">{mark}{escape(entry.verdict)}</span>'
        f"{note if entry.note else ''}</span></button>"
    )


def _turn_button(text: str, first: int, possible: bool) -> str:
    """Write a button that turns to another page; one that cannot keeps its place."""
    act = f'onclick="{send("triage-page", first=float(max(first, 0)))}"'
    return (
        f'<button type="button" {act if possible else "disabled"} style="min-height:32px;'
        f"padding:0 .8em;border:1px solid currentColor;border-radius:.3em;background:transparent;"
        f"color:inherit;font:inherit;opacity:{1 if possible else 0.35};"
        f'cursor:{"pointer" if possible else "default"}">'
        f"{text}</button>"
    )
