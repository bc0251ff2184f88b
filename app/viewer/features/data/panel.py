"""Open another dataset: a recent one, by its path, from a folder, or by uploading it."""

from collections.abc import Callable
from html import escape
from pathlib import Path, PurePath

import viser

from app.viewer.features.data.folders import Listing
from app.viewer.server.host import Host
from app.viewer.widgets.actions import on_choice, on_option, on_upload
from app.viewer.widgets.status import WorkBar

NO_RECENT: str = "—"
UP: str = "↑ up"
CHOOSE: str = "choose …"


class DatasetPanel:
    """Ways to open another dataset: recent, by path, by choosing a folder, by uploading."""

    def __init__(
        self,
        host: Host,
        *,
        on_load: Callable[[str], None],
        on_demo: Callable[[], None],
        on_enter: Callable[[str], None] | None = None,
        on_upload_file: Callable[[str, bytes], None] | None = None,
        upload_hint: str = "",
    ) -> None:
        """Make the widgets in the current container; callbacks must only hand on.

        Args:
            host: Whose GUI they join.
            on_load: Given the path as typed, or chosen among the recent ones.
            on_demo: Called for the built-in demo.
            on_enter: Given the name of an entry of the folder, or "" for the folder above; None
                where no folder may be browsed.
            on_upload_file: Given the name and the content of a file; None where uploads are not
                allowed.
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
        buttons = gui.add_button_group(
            "Open", ("Load", "Load demo"), hint="Load the folder above, or the built-in demo."
        )
        self.place = gui.add_html("", visible=on_enter is not None)
        self._entries: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Browse",
            (CHOOSE,),
            initial_value=CHOOSE,
            visible=on_enter is not None,
            hint="Enter a folder on the machine that runs the viewer, or choose a cloud.",
        )
        self.here = gui.add_button("Use this folder", visible=False)
        upload = gui.add_upload_button(
            "Upload clouds or a .zip",
            visible=on_upload_file is not None,
            hint="A zipped dataset, or a cloud. Further clouds join the ones that you uploaded "
            "before. " + upload_hint,
        )
        self.work_bar = WorkBar(host, "Cancel loading", "dataset")
        on_option(
            buttons,
            lambda label: on_demo() if label == "Load demo" else on_load(self._path.value.strip()),
        )
        on_choice(self._recent, lambda path: None if path == NO_RECENT else on_load(path))
        if on_enter is not None:
            on_choice(
                self._entries,
                lambda name: None if name == CHOOSE else on_enter("" if name == UP else name),
            )
        if on_upload_file is not None:
            on_upload(
                upload,
                lambda name, content: on_upload_file(
                    PurePath(name.replace("\\", "/")).name, content
                ),
            )

    def show(self, path: str) -> None:
        """Show which path is open."""
        self._path.value = path

    def show_recent(self, paths: tuple[str, ...]) -> None:
        """Offer the datasets opened before."""
        self._recent.options = (NO_RECENT, *paths)
        self._recent.value = NO_RECENT

    def show_folder(self, root: Path, listing: Listing) -> None:
        """Offer what is in a folder below a root."""
        note = ""
        if listing.num_hidden:
            note = f"<br>{listing.num_hidden:,} more are not listed; type the path"
        self.place.content = (
            f'<div data-testid="place" style="padding:0 .75em;font-size:.85em;'
            f'overflow-wrap:anywhere">{escape(str(root / listing.folder))}{note}</div>'
        )
        up = () if listing.folder == Path() else (UP,)
        self._entries.options = (CHOOSE, *up, *listing.entries)
        self._entries.value = CHOOSE
        self.here.visible = listing.is_dataset
