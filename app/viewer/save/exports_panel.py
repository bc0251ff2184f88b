"""Exports: loop closures, maps and a picture of the view."""

from collections.abc import Callable

import viser

from app.viewer.host import Host
from app.viewer.widgets.actions import on_press_by
from app.viewer.widgets.work_bar import WorkBar


class ExportPanel:
    """A list and a button for each kind of file; callbacks must only hand on."""

    def __init__(
        self,
        host: Host,
        *,
        closures: tuple[str, ...],
        maps: tuple[str, ...],
        on_closures: Callable[[str, viser.ClientHandle], None],
        on_map: Callable[[str, str, viser.ClientHandle], None],
        on_picture: Callable[[viser.ClientHandle], None],
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            closures: Formats of loop closures.
            maps: Formats of maps.
            on_closures: Given the format, and the page that wants the file.
            on_map: Given the format, "query" or "database", and the page.
            on_picture: Given the page.
        """
        gui = host.gui
        with gui.add_folder("Export"):
            self._closures = gui.add_dropdown(
                "Closures as",
                closures,
                initial_value=closures[0],
                hint="Format of the loop closures of all pairs.",
            )
            export = gui.add_button(
                "Export closures",
                hint="Registers all pairs with the present parameters where that is not done yet.",
            )
            self._map = gui.add_dropdown("Map as", maps, initial_value=maps[0])
            self._of = gui.add_dropdown(
                "Map of",
                ("query", "database"),
                initial_value="query",
                hint="Which submap to export.",
            )
            map_button = gui.add_button("Export map")
            picture = gui.add_button(
                "Export picture", hint="Saves what this page shows, without the panels."
            )
            self.work_bar = WorkBar(host, "Cancel export", "export", done_color="inherit")
        on_press_by(export, lambda page: on_closures(self._closures.value, page))
        on_press_by(map_button, lambda page: on_map(self._map.value, self._of.value, page))
        on_press_by(picture, on_picture)
