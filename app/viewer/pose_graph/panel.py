"""The pose graph: closures, what becomes of each, and the correction of the map."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import viser

from app.viewer.host import Host
from app.viewer.widgets.actions import on_choice, on_option, on_option_by, on_press, one_of
from app.viewer.widgets.html import FAINT, paragraph, table
from app.viewer.widgets.pair_list import PairList
from app.viewer.widgets.work_bar import WorkBar

Verdict: TypeAlias = Literal["accept", "refuse", "as found"]
Format: TypeAlias = Literal["closures", "g2o", "TUM"]

VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
FORMATS: tuple[Format, ...] = get_args(Format)
NO_LOOP: str = "none"


@dataclass(frozen=True)
class PoseGraphCalls:
    """What the panel calls; all must be quick.

    Attributes:
        on_find: Called when all pairs are to be compared.
        on_optimise: Called when the graph is to be optimised.
        on_shown: Given whether to draw accepted loops, and refused pairs.
        on_choose: Given the query and the database of the closure to look at, or None.
        on_verdict: Given what is to become of the chosen one.
        on_undo: Called to take the last decision back.
        on_tune: Called when the chosen one is to be seen in Tune.
        on_export: Given the page that wants a file, and its format.
    """

    on_find: Callable[[], None]
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
        self._summary = gui.add_html("")
        find = gui.add_button(
            "Find closures",
            hint="Compares every submap with all earlier ones, like the tab All pairs.",
        )
        optimise = gui.add_button(
            "Optimise",
            hint="Corrects the poses with the accepted closures, and shows how the map moves. "
            "Closures that the others contradict are left out.",
        )
        self.work_bar = WorkBar(host, "Cancel work", "graph", starts=(find, optimise))
        self._result = gui.add_html("")
        self._legend = gui.add_html("")
        loops = gui.add_checkbox(
            "Accepted loops",
            initial_value=True,
            hint="Arches between submaps, coloured by score. A black one contradicts the others.",
        )
        refused = gui.add_checkbox(
            "Refused pairs", initial_value=False, hint="Draws them as thin grey arches."
        )
        self._pairs = PairList(
            host,
            "Loop",
            none=NO_LOOP,
            hint="query → database · score · verdict · chi-square after optimising, which should "
            "be a few. The chosen loop stands out in the scene.",
            on_choose=calls.on_choose,
        )
        verdicts = gui.add_button_group(
            "By hand",
            VERDICTS,
            hint="accept: the pose graph keeps the loop, whatever the others say. refuse: it "
            "leaves the loop out. as found: the thresholds decide again.",
        )
        self._undo = gui.add_button(
            "Undo decision", disabled=True, hint="Takes the last decision by hand back."
        )
        tune = gui.add_button(
            "See it in Tune",
            hint="Opens the pair in Tune, where you can also nudge and refine its motion.",
        )
        export = gui.add_button_group(
            "Export",
            FORMATS,
            hint="closures: all verdicts as JSON. g2o: the vertices and edges of the graph. TUM: "
            "the corrected poses.",
        )
        on_press(find, calls.on_find)
        on_press(optimise, calls.on_optimise)
        for box in (loops, refused):
            on_choice(box, lambda _: calls.on_shown(loops.value, refused.value))
        on_option(verdicts, lambda label: calls.on_verdict(one_of(VERDICTS, label)))
        on_press(self._undo, calls.on_undo)
        on_press(tune, calls.on_tune)
        on_option_by(export, lambda page, label: calls.on_export(page, one_of(FORMATS, label)))

    def show(
        self,
        summary: tuple[str, ...],
        listed: Mapping[str, tuple[str, str]],
        *,
        chosen: tuple[str, str] | None,
        can_undo: bool,
    ) -> None:
        """Show the closures as they are decided.

        Args:
            summary: A line each; the first stands out.
            listed: (query, database) of all that can be chosen, by label and in order.
            chosen: (query, database) of the chosen one.
            can_undo: Whether there is a decision to take back.
        """
        head, *rest = summary
        self._summary.content = (
            f'<div data-testid="graph-summary">{paragraph(head, "font-weight:600")}'
            f"{''.join(paragraph(line, FAINT) for line in rest)}</div>"
        )
        self._pairs.offer(listed, chosen)
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
