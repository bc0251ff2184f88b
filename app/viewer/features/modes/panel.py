"""The three modes: explore all submaps, tune a pair, demonstrate it to others."""

from collections.abc import Callable
from html import escape
from typing import get_args

from app.viewer.features.desk import Mode
from app.viewer.server.host import Host
from app.viewer.widgets.actions import on_option, one_of
from app.viewer.widgets.html import QUIET
from app.viewer.widgets.look import segment_style

MODES: tuple[Mode, ...] = get_args(Mode)
GUIDES: dict[Mode, str] = {
    "Explore": "All submaps at their poses. Click one for its figures. The tab Pose graph corrects "
    "the map.",
    "Tune": "Do the two submaps show the same place? Drag a slider: surfaces and verdict follow.",
    "Demo": "Show it to others with saved views, motion and full screen, or save it as a page.",
}
"""What is to be seen in a mode, and what to do next."""


class ModesPanel:
    """Buttons for the modes, and a line on the present one."""

    def __init__(self, host: Host, mode: Mode, on_change: Callable[[Mode], None]) -> None:
        """Make the widgets in the current container; they report the mode that a user chose."""
        self._buttons = host.gui.add_button_group(
            "Mode",
            MODES,
            hint="Explore all submaps, tune a pair, or show it to others.",
        )
        self._guide = host.gui.add_html("")
        self.show(mode)

        on_option(self._buttons, lambda label: on_change(one_of(MODES, label)))

    def show(self, mode: Mode) -> None:
        """Say which mode is the present one."""
        self._guide.content = (
            f"{segment_style(self._buttons, MODES.index(mode))}"
            f'<div data-testid="mode" aria-label="Mode {mode}" style="padding:0 .75em .3em;'
            f'font-size:.8em;line-height:1.4;height:2.8em;overflow:hidden;color:{QUIET}">'
            f"{escape(GUIDES[mode])}</div>"
        )
