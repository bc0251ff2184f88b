"""The report in the Save tab: a format and a button."""

from collections.abc import Callable

import viser

from app.viewer.host import Host
from app.viewer.widgets.actions import on_press_by
from app.viewer.widgets.work_bar import WorkBar


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
