"""The tab View: what is open, and how it is drawn."""

from collections.abc import Callable

import viser

from app.viewer.scene.layers import Scale
from app.viewer.server.host import Host
from app.viewer.session.state import ViewOptions, as_drawn
from app.viewer.widgets.html import BAD, paragraph
from app.viewer.widgets.legend import legend_html
from app.viewer.widgets.numbers import Numbers
from app.viewer.widgets.panel import Panel
from gpgrad_core.types import Dataset


class DatasetSummary:
    """What is open, and what loading left out."""

    def __init__(self, host: Host) -> None:
        self._handle = host.gui.add_html("")

    @property
    def html(self) -> str:
        return self._handle.content

    def show(self, dataset: Dataset) -> None:
        many = "submap" if len(dataset.submaps) == 1 else "submaps"
        lines = [paragraph(f"{dataset.name} · {len(dataset.submaps)} {many}", "font-weight:600")]
        if dataset.description:
            lines.append(paragraph(dataset.description, "opacity:.8"))
        lines += [paragraph(f"Note: {note}", f"color:{BAD}") for note in dataset.notes]
        self._handle.content = "".join(lines)


class ViewPanel(Panel[ViewOptions]):
    """The options of the view, with the legend of the colours among them."""

    _legend: viser.GuiHtmlHandle

    def __init__(
        self,
        host: Host,
        options: ViewOptions,
        on_change: Callable[[ViewOptions], None],
        numbers: Numbers | None = None,
    ) -> None:
        """Make the widgets in the current container; they report the whole new options."""

        def add_legend() -> None:
            self._legend = host.gui.add_html("")

        super().__init__(
            host,
            options,
            on_change,
            folder="Layers",
            below={"layer": add_legend},
            implied=as_drawn,
            numbers=numbers,
        )

    def show_legend(self, scale: Scale | None, histogram: str = "", note: str = "") -> None:
        """Show what the colours mean, with a histogram and a line about it; None shows none."""
        self._legend.content = legend_html(scale, histogram=histogram, note=note)
