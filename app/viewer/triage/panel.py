"""The list of pairs to look at, with small pictures, and what can be decided about one."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from html import escape
from typing import Literal, TypeAlias, get_args

import viser

from app.viewer.decisions import Pair
from app.viewer.host import Host
from app.viewer.triage.listing import FILTERS, Entry, Filter
from app.viewer.widgets.actions import on_choice, on_option, on_press, one_of
from app.viewer.widgets.bridge import run_when_shown, say
from app.viewer.widgets.html import BAD, FAINT, GOOD, message_line, paragraph

Verdict: TypeAlias = Literal["accept", "refuse", "as found"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
DECIDES: Mapping[Verdict, bool | None] = {"accept": True, "refuse": False, "as found": None}
NEXT_KEY = "G"
ROWS = 6
"""Pairs that are listed at once: a few hundred pictures would make a page slow."""
LONGEST_NAME = 24
INTRODUCTION = (
    "Look at the pairs one by one and decide what the thresholds cannot. What you decide is kept "
    "with the session and in closures.json, and gpgrad slam heeds it. While this tab is open, A "
    f"accepts the pair shown, X refuses it, and {NEXT_KEY} goes to the next undecided one."
)

# Letters fly the camera too. While the list is to be seen, these decide instead.
KEYS_SCRIPT = """
if (!window.gpgradTriage) {
  window.gpgradTriage = true;
  window.addEventListener('keydown', event => {
    const list = document.querySelector('[data-testid=triage]');
    const key = event.key.toLowerCase();
    if (!'axg'.includes(key) || key.length !== 1 || !list || !list.getClientRects().length) return;
    if (event.ctrlKey || event.metaKey || event.altKey || event.shiftKey) return;
    const at = event.target;
    if (at && at.closest && at.closest('input,textarea,select,[contenteditable=true]')) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) gpgrad.say('triage-key', {key});
  }, true);
}
"""


@dataclass(frozen=True, eq=False)
class Listing:
    """What the panel shows.

    Attributes:
        entries: Of the page.
        pictures: Small pictures as URIs, by pair; those that are not made yet are missing.
        first: Place of the first entry in the whole list, from 0.
        total: Number of pairs of the whole list.
        undecided: Number of pairs that wait for a decision.
        decided: Number of pairs that were decided.
        shown: The pair that the scene shows.
    """

    entries: tuple[Entry, ...]
    pictures: Mapping[Pair, str]
    first: int
    total: int
    undecided: int
    decided: int
    shown: Pair


@dataclass(frozen=True)
class TriageCalls:
    """What the panel calls; all must be quick.

    Attributes:
        on_filter: Given which pairs are to be listed.
        on_verdict: Given what is to become of the pair shown: True accepts it, False refuses it,
            None leaves it to the thresholds.
        on_next: Called to go to the next undecided pair.
        on_note: Given a line of text about the pair shown.
        on_find: Called when all pairs are to be compared.
    """

    on_filter: Callable[[Filter], None]
    on_verdict: Callable[[bool | None], None]
    on_next: Callable[[], None]
    on_note: Callable[[str], None]
    on_find: Callable[[], None]


class TriagePanel:
    """Widgets of the triage."""

    def __init__(self, host: Host, calls: TriageCalls) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            calls: What they call.
        """
        gui = host.gui
        gui.add_html(paragraph(INTRODUCTION, FAINT) + run_when_shown(KEYS_SCRIPT))
        self._find = gui.add_button(
            "Compare pairs", hint="Compares all pairs, like the tab All pairs."
        )
        self._summary = gui.add_html("")
        self._filter: viser.GuiDropdownHandle[Filter] = gui.add_dropdown(
            "List of",
            FILTERS,
            initial_value=FILTERS[0],
            hint="worth a look: accepted, borderline, missed or decided pairs. undecided: those of "
            "them that nobody has decided. borderline: the score is within 30 % of the threshold. "
            "wrong and missed: the true poses say so.",
        )
        verdicts = gui.add_button_group(
            "Pair shown",
            VERDICTS,
            hint="accept: the pair is used, whatever its score. refuse: it is not used. as found: "
            "the thresholds decide again.",
        )
        self._next = gui.add_button(
            f"Next undecided ({NEXT_KEY})", hint="Shows the next pair that nobody has decided."
        )
        self._note = gui.add_text(
            "Note", "", hint="A line on the pair shown. It is kept with the decision."
        )
        self._message = gui.add_html("")
        self._list = gui.add_html("")
        on_choice(self._filter, calls.on_filter)
        on_option(verdicts, lambda label: calls.on_verdict(DECIDES[one_of(VERDICTS, label)]))
        on_press(self._next, calls.on_next)
        on_press(self._find, calls.on_find)
        on_choice(self._note, calls.on_note)
        self.clear()

    @property
    def narrowed_to(self) -> Filter:
        """Which pairs are listed."""
        return self._filter.value

    def clear(self) -> None:
        """Show that no pairs are compared yet."""
        self._find.visible = True
        self._summary.content = paragraph("No pairs yet: compare them first.", "font-weight:600")
        self._list.content = '<div data-testid="triage"></div>'
        self._message.content = ""
        self._note.value = ""

    def show(self, listing: Listing) -> None:
        """Show a page of the list."""
        self._find.visible = False
        decided = f"{listing.decided:,} decided" if listing.decided else "None is decided yet"
        self._summary.content = paragraph(
            f"{listing.undecided:,} pairs wait for a decision. {decided}.", "font-weight:600"
        )
        content = list_html(listing)
        if self._list.content != content:
            self._list.content = content

    def show_note(self, note: str) -> None:
        """Show the note on another pair."""
        self._note.value = note

    def tell(self, message: str, *, bad: bool = False) -> None:
        """Say what came of a wish; an empty message says nothing."""
        self._message.content = message_line("triage-message", message, BAD if bad else GOOD)


def list_html(listing: Listing) -> str:
    """Write a page of the list; ids and notes in it are escaped."""
    rows = "".join(
        _row(entry, listing.pictures.get(entry.pair), shown=entry.pair == listing.shown)
        for entry in listing.entries
    )
    if not listing.entries:
        rows = paragraph("No pair is like this.", FAINT)
    last = listing.first + len(listing.entries)
    where = f"{listing.first + 1:,} to {last:,} of {listing.total:,}" if listing.entries else ""
    return (
        f'<div data-testid="triage">{rows}<div style="display:flex;gap:.5em;align-items:center;'
        f'justify-content:space-between;padding:.3em .75em;font-size:.85em">'
        f"{_turn('previous', listing.first - ROWS, listing.first > 0)}<span>{where}</span>"
        f"{_turn('next', listing.first + ROWS, last < listing.total)}</div></div>"
    )


def _row(entry: Entry, picture: str | None, *, shown: bool) -> str:
    closure = entry.closure
    name = f"{_short(closure.query_id)} → {_short(closure.database_id)}"
    small = (
        f'<img alt="gradient of the query and of the database" src="{picture}" '
        f'style="width:111px;height:54px;display:block;border-radius:.2em">'
        if picture is not None
        else '<div style="width:111px;height:54px;background:#8882;border-radius:.2em"></div>'
    )
    edge = "#1971c2" if shown else "transparent"
    note = f'<div style="{FAINT};overflow-wrap:anywhere">{escape(entry.note)}</div>'
    mark = {True: "✔ ", False: "✘ ", None: ""}[entry.by_hand]
    color = GOOD if closure.accepted else "inherit"
    return (
        f'<button type="button" data-testid="triage-row" data-pair="{escape(name)}" '
        f'aria-pressed="{str(shown).lower()}" onclick="'
        f'{say("triage-open", query=closure.query_id, database=closure.database_id)}" '
        f'style="display:flex;gap:.6em;width:100%;padding:.25em .6em;border:0;'
        f"border-left:4px solid {edge};background:transparent;color:inherit;font:inherit;"
        f'font-size:.85em;text-align:left;cursor:pointer;align-items:center">{small}'
        f'<span style="line-height:1.35"><b>{escape(name)}</b><br>score '
        f"{closure.registration.score:.1f}<br>"
        f'<span style="color:{color}">{mark}{escape(entry.verdict)}</span>'
        f"{note if entry.note else ''}</span></button>"
    )


def _turn(text: str, first: int, possible: bool) -> str:
    """Write a button that turns to another page; one that cannot keeps its place."""
    state = (
        f'onclick="{say("triage-page", first=float(max(first, 0)))}"' if possible else "disabled"
    )
    return (
        f'<button type="button" {state} style="min-height:32px;padding:0 .8em;border:1px solid '
        f"currentColor;border-radius:.3em;background:transparent;color:inherit;font:inherit;"
        f'opacity:{1 if possible else 0.35};cursor:{"pointer" if possible else "default"}">'
        f"{text}</button>"
    )


def _short(name: str) -> str:
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"
