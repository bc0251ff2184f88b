"""What is open, and which of its submaps are the query and the database."""

import threading
from collections.abc import Callable

from app.viewer.host import Host
from app.viewer.state import Role, ViewState, neighbour
from app.viewer.widgets.actions import on_choice, on_step
from app.viewer.widgets.html import BAD, paragraph
from gpgrad_core.types import Dataset


class DatasetSummary:
    """What is open, and what loading left out."""

    def __init__(self, host: Host) -> None:
        """Make it in the current container, empty."""
        self._handle = host.gui.add_html("")

    def show(self, dataset: Dataset) -> None:
        """Show a dataset's name, size, description and notes."""
        many = "submap" if len(dataset.submaps) == 1 else "submaps"
        lines = [paragraph(f"{dataset.name} · {len(dataset.submaps)} {many}", "font-weight:600")]
        if dataset.description:
            lines.append(paragraph(dataset.description, "opacity:.8"))
        lines += [paragraph(f"Note: {note}", f"color:{BAD}") for note in dataset.notes]
        self._handle.content = "".join(lines)


class PairPanel:
    """Which submap is the query and which the database; buttons step through them."""

    def __init__(
        self,
        host: Host,
        state: ViewState,
        on_change: Callable[[str, str], None],
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            state: What they start at.
            on_change: Given the ids of the query and the database submap.
        """
        self._dataset = state.dataset
        self._on_change = on_change
        self._lock = threading.Lock()  # a dataset is opened in another thread
        ids = tuple(submap.id for submap in state.dataset.submaps)
        self._query = host.gui.add_dropdown(
            "Query", ids, initial_value=state.query_id, hint="The submap to recognise."
        )
        self._query_steps = host.gui.add_button_group(
            "Step query", ("previous", "next"), hint="Go to the previous or the next query."
        )
        self._database = host.gui.add_dropdown(
            "Database",
            ids,
            initial_value=state.database_id,
            hint="The earlier submap to compare the query with.",
        )
        self._database_steps = host.gui.add_button_group(
            "Step database",
            ("previous", "next"),
            hint="Go to the previous or the next database submap.",
        )
        self._pair = state.query_id, state.database_id  # as last shown or reported
        for dropdown in (self._query, self._database):
            on_choice(dropdown, lambda _: self._report())
        on_step(self._query_steps, lambda step: self.step("query", step))
        on_step(self._database_steps, lambda step: self.step("database", step))

    def show(self, state: ViewState) -> None:
        """Show a pair, and offer the submaps of its dataset; ``on_change`` is not called."""
        ids = tuple(submap.id for submap in state.dataset.submaps)
        with self._lock:
            other_dataset = state.dataset is not self._dataset
            self._dataset = state.dataset
            self._pair = state.query_id, state.database_id
            for widget in (self._database, self._query_steps, self._database_steps):
                if widget.visible != state.is_pair:
                    widget.visible = state.is_pair
            for dropdown, chosen in (
                (self._query, state.query_id),
                (self._database, state.database_id),
            ):
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
