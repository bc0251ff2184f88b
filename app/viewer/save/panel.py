"""The command that gives the same result, and the session as a file."""

from collections.abc import Callable
from html import escape

import viser

from app.viewer.host import Host
from app.viewer.widgets.actions import on_press_by, on_upload
from app.viewer.widgets.bridge import say
from app.viewer.widgets.html import BAD, FAINT, button, paragraph

# The button's own script: a page may write to the clipboard only while it is being clicked, and
# only if it comes from this machine or over HTTPS; elsewhere a selected box is copied from.
COPY = (
    "const box=this.parentNode.querySelector('textarea');box.select();"
    "const done=()=>{this.textContent='Copied'};"
    "if(navigator.clipboard){navigator.clipboard.writeText(box.value).then(done)}"
    "else if(document.execCommand('copy')){done()}"
)


class SavingPanel:
    """The command in a box with a button that copies it; buttons that save and restore."""

    def __init__(
        self,
        host: Host,
        *,
        on_save: Callable[[viser.ClientHandle], None],
        on_restore: Callable[[str, bytes], None],
    ) -> None:
        """Make the widgets in the current container; callbacks must only hand on.

        Args:
            host: Whose GUI they join.
            on_save: Given the page that wants the session as a file.
            on_restore: Given the name and the content of a file.
        """
        gui = host.gui
        self._command = gui.add_html("")
        save = gui.add_button(
            "Save session",
            hint="Saves dataset, pair, parameters, view, camera and decisions as a file for gpgrad "
            "view --state FILE.",
        )
        restore = gui.add_upload_button(
            "Restore session", mime_type=".toml", hint="Opens a file from 'Save session'."
        )
        self._message = gui.add_html("")

        on_press_by(save, on_save)
        on_upload(restore, on_restore)

    def show_command(self, command: str) -> None:
        """Show the command; empty where there is none, as for one submap alone."""
        self._command.content = command_html(command)

    def ask(self, name: str) -> None:
        """Ask whether a file may replace what is open; the page says "restore" with the answer."""
        choices = "".join(
            button(label, say("restore", sure=sure), "margin:.3em .5em 0 0")
            for label, sure in (("Replace it", True), ("Keep it", False))
        )
        question = (
            f"{name} replaces the dataset, the pair, the parameters, the view and all decisions of "
            "this session."
        )
        self._message.content = (
            f'<div data-testid="saving-message">{paragraph(question)}'
            f'<div style="padding:0 .75em">{choices}</div></div>'
        )

    def tell(self, message: str, *, bad: bool = False) -> None:
        """Say what came of restoring."""
        look = f"color:{BAD}" if bad else FAINT
        self._message.content = (
            f'<div data-testid="saving-message">{paragraph(message, look)}</div>'
        )


def command_html(command: str) -> str:
    """Write the box with the command, and the button that copies it."""
    if not command:
        return paragraph("There is no command for one submap alone: it is not a pair.", FAINT)
    intro = paragraph(
        "This command finds the same inliers, score and motion. Without --pair it compares all "
        "pairs."
    )
    return (
        f'{intro}<div style="padding:.2em .75em .4em">'
        f'<textarea data-testid="command" readonly rows="5" aria-label="Command" style="width:100%;'
        f"box-sizing:border-box;font:.75em monospace;color:inherit;background:transparent;"
        f'border:1px solid currentColor;border-radius:.3em;opacity:.9">{escape(command)}</textarea>'
        f'<button type="button" onclick="{escape(COPY)}" style="width:100%;padding:.35em;'
        f"background:#1971c2;color:#fff;border:0;border-radius:.2em;cursor:pointer;font:inherit;"
        f'font-size:.85em">Copy command</button></div>'
    )
