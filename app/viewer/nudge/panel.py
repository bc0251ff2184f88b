"""Set a pair's motion by hand, and let the ground refine it."""

from collections.abc import Callable
from dataclasses import dataclass

from app.viewer.host import Host
from app.viewer.widgets.actions import on_choice, on_press
from app.viewer.widgets.html import BAD, BUSY, FAINT, message_line, paragraph, table

INTRODUCTION = (
    "Did the search miss a closure, or find a wrong motion? Drag the query to where it belongs, "
    "refine its pose, and hand it to the pose graph."
)


@dataclass(frozen=True)
class NudgeCalls:
    """What the panel calls; all must be quick.

    Attributes:
        on_active: Given whether the query is to be moved by hand.
        on_refine: Called when the ground is to refine where it was put.
        on_back: Called when it is to go back to where it was found.
        on_use: Called when the pose graph is to take the motion.
    """

    on_active: Callable[[bool], None]
    on_refine: Callable[[], None]
    on_back: Callable[[], None]
    on_use: Callable[[], None]


class NudgePanel:
    """Widgets for a motion set by hand."""

    def __init__(self, host: Host, calls: NudgeCalls) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            calls: What they call.
        """
        gui = host.gui
        gui.add_html(paragraph(INTRODUCTION, FAINT))
        self._active = gui.add_checkbox(
            "Move the query",
            initial_value=False,
            hint="Lays the query onto the database and shows handles: arrows shift it, the arc "
            "turns it.",
        )
        self._refine = gui.add_button(
            "Refine",
            disabled=True,
            hint="Aligns the two surfaces, starting from the pose that you set. It should be "
            "right to within a few length-scales.",
        )
        self._back = gui.add_button(
            "Reset position", disabled=True, hint="Goes back to the motion that the search found."
        )
        self._use = gui.add_button(
            "Use in the pose graph",
            disabled=True,
            hint="Accepts the pair by hand, with the refined motion. See the tab Pose graph in "
            "Explore.",
        )
        self._figures = gui.add_html("")
        self._message = gui.add_html("")

        on_choice(self._active, calls.on_active)
        on_press(self._refine, calls.on_refine)
        on_press(self._back, calls.on_back)
        on_press(self._use, calls.on_use)

    def set_active(self, active: bool) -> None:
        """Show whether the query can be moved; nothing is called."""
        self._active.value = active
        self._refine.disabled = self._back.disabled = not active
        if not active:
            self.offer_use(False)

    def offer_use(self, offered: bool) -> None:
        """Show whether there is a refined motion to use."""
        self._use.disabled = not offered

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
