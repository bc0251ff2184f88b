"""The tab View: what is open, which pair of it is shown, and how it is drawn."""

import threading
from collections.abc import Callable

import viser

from app.viewer.scene.layers import Scale
from app.viewer.server.host import Host
from app.viewer.session.state import Role, ViewOptions, ViewState, neighbour
from app.viewer.widgets.actions import on_choice
from app.viewer.widgets.html import BAD, paragraph
from app.viewer.widgets.legend import legend_html
from app.viewer.widgets.numbers import Numbers
from app.viewer.widgets.options import OptionsPanel
from gpgrad_core.types import Dataset


class DatasetSummary:
    """What is open, and what loading left out."""

    def __init__(self, host: Host) -> None:
        """Make it in the current container, empty."""
        self._handle = host.gui.add_html("")

    @property
    def html(self) -> str:
        """What is shown."""
        return self._handle.content

    def show(self, dataset: Dataset) -> None:
        """Show a dataset's name, size, description and notes."""
        many = "submap" if len(dataset.submaps) == 1 else "submaps"
        lines = [paragraph(f"{dataset.name} · {len(dataset.submaps)} {many}", "font-weight:600")]
        if dataset.description:
            lines.append(paragraph(dataset.description, "opacity:.8"))
        lines += [paragraph(f"Note: {note}", f"color:{BAD}") for note in dataset.notes]
        self._handle.content = "".join(lines)


class PairPanel:
    """Which submap is the query and which the database."""

    def __init__(self, host: Host, state: ViewState, on_change: Callable[[str, str], None]) -> None:
        """Make the widgets in the current container; they report the ids of both submaps."""
        self._dataset = state.dataset
        self._on_change = on_change
        self._lock = threading.Lock()  # a dataset is opened in another thread
        ids = tuple(submap.id for submap in state.dataset.submaps)
        gui = host.gui
        self._query = gui.add_dropdown(
            "Query",
            ids,
            initial_value=state.query_id,
            hint="The submap to recognise (J, Shift + J).",
        )
        self._database = gui.add_dropdown(
            "Database",
            ids,
            initial_value=state.database_id,
            hint="The earlier submap to compare the query with (M, Shift + M).",
        )
        self._pair = state.query_id, state.database_id  # as last shown or reported
        for dropdown in (self._query, self._database):
            on_choice(dropdown, lambda _: self._report())

    def show(self, state: ViewState) -> None:
        """Show a pair, and offer the submaps of its dataset; ``on_change`` is not called."""
        ids = tuple(submap.id for submap in state.dataset.submaps)
        with self._lock:
            other_dataset = state.dataset is not self._dataset
            self._dataset = state.dataset
            self._pair = state.query_id, state.database_id
            if self._database.visible != state.is_pair:
                self._database.visible = state.is_pair
            for dropdown, chosen in zip((self._query, self._database), self._pair, strict=True):
                if other_dataset:
                    dropdown.options = ids
                if dropdown.value != chosen:
                    dropdown.value = chosen

    def step(self, role: Role, step: int) -> None:
        """Go to the next (1) or the previous (-1) query or database submap, and report it."""
        moved, other = self._query, self._database
        if role == "database":
            moved, other = other, moved
        with self._lock:
            moved.value = neighbour(self._dataset, moved.value, step, skip=other.value)
        self._report()

    def _report(self) -> None:
        with self._lock:
            query, database = self._query.value, self._database.value
            if query == database and len(self._dataset.submaps) > 1:
                # Whoever names the other one of the pair has the two change places.
                database, query = self._pair
                self._query.value, self._database.value = query, database
            self._pair = query, database
        self._on_change(query, database)


class ViewPanel(OptionsPanel[ViewOptions]):
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
            numbers=numbers,
        )

    def show_legend(self, scale: Scale | None, histogram: str = "", note: str = "") -> None:
        """Show what the colours mean, with a histogram and a line about it; None shows none."""
        self._legend.content = legend_html(scale, histogram=histogram, note=note)
