"""Open another dataset: a recent one, by its path, from a folder, or by uploading it."""

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from pathlib import PurePath

import viser

from app.viewer.host import Host
from app.viewer.widgets.actions import on_choice, on_option, on_press, on_upload
from app.viewer.widgets.work_bar import WorkBar

NO_RECENT: str = "—"
UP: str = "↑ up"
CHOOSE: str = "choose …"


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


@dataclass(frozen=True)
class FolderCalls:
    """What the list of a folder on the server calls; all must be quick.

    Attributes:
        enter: Given the name chosen, or "" for the folder above.
        open_here: Called to open the folder itself.
    """

    enter: Callable[[str], None]
    open_here: Callable[[], None]


class DatasetPanel:
    """Ways to open another dataset: recent, by path, by choosing a folder, by uploading."""

    def __init__(
        self,
        host: Host,
        *,
        on_load: Callable[[str], None],
        on_demo: Callable[[], None],
        folder: FolderCalls | None = None,
        uploaded: Callable[[str, bytes], None] | None = None,
        upload_hint: str = "",
    ) -> None:
        """Make the widgets in the current container; callbacks must only hand on.

        Args:
            host: Whose GUI they join.
            on_load: Given the path as typed, or chosen among the recent ones.
            on_demo: Called for the built-in demo.
            folder: What the list of a folder calls; None where no folder may be browsed.
            uploaded: Given the name and the content of a file; None where uploads are not allowed.
            upload_hint: How large an upload may be.
        """
        gui = host.gui
        self._recent: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Recent",
            (NO_RECENT,),
            initial_value=NO_RECENT,
            hint="Open a dataset that was open before.",
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
        self._place = gui.add_html("", visible=folder is not None)
        self._entries: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Browse",
            (CHOOSE,),
            initial_value=CHOOSE,
            visible=folder is not None,
            hint="Enter a folder on the machine that runs the viewer, or choose a cloud.",
        )
        self._here = gui.add_button("Use this folder", visible=False)
        self._upload = gui.add_upload_button(
            "Upload clouds or a .zip",
            visible=uploaded is not None,
            hint="A zipped dataset, or a cloud. Further clouds join the ones that you uploaded "
            "before. " + upload_hint,
        )
        self.work_bar = WorkBar(host, "Cancel loading", "dataset")
        on_option(
            self._buttons,
            lambda label: on_demo() if label == "Load demo" else on_load(self._path.value.strip()),
        )
        on_choice(self._recent, lambda path: None if path == NO_RECENT else on_load(path))
        if folder is not None:
            on_choice(
                self._entries,
                lambda name: None if name == CHOOSE else folder.enter("" if name == UP else name),
            )
            on_press(self._here, folder.open_here)
        if uploaded is not None:
            on_upload(
                self._upload,
                lambda name, content: uploaded(PurePath(name.replace("\\", "/")).name, content),
            )

    def show(self, path: str) -> None:
        """Show which path is open."""
        self._path.value = path

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
