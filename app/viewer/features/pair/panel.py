"""The tab View: what is open, and how it is drawn."""

from collections.abc import Callable
from dataclasses import replace
from html import escape
from typing import Any

import viser

from app.viewer.scene.layers import NUM_BINS, Scale
from app.viewer.server.host import Host
from app.viewer.session.state import ViewOptions, as_drawn
from app.viewer.widgets.actions import on_choice
from app.viewer.widgets.html import BUSY, SMALL, paragraph
from app.viewer.widgets.legend import legend_html
from app.viewer.widgets.numbers import Numbers
from app.viewer.widgets.panel import Panel
from gpgrad_core.errors import count
from gpgrad_core.types import Dataset

UNPICKED: dict[str, Any] = {"picked": "none", "picked_low": 0.0, "picked_high": 0.0}
"""Options of values none of which are picked out."""
UNLOCKED: dict[str, Any] = {"locked": "none", "low": 0.0, "high": 1.0}
"""Options of a range that follows the ground."""


class DatasetSummary:
    """What is open, and what loading left out."""

    def __init__(self, host: Host) -> None:
        self._handle = host.gui.add_html("")

    @property
    def html(self) -> str:
        return self._handle.content

    def show(self, dataset: Dataset) -> None:
        submaps = count(len(dataset.submaps), "submap")
        lines = [paragraph(f"{dataset.name} · {submaps}", "font-weight:600")]
        if dataset.description:
            lines.append(paragraph(dataset.description, "opacity:.8"))
        self._handle.content = "".join(lines) + _notes(dataset.notes)


def _notes(notes: tuple[str, ...]) -> str:
    """Write what loading left out as one line, which unfolds."""
    if not notes:
        return ""
    rest = "".join(paragraph(note, f"color:{BUSY}") for note in notes)
    return (
        '<details data-testid="notes"><summary style="padding:0 .75em;cursor:pointer;'
        f"overflow:hidden;font-size:{SMALL};color:{BUSY};white-space:nowrap;"
        f'text-overflow:ellipsis">{count(len(notes), "note")}: {escape(notes[0])}</summary>'
        f"{rest}</details>"
    )


class ViewPanel(Panel[ViewOptions]):
    """The options of the view, with the legend of the colours among them."""

    _scale: Scale | None = None
    _legend: viser.GuiHtmlHandle
    _ends: viser.GuiVector2Handle
    _lock: viser.GuiCheckboxHandle

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

        def add_range() -> None:
            self._ends = host.gui.add_vector2(
                "Range",
                (0.0, 1.0),
                step=0.001,
                visible=False,
                hint="Values at the ends of the colours. What is typed here is locked.",
            )
            self._lock = host.gui.add_checkbox(
                "Lock range",
                initial_value=False,
                visible=False,
                hint="Keeps the range of this layer whatever is set, and in links. Otherwise it "
                "follows the ground, but never while a slider is held.",
            )

        super().__init__(
            host,
            options,
            on_change,
            folder="Layers",
            below={"layer": add_legend, "Layers": add_range},
            implied=as_drawn,
            numbers=numbers,
        )
        on_choice(self._ends, lambda ends: self._lock_range(*ends))
        on_choice(self._lock, lambda on: self._lock_range(*self._ends.value, on=on))

    def _lock_range(self, low: float, high: float, *, on: bool = True) -> None:
        """Lock the range of the layer, or let it go; one that is half typed is none."""
        if on and low >= high:
            return
        ends = {"locked": as_drawn(self.value).layer, "low": low, "high": high} if on else {}
        self.set(replace(self.value, **(UNLOCKED | ends)))
        self._on_change(self.value)

    def pick(self, low: float, high: float) -> None:
        """Pick values out, their ends as shares of the range, or let go of those that are."""
        if self._scale is None:
            return
        start, span = self._scale.low, self._scale.high - self._scale.low
        if high - low < 0.5 / NUM_BINS:  # a click, and no drag
            low = int(min(low, 1 - 1e-9) * NUM_BINS) / NUM_BINS
            high = low + 1 / NUM_BINS
            before, middle = as_drawn(self.value).picked_values, start + span * (low + high) / 2
            if before is not None and before[0] <= middle <= before[1]:
                low, high = 0.0, 0.0
        values = (float(f"{start + span * share:.4g}") for share in (low, high))
        ends = dict(zip(("picked_low", "picked_high"), values, strict=True))
        layer = as_drawn(self.value).layer if low < high else "none"
        picked = UNPICKED if layer == "none" else {"picked": layer} | ends
        self.set(replace(self.value, **picked))
        self._on_change(self.value)

    def show_range(self, scale: Scale | None) -> None:
        """Show the range of the colours, and whether it is locked."""
        self._scale = scale
        self._ends.visible = self._lock.visible = scale is not None
        if scale is not None:
            self._ends.value = float(f"{scale.low:.4g}"), float(f"{scale.high:.4g}")
            self._lock.value = as_drawn(self.value).ends is not None

    def show_legend(self, scale: Scale | None, histogram: str = "", note: str = "") -> None:
        """Show what the colours mean, with a histogram and a line about it; None shows none."""
        self._legend.content = legend_html(scale, histogram=histogram, note=note)
