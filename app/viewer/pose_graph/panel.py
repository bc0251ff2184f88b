"""The pose graph: closures, what becomes of each, and the correction of the map."""

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from typing import Any, Literal, TypeAlias, get_args

import viser

from app.viewer.host import Host
from app.viewer.widgets.html import BAD, BUSY, FAINT, paragraph, table

Verdict: TypeAlias = Literal["accept", "refuse", "as found"]
Format: TypeAlias = Literal["closures", "g2o", "TUM"]

VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
FORMATS: tuple[Format, ...] = get_args(Format)
NO_LOOP: str = "none"
MOST_LISTED = 300
"""Longer lists make the browser slow; accepted ones and the best of the others come first."""


@dataclass(frozen=True)
class Listed:
    """A closure as the list has it.

    Attributes:
        query: Id of the query submap.
        database: Id of the database submap.
        label: What the list says of it.
    """

    query: str
    database: str
    label: str


@dataclass(frozen=True)
class PoseGraphCalls:
    """What the panel calls; all must be quick.

    Attributes:
        on_find: Called when all pairs are to be compared.
        on_cancel: Called when what runs is no longer wanted.
        on_optimise: Called when the graph is to be optimised.
        on_shown: Given whether to draw accepted loops, and refused pairs.
        on_choose: Given the query and the database of the closure to look at, or None.
        on_verdict: Given what is to become of the chosen one.
        on_undo: Called to take the last decision back.
        on_tune: Called when the chosen one is to be seen in Tune.
        on_export: Given the page that wants a file, and its format.
    """

    on_find: Callable[[], None]
    on_cancel: Callable[[], None]
    on_optimise: Callable[[], None]
    on_shown: Callable[[bool, bool], None]
    on_choose: Callable[[tuple[str, str] | None], None]
    on_verdict: Callable[[Verdict], None]
    on_undo: Callable[[], None]
    on_tune: Callable[[], None]
    on_export: Callable[[viser.ClientHandle, Format], None]


class PoseGraphPanel:
    """Widgets of the pose graph."""

    def __init__(self, host: Host, calls: PoseGraphCalls) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            calls: What they call.
        """
        gui = host.gui
        self._calls = calls
        self._listed: dict[str, Listed] = {}
        self._summary = gui.add_html("")
        self._find = gui.add_button(
            "Find closures", hint="Compares every submap with all earlier ones, as All pairs does."
        )
        self._optimise = gui.add_button(
            "Optimise",
            hint="Corrects the poses by the accepted closures, and shows how the map relaxes. "
            "Closures that the others contradict are left out.",
        )
        self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
        self._cancel = gui.add_button("Cancel work", visible=False, color="red")
        self._message = gui.add_html("")
        self._result = gui.add_html("")
        self._legend = gui.add_html("")
        self._loops = gui.add_checkbox(
            "Accepted loops",
            initial_value=True,
            hint="Arches from submap to submap, coloured by score; black: the pose graph found "
            "that the others contradict it.",
        )
        self._refused = gui.add_checkbox(
            "Refused pairs", initial_value=False, hint="Thin grey arches."
        )
        self._choice: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Loop",
            (NO_LOOP,),
            initial_value=NO_LOOP,
            hint="query → database · score · verdict · chi-square after optimising (it should be "
            "a few); the chosen one stands out in the scene.",
        )
        self._steps = gui.add_button_group(
            "Step loop", ("previous", "next"), hint="Step through the list."
        )
        self._verdicts = gui.add_button_group(
            "By hand",
            VERDICTS,
            hint="Accept: the pose graph keeps it whatever the others say. As found: by the "
            "thresholds again.",
        )
        self._undo = gui.add_button(
            "Undo decision", disabled=True, hint="Takes the last decision back."
        )
        self._tune = gui.add_button(
            "See it in Tune", hint="There its motion can also be nudged and refined."
        )
        self._export = gui.add_button_group(
            "Export",
            FORMATS,
            hint="closures: JSON with all verdicts. g2o: vertices and edges. TUM: the poses, "
            "corrected if they have been optimised.",
        )
        self._bind()

    def _bind(self) -> None:
        calls = self._calls

        @self._find.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            calls.on_find()

        @self._cancel.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            calls.on_cancel()

        @self._optimise.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            calls.on_optimise()

        for box in (self._loops, self._refused):

            @box.on_update
            async def _(event: viser.GuiEvent[Any]) -> None:
                if event.client_id is not None:
                    calls.on_shown(self._loops.value, self._refused.value)

        @self._choice.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is not None:
                self._report()

        @self._steps.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            self._step(1 if event.target.value == "next" else -1)

        @self._verdicts.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            calls.on_verdict(next(one for one in VERDICTS if one == event.target.value))

        @self._undo.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            calls.on_undo()

        @self._tune.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            calls.on_tune()

        @self._export.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            if event.client is not None:
                chosen: Format = next(one for one in FORMATS if one == event.target.value)
                calls.on_export(event.client, chosen)

    def show(
        self,
        summary: tuple[str, ...],
        listed: tuple[Listed, ...],
        *,
        chosen: tuple[str, str] | None,
        can_undo: bool,
    ) -> None:
        """Show the closures as they are decided.

        Args:
            summary: A line each; the first stands out.
            listed: All that can be chosen, in order.
            chosen: (query, database) of the chosen one.
            can_undo: Whether there is a decision to take back.
        """
        head, *rest = summary
        self._summary.content = (
            f'<div data-testid="graph-summary">{paragraph(head, "font-weight:600")}'
            f"{''.join(paragraph(line, FAINT) for line in rest)}</div>"
        )
        self._listed = {one.label: one for one in listed[:MOST_LISTED]}
        more = len(listed) - len(self._listed)
        first = NO_LOOP if more <= 0 else f"{NO_LOOP} ({more:,} more are not listed)"
        self._choice.options = (first, *self._listed)
        labels = [
            label for label, one in self._listed.items() if (one.query, one.database) == chosen
        ]
        self._choice.value = labels[0] if labels else first
        self._undo.disabled = not can_undo

    def show_result(self, rows: tuple[tuple[str, str], ...]) -> None:
        """Show figures of the optimised graph, or none."""
        self._result.content = (
            f'<div data-testid="graph-result" style="padding:.1em .75em">{table(rows)}</div>'
            if rows
            else ""
        )

    def show_legend(self, legend: str) -> None:
        """Show what the colours of the loops mean, as HTML that is safe."""
        self._legend.content = legend

    def running(self, what: str, fraction: float) -> None:
        """Show what runs and how far it is."""
        self._set_running(True)
        self._bar.value = 100 * min(max(fraction, 0.0), 1.0)
        self._message.content = _line(f"{what} … {100 * fraction:.0f} %", BUSY)

    def stopped(self, message: str = "", *, bad: bool = False) -> None:
        """Show that nothing runs, and why if there is something to say."""
        self._set_running(False)
        self._message.content = _line(message, BAD if bad else BUSY) if message else ""

    def _set_running(self, running: bool) -> None:
        self._bar.visible = self._cancel.visible = running
        self._find.visible = self._optimise.visible = not running

    def _step(self, step: int) -> None:
        labels = list(self._listed)
        if not labels:
            return
        here = labels.index(self._choice.value) if self._choice.value in self._listed else -1
        self._choice.value = labels[0 if here < 0 else (here + step) % len(labels)]
        self._report()

    def _report(self) -> None:
        one = self._listed.get(self._choice.value)
        self._calls.on_choose(None if one is None else (one.query, one.database))


def _line(text: str, color: str) -> str:
    return (
        f'<div data-testid="graph-message" role="status" style="padding:.1em .75em;'
        f'font-size:.8em;color:{color}">{escape(text)}</div>'
    )
