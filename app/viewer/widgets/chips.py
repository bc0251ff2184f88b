"""Chips: a word on the number box of a slider that says where its value comes from.

viser has none. A script of ours puts them there, and says when one is pressed; that depends on how
viser builds its pages, as the bridge does, and a browser test watches it.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

import viser
from msgspec import Struct

from app.viewer.server.host import Host
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import Bridge, inline_script


@dataclass(frozen=True)
class Chip:
    """What a chip says.

    Attributes:
        word: One short word.
        hint: Shown where the pointer rests on it.
        back: Whether it can be pressed, to go back.
    """

    word: str
    hint: str
    back: bool = False


class _Pressed(Struct):
    """The slider whose chip was pressed."""

    widget: str


class Chips:
    """The chips of some sliders."""

    def __init__(self, host: Host, bridge: Bridge) -> None:
        """Put script and style into the current container, unseen; there is no chip yet."""
        self.pressed: Callable[[str], None] = lambda widget: None  # noqa: ARG005
        self._handle = host.gui.add_html("")
        self._shown: Mapping[str, Chip] = {}
        bridge.on_message("way-back", _Pressed, self._hear)

    @property
    def shown(self) -> Mapping[str, Chip]:
        """The chips, by the name of their slider."""
        return self._shown

    def show(self, chips: Mapping[str, Chip]) -> None:
        """Show chips, by the names of their sliders; nothing is sent if they are there already."""
        if chips == self._shown:
            return
        self._shown = chips
        named = {widget: asdict(chip) for widget, chip in chips.items()}
        self._handle.content = (
            f"<style>{fill_page_file('chips.css')}</style>"
            f"{inline_script(fill_page_file('chips.js', CHIPS=named))}"
        )

    def _hear(self, page: viser.ClientHandle, pressed: _Pressed) -> None:
        del page
        chip = self._shown.get(pressed.widget)
        if chip is not None and chip.back:
            self.pressed(pressed.widget)
