"""All pairs of the dataset: run, look at the matrix and the curve, and pick a pair to see."""

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from typing import Any

import viser

from app.viewer.host import Host
from app.viewer.widgets.html import BAD, BUSY, FAINT, paragraph

INTRODUCTION = "Compare every submap with all earlier ones, with the parameters as they are now."
NO_CHOICE: str = "choose a pair …"
ALL: str = "all"
MOST_CHOICES = 300
"""Longer lists make the browser slow; what is left out is counted."""


@dataclass(frozen=True)
class Choice:
    """A pair that can be picked.

    Attributes:
        query: Id of the query submap.
        database: Id of the database submap.
        score: What it is ranked by.
        outcome: What became of it, in words; what the list can be narrowed to.
    """

    query: str
    database: str
    score: float
    outcome: str

    @property
    def label(self) -> str:
        """As the list has it."""
        return f"{self.query} → {self.database} · {self.score:.1f} · {self.outcome}"


@dataclass(frozen=True)
class Findings:
    """What the panel shows of all pairs at the thresholds as they are.

    Attributes:
        summary: One line.
        outdated: Why the pairs should be run again; empty while they need not.
        matrix: Picture of the scores, as HTML.
        matrix_caption: What its colours and marks mean.
        curve: Picture of precision over recall, as HTML; empty without truth.
        curve_caption: The figures that go with it.
        choices: All pairs, best first.
        shown: (query, database) that the scene shows.
    """

    summary: str
    outdated: str
    matrix: str
    matrix_caption: str
    curve: str
    curve_caption: str
    choices: tuple[Choice, ...]
    shown: tuple[str, str]


class AllPairsPanel:
    """Widgets for all pairs; callbacks run in the server's event loop and must be quick."""

    def __init__(
        self,
        host: Host,
        rules: tuple[str, ...],
        *,
        on_run: Callable[[], None],
        on_cancel: Callable[[], None],
        on_rule: Callable[[str], None],
        on_pair: Callable[[str, str], None],
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            rules: Names of the rules by which a pair is truly the same place.
            on_run: Called when all pairs are asked for.
            on_cancel: Called when they are no longer wanted.
            on_rule: Given the name of the rule chosen.
            on_pair: Given the query and the database to show.
        """
        gui = host.gui
        self._on_pair = on_pair
        self._choices: tuple[Choice, ...] = ()
        self._listed: dict[str, Choice] = {}
        gui.add_html(paragraph(INTRODUCTION, FAINT))
        self._run = gui.add_button("Run all pairs", hint="Sliders can be used while it runs.")
        self._cancel = gui.add_button("Cancel", visible=False, color="red")
        self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
        self._message = gui.add_html("")
        self._summary = gui.add_html("")
        self._matrix = gui.add_html("")
        self._narrow: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "List",
            (ALL,),
            initial_value=ALL,
            visible=False,
            hint="Which pairs to choose from. Right, wrong: accepted, and truly the same place or "
            "not. Missed: the same place, but refused.",
        )
        self._pair: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Pair",
            (NO_CHOICE,),
            initial_value=NO_CHOICE,
            visible=False,
            hint="Shows it; highest score first: query → database · score · what became of it.",
        )
        self._steps = gui.add_button_group(
            "Step pair", ("previous", "next"), visible=False, hint="Step through the list."
        )
        self._rule = gui.add_dropdown(
            "True if",
            rules,
            initial_value=rules[0],
            visible=False,
            hint="When the true poses say that a pair shows the same place.",
        )
        self._curve = gui.add_html("")

        @self._run.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            on_run()

        @self._cancel.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            on_cancel()

        @self._rule.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is not None:
                on_rule(event.target.value)

        @self._narrow.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is not None:
                self._list(None)

        @self._pair.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is not None:
                self._report()

        @self._steps.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            self._step(1 if event.target.value == "next" else -1)

    def running(self, fraction: float) -> None:
        """Show how far the run is."""
        self._run.visible = False
        self._cancel.visible = True
        self._bar.visible = True
        self._bar.value = 100 * min(max(fraction, 0.0), 1.0)
        self._message.content = _line(f"Running all pairs … {100 * fraction:.0f} %", BUSY)

    def stopped(self, message: str = "", *, bad: bool = False) -> None:
        """Show that nothing runs, and why if there is something to say."""
        self._run.visible = True
        self._cancel.visible = False
        self._bar.visible = False
        self._message.content = _line(message, BAD if bad else BUSY) if message else ""

    def clear(self) -> None:
        """Forget what was found: another dataset is open."""
        self._choices, self._listed = (), {}
        for html in (self._summary, self._matrix, self._curve, self._message):
            html.content = ""
        for widget in (self._narrow, self._pair, self._steps, self._rule):
            widget.visible = False

    def show(self, findings: Findings) -> None:
        """Show what was found."""
        note = _line(findings.outdated, BUSY) if findings.outdated else ""
        self._summary.content = paragraph(findings.summary, "font-weight:600") + note
        self._matrix.content = _figure(findings.matrix, findings.matrix_caption)
        self._curve.content = _figure(findings.curve, findings.curve_caption)
        self._choices = findings.choices
        outcomes = tuple(dict.fromkeys(choice.outcome for choice in findings.choices))
        self._narrow.options = (ALL, *sorted(outcomes))
        for widget in (self._narrow, self._pair, self._steps):
            widget.visible = bool(findings.choices)
        self._rule.visible = bool(findings.curve_caption)
        self._list(findings.shown)

    def _list(self, shown: tuple[str, str] | None) -> None:
        """Fill the list; keep what it points at, or point at the pair that is shown."""
        wanted = self._listed.get(self._pair.value)
        kept = shown or (None if wanted is None else (wanted.query, wanted.database))
        narrow = self._narrow.value
        chosen = [choice for choice in self._choices if narrow in (ALL, choice.outcome)]
        self._listed = {choice.label: choice for choice in chosen[:MOST_CHOICES]}
        first = NO_CHOICE
        if len(chosen) > MOST_CHOICES:
            first = f"choose a pair … ({MOST_CHOICES} best of {len(chosen):,})"
        self._pair.options = (first, *self._listed)
        labels = [
            label
            for label, choice in self._listed.items()
            if (choice.query, choice.database) == kept
        ]
        self._pair.value = labels[0] if labels else first

    def _step(self, step: int) -> None:
        labels = list(self._listed)
        if not labels:
            return
        here = labels.index(self._pair.value) if self._pair.value in self._listed else -1
        place = 0 if here < 0 else (here + step) % len(labels)
        self._pair.value = labels[place]
        self._report()

    def _report(self) -> None:
        choice = self._listed.get(self._pair.value)
        if choice is not None:
            self._on_pair(choice.query, choice.database)


def _line(text: str, color: str) -> str:
    return (
        f'<div data-testid="all-pairs-message" role="status" style="padding:.1em .75em;'
        f'font-size:.8em;color:{color}">{escape(text)}</div>'
    )


def _figure(picture: str, caption: str) -> str:
    """Put a caption under a picture that a view has made."""
    if not picture and not caption:
        return ""
    return f'<div style="padding:.2em .75em">{picture}</div>{paragraph(caption, FAINT)}'
