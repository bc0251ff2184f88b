"""The command that gives the same result, the session as a file, exports and reports."""

from collections.abc import Callable
from html import escape

import viser

from app.viewer.server.host import Host
from app.viewer.web import fill_page_file
from app.viewer.widgets.actions import on_press_by, on_upload
from app.viewer.widgets.bridge import say
from app.viewer.widgets.html import BAD, FAINT, button, paragraph
from app.viewer.widgets.work_bar import WorkBar


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
    """Write the box with the command, and the button that copies it.

    A page may write to the clipboard only while it is being clicked, and only if it comes from this
    machine or over HTTPS; elsewhere a selected box is copied from.
    """
    if not command:
        return paragraph("There is no command for one submap alone: it is not a pair.", FAINT)
    intro = paragraph(
        "This command finds the same inliers, score and motion. Without --pair it compares all "
        "pairs."
    )
    return intro + fill_page_file("command.html", COMMAND=escape(command))


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


class ReportPanel:
    """Asks for a report; the callback must only hand on."""

    def __init__(
        self,
        host: Host,
        formats: tuple[str, ...],
        on_report: Callable[[str, viser.ClientHandle], None],
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            formats: Formats of a report.
            on_report: Given the format, and the page that wants it.
        """
        with host.gui.add_folder("Report"):
            self._format = host.gui.add_dropdown("Report as", formats, initial_value=formats[0])
            report = host.gui.add_button(
                "Save report",
                hint="Saves verdict, both maps, difference, agreement, parameters, command and "
                "link of this pair as one file, which opens without a viewer.",
            )
            self.work_bar = WorkBar(host, "Cancel report", "report", done_color="inherit")
        on_press_by(report, lambda page: on_report(self._format.value, page))

    @property
    def format(self) -> str:
        """The chosen format."""
        return self._format.value
