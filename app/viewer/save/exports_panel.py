"""Files to take away: loop closures, maps, a picture of the view."""

from collections.abc import Callable
from html import escape

import viser

from app.viewer.host import Host
from app.viewer.widgets.html import BAD, BUSY


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
        on_cancel: Callable[[], None],
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            closures: Formats of loop closures.
            maps: Formats of maps.
            on_closures: Given the format, and the page that wants the file.
            on_map: Given the format, "query" or "database", and the page.
            on_picture: Given the page.
            on_cancel: Called when the file is no longer wanted.
        """
        gui = host.gui
        with gui.add_folder("Export"):
            self._closures = gui.add_dropdown(
                "Closures as", closures, initial_value=closures[0], hint="Of all pairs."
            )
            export = gui.add_button(
                "Export closures",
                hint="Registers all pairs with the present parameters, as far as that is not done.",
            )
            self._map = gui.add_dropdown("Map as", maps, initial_value=maps[0])
            self._of = gui.add_dropdown(
                "Map of", ("query", "database"), initial_value="query", hint="Of which submap."
            )
            map_button = gui.add_button("Export map")
            picture = gui.add_button(
                "Export picture", hint="What this page shows, without the panels."
            )
            self._cancel = gui.add_button("Cancel export", visible=False, color="red")
            self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
            self._message = gui.add_html("")

        @export.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client is not None:
                on_closures(self._closures.value, event.client)

        @map_button.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client is not None:
                on_map(self._map.value, self._of.value, event.client)

        @picture.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client is not None:
                on_picture(event.client)

        @self._cancel.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            on_cancel()

    def running(self, what: str, fraction: float) -> None:
        """Show how far a file is."""
        self._cancel.visible = self._bar.visible = True
        self._bar.value = 100 * min(max(fraction, 0.0), 1.0)
        self._message.content = _line(f"Making {what} …", BUSY)

    def stopped(self, message: str, *, bad: bool = False) -> None:
        """Say what came of it."""
        self._cancel.visible = self._bar.visible = False
        self._message.content = _line(message, BAD if bad else "inherit")


def _line(text: str, color: str) -> str:
    return (
        f'<div data-testid="export" role="status" style="padding:.1em .75em;font-size:.8em;'
        f'overflow-wrap:anywhere;color:{color}">{escape(text)}</div>'
    )
