"""Show it to others: views, motion, full screen, and a page to take away."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import viser

from app.viewer.features.desk import Subject
from app.viewer.server.host import Host
from app.viewer.widgets.actions import (
    on_choice_by,
    on_option,
    on_option_by,
    on_press,
    on_press_by,
    one_of,
)
from app.viewer.widgets.html import GOOD
from app.viewer.widgets.work_bar import WorkBar

Playable: TypeAlias = Literal["closure", "pose graph"]

PLAYABLE: tuple[Playable, ...] = get_args(Playable)
SUBJECTS: tuple[Subject, ...] = get_args(Subject)
NO_VIEW: str = "none saved"


@dataclass(frozen=True)
class DemoCalls:
    """What the panel calls; all must be quick. The page that asks is passed where it matters.

    Attributes:
        on_subject: Given what is to be seen: the pair or the world.
        on_bookmark: Given the page and the name of a view, built-in or saved.
        on_save_view: Given the page whose view is to be kept.
        on_play: Given the page and what is to be played.
        on_full_screen: Called when the panels are to go away.
        on_page: Given the page that is to get a file with what is shown.
    """

    on_subject: Callable[[Subject], None]
    on_bookmark: Callable[[viser.ClientHandle, str], None]
    on_save_view: Callable[[viser.ClientHandle], None]
    on_play: Callable[[viser.ClientHandle | None, Playable], None]
    on_full_screen: Callable[[], None]
    on_page: Callable[[viser.ClientHandle], None]


class DemoPanel:
    """Widgets of the demonstration."""

    def __init__(self, host: Host, bookmarks: tuple[str, ...], calls: DemoCalls) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            bookmarks: Names of the views that there always are.
            calls: What they call.
        """
        gui = host.gui
        subject = gui.add_button_group(
            "Show", SUBJECTS, hint="Show the two submaps chosen in Tune, or all submaps."
        )
        views = gui.add_button_group(
            "View",
            bookmarks,
            hint="From above, from the side, or along the trajectory. It moves the camera of this "
            "page only.",
        )
        keep = gui.add_button("Save this view", hint="Adds the present view to the list below.")
        self._kept: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Saved views", (NO_VIEW,), initial_value=NO_VIEW, hint="Go back to a saved view."
        )
        acts = gui.add_button_group(
            "Play",
            PLAYABLE,
            hint="closure: the query glides onto the database along the estimated motion. pose "
            "graph: the submaps move from odometry to the corrected poses; optimise them in "
            "Explore first.",
        )
        full = gui.add_button("Full screen", hint="Hides the panels. Press Esc to bring them back.")
        page = gui.add_button(
            "Save page",
            hint="Saves what is shown, with its motion, as one HTML file. It opens from disk, "
            "without a server or a network.",
        )
        self.work_bar = WorkBar(host, "Cancel page", "demo", starts=(page,), done_color=GOOD)
        on_option(subject, lambda label: calls.on_subject(one_of(SUBJECTS, label)))
        on_option_by(views, calls.on_bookmark)
        on_press_by(keep, calls.on_save_view)
        on_choice_by(
            self._kept,
            lambda page, name: None if name == NO_VIEW else calls.on_bookmark(page, name),
        )
        on_press(full, calls.on_full_screen)
        on_press_by(page, calls.on_page)

        @acts.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            calls.on_play(event.client, one_of(PLAYABLE, event.target.value))

    def offer(self, names: tuple[str, ...]) -> None:
        """Offer the saved views, the last one chosen."""
        self._kept.options = names or (NO_VIEW,)
        self._kept.value = names[-1] if names else NO_VIEW
