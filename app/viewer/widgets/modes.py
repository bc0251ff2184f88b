"""The three ways of use: look at all, tune a pair, show it to others."""

from collections.abc import Callable
from html import escape
from typing import Literal, TypeAlias, get_args

import viser

from app.viewer.host import Host

Way: TypeAlias = Literal["Explore", "Tune", "Demo"]

WAYS: tuple[Way, ...] = get_args(Way)
GUIDES: dict[Way, str] = {
    "Explore": "All submaps where they lie. Click one for its figures; correct the map in the tab "
    "Pose graph.",
    "Tune": "Do the two submaps show the same place? Drag a slider: surfaces, matches and verdict "
    "follow.",
    "Demo": "Show it to others: views, motion, full screen, and a page to take away.",
}
"""What is to be seen and what to do next."""


class WaysPanel:
    """Buttons for the ways, and a line on the present one."""

    def __init__(self, host: Host, way: Way, on_change: Callable[[Way], None]) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            way: The present one.
            on_change: Given the way that a user chose; must be quick.
        """
        self._buttons = host.gui.add_button_group(
            "Way",
            WAYS,
            hint="Explore all submaps, tune a pair, or demonstrate it.",
        )
        self._guide = host.gui.add_html("")
        self.show(way)

        @self._buttons.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            on_change(next(way for way in WAYS if way == event.target.value))

    def show(self, way: Way) -> None:
        """Say which way is the present one."""
        self._guide.content = (
            f'<div data-testid="way" style="padding:0 .75em .2em;font-size:.85em;line-height:1.45">'
            f'<b>{way}.</b> <span style="opacity:.75">{escape(GUIDES[way])}</span></div>'
        )
