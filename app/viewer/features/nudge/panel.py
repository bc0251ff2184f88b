"""Set a pair's motion by hand, and let the ground refine it."""

from app.viewer.server.host import Host
from app.viewer.widgets.html import BAD, BUSY, FAINT, message_line, paragraph, table

INTRODUCTION = (
    "Did the search miss a closure, or find a wrong motion? Drag the query to where it belongs, "
    "refine its pose, and hand it to the pose graph."
)


class NudgePanel:
    """Widgets for a motion set by hand; the tab binds what they do."""

    def __init__(self, host: Host) -> None:
        """Make the widgets in the current container."""
        gui = host.gui
        gui.add_html(paragraph(INTRODUCTION, FAINT))
        self.active = gui.add_checkbox(
            "Move the query",
            initial_value=False,
            hint="Lays the query onto the database and shows handles: arrows shift it, the arc "
            "turns it.",
        )
        self.refine = gui.add_button(
            "Refine",
            disabled=True,
            hint="Aligns the two surfaces, starting from the pose that you set. It should be "
            "right to within a few length-scales.",
        )
        self.back = gui.add_button(
            "Reset position", disabled=True, hint="Goes back to the motion that the search found."
        )
        self.use = gui.add_button(
            "Use in the pose graph",
            disabled=True,
            hint="Accepts the pair by hand, with the refined motion. See the tab Pose graph in "
            "Explore.",
        )
        self._figures = gui.add_html("")
        self._message = gui.add_html("")

    def set_active(self, active: bool) -> None:
        """Show whether the query can be moved; nothing is called."""
        self.active.value = active
        self.refine.disabled = self.back.disabled = not active
        if not active:
            self.use.disabled = True

    def show(self, rows: tuple[tuple[str, str], ...]) -> None:
        """Show figures of the motion."""
        self._figures.content = (
            f'<div data-testid="nudge-figures" style="padding:.1em .75em">{table(rows)}</div>'
            if rows
            else ""
        )

    def say(self, message: str, *, bad: bool = False) -> None:
        """Say what happens or went wrong; nothing if empty."""
        self._message.content = message_line("nudge-message", message, BAD if bad else BUSY)
