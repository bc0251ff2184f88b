"""What is said of the search for a loop closure: a note over the picture, and "Show best"."""

from collections.abc import Callable
from html import escape

import viser

from app.viewer.host import Host
from app.viewer.web import viser_parts
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.bridge import run_when_shown, say
from app.viewer.widgets.html import button

# The first act of a person that follows is told once: a key, a press anywhere, or the wheel. What
# viser itself puts up, such as its warning of a slow graphics card, may be put away.
WATCH = """
(number => {
  const kinds = ['pointerdown', 'keydown', 'wheel'];
  if (window.gpgradWatched === undefined) {
    for (const kind of kinds) document.addEventListener(kind, event => {
      const number = window.gpgradWatched;
      const over = event.target.closest && event.target.closest(NOTICE);
      if (number === null || over) return;
      window.gpgradWatched = null;
      gpgrad.say('touched', {number});
    }, {capture: true, passive: true});
  }
  window.gpgradWatched = number;
})(NUMBER)
""".replace("NOTICE", repr(viser_parts()["VISER_NOTIFICATION"]))
# Over the lower middle of the picture: the panels cover its sides, and the caption is above. No row
# of a panel moves.
PLACE = (
    "position:fixed;bottom:52px;left:50%;transform:translateX(-50%);z-index:4;box-sizing:border-box;"
    "width:max-content;max-width:min(27rem,94vw);padding:.5em .8em;border-radius:.5em;"
    "font-size:.85em;line-height:1.45;background:light-dark(#fff,#2b2b2b);"
    "color:light-dark(#222,#eee);border:1px solid light-dark(#b5b5b5,#666);"
    "box-shadow:0 2px 8px rgba(0,0,0,.25)"
)
APART = "margin:.4em .5em 0 0"


class BestPairNote:
    """A note that lies over the picture; it is there while there is something to say."""

    def __init__(self, host: Host) -> None:
        """Make it in the current container, empty."""
        self._handle = host.gui.add_html("")

    @property
    def said(self) -> str:
        """The note as HTML."""
        return self._handle.content

    def say(
        self, text: str, choices: tuple[tuple[str, str, str], ...] = (), *, watch: int | None = None
    ) -> None:
        """Say something.

        Args:
            text: The note.
            choices: Buttons below it: label, query and database of the pair that each shows.
            watch: Number to tell when somebody acts on the page; None watches nothing.
        """
        script = ""
        if watch is not None:
            script = run_when_shown(WATCH.replace("NUMBER", str(watch)))
        buttons = [
            button(label, say("show-pair", query=query, database=database), APART)
            for label, query, database in choices
        ]
        if watch is None:
            buttons.append(button("Close", say("close-note"), APART))
        self._handle.content = (
            f'<div data-testid="best-pair" role="status" style="{PLACE}">{escape(text)}'
            f"<div>{''.join(buttons)}</div></div>{script}"
        )

    def clear(self) -> None:
        """Say nothing."""
        if self._handle.content:
            self._handle.content = ""


class ShowBestButton:
    """Shows the best loop closure of all pairs."""

    def __init__(self, host: Host, on_show: Callable[[], None]) -> None:
        """Make it in the current container; it cannot be pressed until there is a best pair."""
        self._button: viser.GuiButtonHandle = host.gui.add_button(
            "Show best",
            disabled=True,
            hint="Shows the loop closure with the highest score of all pairs that were run.",
        )
        on_press(self._button, on_show)

    def offer(self, offered: bool) -> None:
        """Say whether there is a best pair."""
        self._button.disabled = not offered
