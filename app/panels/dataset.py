"""Choose a dataset, and in it the query and the database submap."""

from collections.abc import Callable

import viser

from app.host import Host
from app.panels.text import BAD, paragraph
from app.state import ViewState, neighbour
from gpgrad_core.types import Dataset


class DatasetPanel:
    """A box for the path of a dataset, a button that loads it, and what came of it."""

    def __init__(
        self,
        host: Host,
        on_load: Callable[[str], None],
        on_demo: Callable[[], None],
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            on_load: Given the path as typed.
            on_demo: Called for the built-in demo.
        """
        gui = host.gui
        self._summary = gui.add_html("")
        self._path = gui.add_text(
            "Folder",
            "",
            hint="A dataset folder, a folder of clouds, or one cloud, "
            "on the machine that runs the viewer.",
        )
        self._buttons = gui.add_button_group(
            "Open", ("Load", "Demo"), hint="Load the folder above, or the built-in demo."
        )
        self._message = gui.add_html("")

        @self._buttons.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            if event.target.value == "Demo":
                on_demo()
            else:
                on_load(self._path.value.strip())

    def loading(self, path: str) -> None:
        """Say that a dataset is being read."""
        self._message.content = paragraph(f"Loading {path} …", "opacity:.7")

    def show(self, dataset: Dataset, path: str) -> None:
        """Show what is open, and what loading left out."""
        self._path.value = path
        many = "submap" if len(dataset.submaps) == 1 else "submaps"
        lines = [paragraph(f"{dataset.name} · {len(dataset.submaps)} {many}", "font-weight:600")]
        if dataset.description:
            lines.append(paragraph(dataset.description, "opacity:.8"))
        lines += [paragraph(f"Note: {note}", f"color:{BAD}") for note in dataset.notes]
        self._summary.content = "".join(lines)
        self._message.content = ""

    def error(self, message: str) -> None:
        """Say why a dataset was not opened; the one that is open stays."""
        self._message.content = (
            f'<div data-testid="dataset-error">{paragraph(message, f"color:{BAD}")}</div>'
        )


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
        ids = tuple(submap.id for submap in state.dataset.submaps)
        self._query = host.gui.add_dropdown(
            "Query", ids, initial_value=state.query_id, hint="Submap that is to be recognised."
        )
        query_steps = host.gui.add_button_group(
            "Step query", ("previous", "next"), hint="Step the query."
        )
        self._database = host.gui.add_dropdown(
            "Database",
            ids,
            initial_value=state.database_id,
            hint="Earlier submap that the query is compared with.",
        )
        database_steps = host.gui.add_button_group(
            "Step database", ("previous", "next"), hint="Step the database submap."
        )
        for dropdown in (self._query, self._database):

            @dropdown.on_update
            async def _(event: viser.GuiEvent[viser.GuiDropdownHandle[str]]) -> None:
                if event.client_id is not None:
                    self._report()

        @query_steps.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            self._step(self._query, self._database, event.target.value)

        @database_steps.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            self._step(self._database, self._query, event.target.value)

    def show(self, state: ViewState) -> None:
        """Offer the submaps of another dataset; ``on_change`` is not called."""
        self._dataset = state.dataset
        ids = tuple(submap.id for submap in state.dataset.submaps)
        for dropdown, chosen in (
            (self._query, state.query_id),
            (self._database, state.database_id),
        ):
            dropdown.options = ids
            dropdown.value = chosen

    def _step(
        self,
        moved: viser.GuiDropdownHandle[str],
        other: viser.GuiDropdownHandle[str],
        button: str,
    ) -> None:
        step = 1 if button.startswith("next") else -1
        moved.value = neighbour(self._dataset, moved.value, step, skip=other.value)
        self._report()

    def _report(self) -> None:
        self._on_change(self._query.value, self._database.value)
