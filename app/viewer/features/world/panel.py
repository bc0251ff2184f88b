"""The tab World: which poses and colours, and the submap that is looked at."""

from collections.abc import Callable
from html import escape

import viser

from app.viewer.features.world.submaps import PoseSource, WorldOptions
from app.viewer.server.host import Host
from app.viewer.widgets.html import FAINT, paragraph, table
from app.viewer.widgets.options import OptionsPanel
from app.viewer.widgets.work_bar import WorkBar

NOTHING: str = "none"


class WorldPanel(OptionsPanel[WorldOptions]):
    """Widgets of the world and of one submap in it; the tab binds what they do."""

    work_bar: WorkBar
    legend: viser.GuiHtmlHandle

    def __init__(
        self, host: Host, options: WorldOptions, on_change: Callable[[WorldOptions], None]
    ) -> None:
        """Make the widgets in the current container; they report the whole new options."""
        gui = host.gui
        self._summary = gui.add_html("")

        def add_legend() -> None:
            self.legend = gui.add_html("")
            self.work_bar = WorkBar(host, "Cancel maps", "world")

        super().__init__(host, options, on_change, below={"color": add_legend})
        self.all = gui.add_button("Show all submaps", hint="Moves the camera back to all submaps.")
        self.chosen: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Submap",
            (NOTHING,),
            initial_value=NOTHING,
            hint="You can also click a submap in the scene.",
        )
        self.steps = gui.add_button_group(
            "Step submap", ("previous", "next"), hint="Go to the previous or the next submap."
        )
        self.figures = gui.add_html("")
        self.look = gui.add_button(
            "Look at it", visible=False, hint="Moves the camera to this submap."
        )
        self.roles = gui.add_button_group(
            "Tune it as",
            ("query", "database"),
            visible=False,
            hint="Opens this submap in Tune, as the query or the database.",
        )

    def offer_world(
        self, options: WorldOptions, sources: tuple[PoseSource, ...], ids: tuple[str, ...]
    ) -> None:
        """Show options, and what there is to choose from; nothing is called."""
        self.offer("poses", sources)
        self.set(options)
        if tuple(self.chosen.options) != (NOTHING, *ids):
            self.chosen.options = (NOTHING, *ids)
            self.chosen.value = NOTHING

    def select(self, name: str | None, rows: tuple[tuple[str, str], ...]) -> None:
        """Show which submap is chosen, and its figures."""
        self.chosen.value = NOTHING if name is None else name
        self.look.visible = self.roles.visible = name is not None
        if name is None:
            self.figures.content = paragraph("Click a submap in the scene.", FAINT)
            return
        self.figures.content = (
            f'<div data-testid="submap-figures" style="padding:.1em .75em .3em">'
            f"<b>Submap {escape(name)}</b>{table(rows)}</div>"
        )

    def show_summary(self, lines: tuple[str, ...]) -> None:
        """Say what is shown, a line each; the first stands out."""
        head, *rest = lines
        self._summary.content = (
            f'<div data-testid="world-summary">{paragraph(head, "font-weight:600")}'
            f"{''.join(paragraph(line, FAINT) for line in rest)}</div>"
        )
