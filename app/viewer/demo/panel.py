"""Show it to others: views, motion, full screen, and a page to take away."""

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from typing import Any, Literal, TypeAlias, get_args

import viser

from app.viewer.host import Host
from app.viewer.widgets.html import BAD, BUSY, GOOD

Act: TypeAlias = Literal["closure", "pose graph"]
Subject: TypeAlias = Literal["pair", "world"]

ACTS: tuple[Act, ...] = get_args(Act)
SUBJECTS: tuple[Subject, ...] = get_args(Subject)
NO_VIEW: str = "none saved"


@dataclass(frozen=True)
class DemoCalls:
    """What the panel calls; all must be quick. The page that asks comes along where it matters.

    Attributes:
        on_subject: Given what is to be seen: the pair or the world.
        on_bookmark: Given the page and the name of a view, built-in or saved.
        on_save_view: Given the page whose view is to be kept.
        on_play: Given the page and what is to be played.
        on_full_screen: Called when the panels are to go away.
        on_page: Given the page that is to get a file with what is shown.
        on_cancel: Called when the file is no longer wanted.
    """

    on_subject: Callable[[Subject], None]
    on_bookmark: Callable[[viser.ClientHandle | None, str], None]
    on_save_view: Callable[[viser.ClientHandle | None], None]
    on_play: Callable[[viser.ClientHandle | None, Act], None]
    on_full_screen: Callable[[], None]
    on_page: Callable[[viser.ClientHandle | None], None]
    on_cancel: Callable[[], None]


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
            "Show", SUBJECTS, hint="The two submaps set in Tune, or the world of all submaps."
        )
        views = gui.add_button_group(
            "View",
            bookmarks,
            hint="From above, from the side, or along the way; moves this page's camera only.",
        )
        keep = gui.add_button("Keep this view", hint="Adds the camera as it is to the list below.")
        self._kept: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Kept views", (NO_VIEW,), initial_value=NO_VIEW, hint="Go back to a view kept before."
        )
        acts = gui.add_button_group(
            "Play",
            ACTS,
            hint="closure: the query glides onto the database along the estimated motion. "
            "pose graph: the submaps move from odometry to the corrected poses; optimise first, "
            "in Explore.",
        )
        full = gui.add_button(
            "Full screen", hint="Puts the panels away; the key Esc brings them back."
        )
        self._page = gui.add_button(
            "Save page",
            hint="One HTML file of what is shown, with its motion: it opens from disk, without "
            "server or network.",
        )
        self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
        self._cancel = gui.add_button("Cancel page", visible=False, color="red")
        self._message = gui.add_html("")

        @subject.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            calls.on_subject(next(one for one in SUBJECTS if one == event.target.value))

        @views.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            calls.on_bookmark(event.client, event.target.value)

        @keep.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            calls.on_save_view(event.client)

        @self._kept.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is not None and event.target.value != NO_VIEW:
                calls.on_bookmark(event.client, event.target.value)

        @acts.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            calls.on_play(event.client, next(act for act in ACTS if act == event.target.value))

        @full.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            calls.on_full_screen()

        @self._page.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            calls.on_page(event.client)

        @self._cancel.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            calls.on_cancel()

    def offer(self, names: tuple[str, ...]) -> None:
        """Offer the views that were kept, the last one chosen."""
        self._kept.options = names or (NO_VIEW,)
        self._kept.value = names[-1] if names else NO_VIEW

    def running(self, fraction: float) -> None:
        """Show how far the page is."""
        self._set_running(True)
        self._bar.value = 100 * min(max(fraction, 0.0), 1.0)
        self._message.content = _line("Writing the page …", BUSY)

    def stopped(self, message: str = "", *, bad: bool = False) -> None:
        """Show that nothing runs, and what came of it."""
        self._set_running(False)
        self._message.content = _line(message, BAD if bad else GOOD) if message else ""

    def _set_running(self, running: bool) -> None:
        self._page.visible = not running
        self._bar.visible = self._cancel.visible = running


def _line(text: str, color: str) -> str:
    return (
        f'<div data-testid="demo-message" role="status" style="padding:.1em .75em;font-size:.8em;'
        f'color:{color}">{escape(text)}</div>'
    )
