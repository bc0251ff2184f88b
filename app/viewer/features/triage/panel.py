"""The list of pairs to look at, with small pictures, and what can be decided about one."""

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape

import viser

from app.viewer.features.triage.listing import FILTERS, Filter, ListedPair
from app.viewer.server.host import Host
from app.viewer.session.decisions import DECIDES
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import inline_script, send
from app.viewer.widgets.html import BAD, FAINT, GOOD, message_line, paragraph
from gpgrad_core.errors import score_in_words
from gpgrad_core.types import PairOfIds

NEXT_KEY = "G"
ROWS = 6
"""Pairs that are listed at once: a few hundred pictures would make a page slow."""
LONGEST_NAME = 24
INTRODUCTION = (
    "Look at the pairs one by one and decide what the thresholds cannot. What you decide is kept "
    "with the session and in closures.json, and gpgrad slam heeds it. While this tab is open, A "
    f"accepts the pair shown, X refuses it, and {NEXT_KEY} goes to the next undecided one."
)


@dataclass(frozen=True, eq=False)
class PairListing:
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

    entries: tuple[ListedPair, ...]
    pictures: Mapping[PairOfIds, str]
    first: int
    total: int
    undecided: int
    decided: int
    shown: PairOfIds


class TriagePanel:
    """Widgets of the triage; the tab binds what they do."""

    def __init__(self, host: Host) -> None:
        """Make the widgets in the current container."""
        gui = host.gui
        keys = inline_script(fill_page_file("triage.js"))
        gui.add_html(paragraph(INTRODUCTION, FAINT) + keys)
        self.find = gui.add_button(
            "Compare pairs", hint="Compares all pairs, like the tab All pairs."
        )
        self.summary = gui.add_html("")
        self.narrow: viser.GuiDropdownHandle[Filter] = gui.add_dropdown(
            "List of",
            FILTERS,
            initial_value=FILTERS[0],
            hint="worth a look: accepted, borderline, missed or decided pairs. undecided: those of "
            "them that nobody has decided. borderline: the score is within 30 % of the threshold. "
            "wrong and missed: the true poses say so.",
        )
        self.verdicts = gui.add_button_group(
            "Pair shown",
            tuple(DECIDES),
            hint="accept: the pair is used, whatever its score. refuse: it is not used. automatic: "
            "the thresholds decide again.",
        )
        self.next = gui.add_button(
            f"Next undecided ({NEXT_KEY})", hint="Shows the next pair that nobody has decided."
        )
        self.note = gui.add_text(
            "Note", "", hint="A line on the pair shown. It is kept with the decision."
        )
        self.message = gui.add_html("")
        self.list = gui.add_html("")
        self.clear()

    def clear(self) -> None:
        """Show that no pairs are compared yet."""
        self.find.visible = True
        self.summary.content = paragraph("No pairs yet: compare them first.", "font-weight:600")
        self.list.content = '<div data-testid="triage"></div>'
        self.message.content = ""
        self.note.value = ""

    def show(self, listing: PairListing) -> None:
        """Show a page of the list."""
        self.find.visible = False
        decided = f"{listing.decided:,} decided" if listing.decided else "None is decided yet"
        self.summary.content = paragraph(
            f"{listing.undecided:,} pairs wait for a decision. {decided}.", "font-weight:600"
        )
        content = list_html(listing)
        if self.list.content != content:
            self.list.content = content

    def tell(self, message: str, *, bad: bool = False) -> None:
        """Say what came of a wish; an empty message says nothing."""
        self.message.content = message_line("triage-message", message, BAD if bad else GOOD)


def list_html(listing: PairListing) -> str:
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
        f"{_turn('back', listing.first - ROWS, listing.first > 0)}<span>{where}</span>"
        f"{_turn('further', listing.first + ROWS, last < listing.total)}</div></div>"
    )


def _row(entry: ListedPair, picture: str | None, *, shown: bool) -> str:
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
        f'{send("triage-open", query=closure.query_id, database=closure.database_id)}" '
        f'style="display:flex;gap:.6em;width:100%;padding:.25em .6em;border:0;'
        f"border-left:4px solid {edge};background:transparent;color:inherit;font:inherit;"
        f'font-size:.85em;text-align:left;cursor:pointer;align-items:center">{small}'
        f'<span style="line-height:1.35"><b>{escape(name)}</b><br>score '
        f"{score_in_words(closure.registration.score)}<br>"
        f'<span style="color:{color}">{mark}{escape(entry.verdict)}</span>'
        f"{note if entry.note else ''}</span></button>"
    )


def _turn(text: str, first: int, possible: bool) -> str:
    """Write a button that turns to another page; one that cannot keeps its place."""
    act = f'onclick="{send("triage-page", first=float(max(first, 0)))}"'
    return (
        f'<button type="button" {act if possible else "disabled"} style="min-height:32px;'
        f"padding:0 .8em;border:1px solid currentColor;border-radius:.3em;background:transparent;"
        f"color:inherit;font:inherit;opacity:{1 if possible else 0.35};"
        f'cursor:{"pointer" if possible else "default"}">'
        f"{text}</button>"
    )


def _short(name: str) -> str:
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"
