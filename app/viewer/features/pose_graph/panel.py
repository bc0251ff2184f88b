"""The pose graph: closures, what becomes of each, and the correction of the map."""

from collections.abc import Callable, Mapping
from typing import Literal, TypeAlias, get_args

from app.viewer.server.host import Host
from app.viewer.session.decisions import DECIDES, Pair
from app.viewer.widgets.html import FAINT, paragraph, table
from app.viewer.widgets.pair_list import PairList
from app.viewer.widgets.work_bar import WorkBar

Format: TypeAlias = Literal["closures", "g2o", "TUM"]

FORMATS: tuple[Format, ...] = get_args(Format)
NO_LOOP: str = "none"


class PoseGraphPanel:
    """Widgets of the pose graph; the tab binds what they do."""

    def __init__(self, host: Host, on_choose: Callable[[Pair | None], None]) -> None:
        """Make the widgets in the current container; the list reports the pair chosen, or None."""
        gui = host.gui
        self.summary = gui.add_html("")
        self.find = gui.add_button(
            "Find closures",
            hint="Compares every submap with all earlier ones, like the tab All pairs.",
        )
        self.optimise = gui.add_button(
            "Optimise",
            hint="Corrects the poses with the accepted closures, and shows how the map moves. "
            "Closures that the others contradict are left out.",
        )
        self.work_bar = WorkBar(host, "Cancel work", "graph", starts=(self.find, self.optimise))
        self._result = gui.add_html("")
        self._legend = gui.add_html("")
        self.loops = gui.add_checkbox(
            "Accepted loops",
            initial_value=True,
            hint="Arches between submaps, coloured by score. A black one contradicts the others.",
        )
        self.refused = gui.add_checkbox(
            "Refused pairs", initial_value=False, hint="Draws them as thin grey arches."
        )
        self._pairs = PairList(
            host,
            "Loop",
            none=NO_LOOP,
            hint="query → database · score · verdict · chi-square after optimising, which should "
            "be a few. The chosen loop stands out in the scene.",
            on_choose=on_choose,
        )
        self.verdicts = gui.add_button_group(
            "By hand",
            tuple(DECIDES),
            hint="accept: the pose graph keeps the loop, whatever the others say. refuse: it "
            "leaves the loop out. as found: the thresholds decide again.",
        )
        self.undo = gui.add_button(
            "Undo decision", disabled=True, hint="Takes the last decision by hand back."
        )
        self.tune = gui.add_button(
            "See it in Tune",
            hint="Opens the pair in Tune, where you can also nudge and refine its motion.",
        )
        self.export = gui.add_button_group(
            "Export",
            FORMATS,
            hint="closures: all verdicts as JSON. g2o: the vertices and edges of the graph. TUM: "
            "the corrected poses.",
        )

    def show(
        self,
        summary: tuple[str, ...],
        listed: Mapping[str, Pair],
        *,
        chosen: Pair | None,
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
        self.summary.content = (
            f'<div data-testid="graph-summary">{paragraph(head, "font-weight:600")}'
            f"{''.join(paragraph(line, FAINT) for line in rest)}</div>"
        )
        self._pairs.offer(listed, chosen)
        self.undo.disabled = not can_undo

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
