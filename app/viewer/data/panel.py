"""Choose a dataset, and in it the query and the database submap."""

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from pathlib import PurePath

import viser

from app.viewer.host import Host
from app.viewer.state import Role, ViewState, neighbour
from app.viewer.widgets.html import BAD, FAINT, paragraph
from gpgrad_core.types import Dataset

NO_RECENT: str = "—"
UP: str = "↑ up"
CHOOSE: str = "choose …"


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


@dataclass(frozen=True)
class Choices:
    """What a folder on the server offers.

    Attributes:
        place: The folder, as people are shown it.
        entries: Names to choose from: folders end in "/".
        can_open: Whether the folder itself can be opened.
        note: What else there is to say.
    """

    place: str
    entries: tuple[str, ...]
    can_open: bool
    note: str = ""


class DatasetPanel:
    """Ways to open another dataset: recent, by path, by choosing a folder, by uploading."""

    def __init__(
        self,
        host: Host,
        *,
        on_load: Callable[[str], None],
        on_demo: Callable[[], None],
        on_cancel: Callable[[], None],
        on_enter: Callable[[str], None] | None = None,
        on_open_here: Callable[[], None] | None = None,
        on_upload: Callable[[str, bytes], None] | None = None,
        upload_hint: str = "",
    ) -> None:
        """Make the widgets in the current container; callbacks must only hand on.

        Args:
            host: Whose GUI they join.
            on_load: Given the path as typed, or chosen among the recent ones.
            on_demo: Called for the built-in demo.
            on_cancel: Called when loading is no longer wanted.
            on_enter: Given the name chosen in the folder, or "" for the folder above; None where
                no folder may be looked into.
            on_open_here: Called to open the folder that is looked into.
            on_upload: Given the name and the content of a file; None where none may be uploaded.
            upload_hint: How large it may be.
        """
        gui = host.gui
        self._recent: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Recent", (NO_RECENT,), initial_value=NO_RECENT, hint="Datasets opened before."
        )
        self._path = gui.add_text(
            "Folder",
            "",
            hint="A dataset folder, a folder of clouds, or one cloud, "
            "on the machine that runs the viewer.",
        )
        self._buttons = gui.add_button_group(
            "Open", ("Load", "Load demo"), hint="Load the folder above, or the built-in demo."
        )
        self._place = gui.add_html("", visible=on_enter is not None)
        self._entries: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Browse",
            (CHOOSE,),
            initial_value=CHOOSE,
            visible=on_enter is not None,
            hint="Look into a folder of the machine that runs the viewer, or choose a cloud.",
        )
        self._here = gui.add_button("Use this folder", visible=False)
        self._upload = gui.add_upload_button(
            "Upload clouds or a .zip",
            visible=on_upload is not None,
            hint="A zipped dataset, or a cloud; further clouds join those uploaded before. "
            + upload_hint,
        )
        self._cancel = gui.add_button("Cancel loading", visible=False, color="red")
        self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
        self._message = gui.add_html("")

        @self._buttons.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            if event.target.value == "Load demo":
                on_demo()
            else:
                on_load(self._path.value.strip())

        @self._recent.on_update
        async def _(event: viser.GuiEvent[viser.GuiDropdownHandle[str]]) -> None:
            if event.client_id is not None and event.target.value != NO_RECENT:
                on_load(event.target.value)

        @self._cancel.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            on_cancel()

        @self._entries.on_update
        async def _(event: viser.GuiEvent[viser.GuiDropdownHandle[str]]) -> None:
            chosen = event.target.value
            if event.client_id is not None and chosen != CHOOSE and on_enter is not None:
                on_enter("" if chosen == UP else chosen)

        @self._here.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            if on_open_here is not None:
                on_open_here()

        @self._upload.on_upload
        async def _(event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
            if on_upload is not None:
                file = event.target.value
                on_upload(PurePath(file.name.replace("\\", "/")).name, file.content)

    def loading(self, path: str, fraction: float = 0.0) -> None:
        """Say that a dataset is being read, and how far that is."""
        self._message.content = paragraph(f"Loading {path} …", FAINT)
        self._bar.value = 100 * min(max(fraction, 0.0), 1.0)
        self._set_loading(True)

    def show(self, path: str) -> None:
        """Say which path is open."""
        self._path.value = path
        self._message.content = ""
        self._set_loading(False)

    def stopped(self, message: str) -> None:
        """Say that nothing is being read any more."""
        self._message.content = paragraph(message, FAINT)
        self._set_loading(False)

    def error(self, message: str) -> None:
        """Say why a dataset was not opened; the one that is open stays."""
        self._message.content = (
            f'<div data-testid="dataset-error">{paragraph(message, f"color:{BAD}")}</div>'
        )
        self._set_loading(False)

    def show_recent(self, paths: tuple[str, ...]) -> None:
        """Offer the datasets opened before."""
        self._recent.options = (NO_RECENT, *paths)
        self._recent.value = NO_RECENT

    def show_folder(self, choices: Choices) -> None:
        """Offer what is in a folder."""
        note = f"<br>{escape(choices.note)}" if choices.note else ""
        self._place.content = (
            f'<div data-testid="place" style="padding:0 .75em;font-size:.85em;'
            f'overflow-wrap:anywhere">{escape(choices.place)}{note}</div>'
        )
        self._entries.options = (CHOOSE, *choices.entries)
        self._entries.value = CHOOSE
        self._here.visible = choices.can_open

    def _set_loading(self, loading: bool) -> None:
        self._cancel.visible = loading
        self._bar.visible = loading


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
            self.step("query", 1 if event.target.value == "next" else -1)

        @database_steps.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            self.step("database", 1 if event.target.value == "next" else -1)

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

    def step(self, role: Role, step: int) -> None:
        """Go to the next (1) or the previous (-1) query or database submap, and report it."""
        moved, other = self._query, self._database
        if role == "database":
            moved, other = other, moved
        moved.value = neighbour(self._dataset, moved.value, step, skip=other.value)
        self._report()

    def _report(self) -> None:
        self._on_change(self._query.value, self._database.value)
