"""The world: which poses and colours, and the submap that is looked at."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from html import escape
from typing import Any

import viser

from app.viewer.host import Host
from app.viewer.widgets.html import BAD, BUSY, FAINT, paragraph, table
from app.viewer.world.submaps import WORLD_COLORS, PoseSource, WorldOptions

NOTHING: str = "none"
COLOR_HINT = (
    "submap: each its own colour. elevation: height in the world. deviation, gradient: of the "
    "Gaussian-process maps, which are made when first asked for."
)


@dataclass(frozen=True)
class ExploreCalls:
    """What the panel calls; all must be quick.

    Attributes:
        on_options: Given the whole new options after each change by a user.
        on_select: Given the id of the submap chosen, or None.
        on_step: Given 1 for the next submap, -1 for the previous.
        on_role: Given "query" or "database": the chosen submap is to be that, in Tune.
        on_look: Called when the camera is to go to the chosen submap.
        on_all: Called when the camera is to show all.
        on_cancel: Called when maps that are being made are no longer wanted.
    """

    on_options: Callable[[WorldOptions], None]
    on_select: Callable[[str | None], None]
    on_step: Callable[[int], None]
    on_role: Callable[[str], None]
    on_look: Callable[[viser.ClientHandle | None], None]
    on_all: Callable[[viser.ClientHandle | None], None]
    on_cancel: Callable[[], None]


class ExplorePanel:
    """Widgets of the world and of one submap in it."""

    def __init__(self, host: Host, options: WorldOptions, calls: ExploreCalls) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            options: What they start at.
            calls: What they call.
        """
        gui = host.gui
        self._options = options
        self._calls = calls
        self._summary = gui.add_html("")
        self._poses: viser.GuiDropdownHandle[Any] = gui.add_dropdown(
            "Poses",
            (options.poses,),
            initial_value=options.poses,
            hint="Where the submaps stand: as odometry has them, as the pose graph corrects them, "
            "or where they truly are.",
        )
        self._color: viser.GuiDropdownHandle[Any] = gui.add_dropdown(
            "Colour by", WORLD_COLORS, initial_value=options.color, hint=COLOR_HINT
        )
        self._legend = gui.add_html("")
        self._message = gui.add_html("")
        self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
        self._cancel = gui.add_button("Cancel maps", visible=False, color="red")
        names = gui.add_checkbox("Names", options.names, hint="Write each submap's id above it.")
        ways = gui.add_checkbox(
            "Trajectories",
            options.trajectories,
            hint="Orange: odometry. Blue: corrected. Grey: true.",
        )
        every = gui.add_button("Show all submaps", hint="Brings the camera back.")
        self._chosen: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Submap",
            (NOTHING,),
            initial_value=NOTHING,
            hint="Or click one in the scene.",
        )
        self._steps = gui.add_button_group(
            "Step submap", ("previous", "next"), hint="Step along the way."
        )
        self._figures = gui.add_html("")
        self._look = gui.add_button(
            "Look at it", visible=False, hint="Brings the camera to this submap."
        )
        self._roles = gui.add_button_group(
            "Tune it as",
            ("query", "database"),
            visible=False,
            hint="Opens Tune with this submap and the other one that is set there.",
        )
        for name, handle in (
            ("poses", self._poses),
            ("color", self._color),
            ("names", names),
            ("trajectories", ways),
        ):
            self._bind(name, handle)

        @every.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            calls.on_all(event.client)

        @self._look.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            calls.on_look(event.client)

        @self._cancel.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            calls.on_cancel()

        @self._chosen.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is not None:
                chosen = event.target.value
                calls.on_select(None if chosen == NOTHING else chosen)

        @self._steps.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            calls.on_step(1 if event.target.value == "next" else -1)

        @self._roles.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            calls.on_role(event.target.value)

    @property
    def options(self) -> WorldOptions:
        """The options as the widgets show them."""
        return self._options

    def offer(
        self, options: WorldOptions, sources: tuple[PoseSource, ...], ids: tuple[str, ...]
    ) -> None:
        """Show options, and what there is to choose from; nothing is called."""
        self._options = options
        self._poses.options = sources
        self._poses.value = options.poses
        self._color.value = options.color
        if tuple(self._chosen.options) != (NOTHING, *ids):
            self._chosen.options = (NOTHING, *ids)
            self._chosen.value = NOTHING

    def select(self, name: str | None, rows: tuple[tuple[str, str], ...]) -> None:
        """Show which submap is chosen, and its figures."""
        self._chosen.value = NOTHING if name is None else name
        self._look.visible = self._roles.visible = name is not None
        if name is None:
            self._figures.content = paragraph("Click a submap in the scene.", FAINT)
            return
        self._figures.content = (
            f'<div data-testid="submap-figures" style="padding:.1em .75em .3em">'
            f"<b>Submap {escape(name)}</b>{table(rows)}</div>"
        )

    def show_summary(self, lines: tuple[str, ...]) -> None:
        """Say what is shown, a line each; the first stands out."""
        head, *rest = (*lines, "")
        self._summary.content = (
            f'<div data-testid="world-summary">{paragraph(head, "font-weight:600")}'
            f"{''.join(paragraph(line, FAINT) for line in rest if line)}</div>"
        )

    def show_legend(self, legend: str) -> None:
        """Show what the colours mean, as HTML that is safe."""
        self._legend.content = legend

    def running(self, fraction: float) -> None:
        """Show how far the maps are."""
        self._cancel.visible = self._bar.visible = True
        self._bar.value = 100 * min(max(fraction, 0.0), 1.0)
        self._message.content = _line(f"Making the maps … {100 * fraction:.0f} %", BUSY)

    def stopped(self, message: str = "", *, bad: bool = False) -> None:
        """Show that nothing runs, and why if there is something to say."""
        self._cancel.visible = self._bar.visible = False
        self._message.content = _line(message, BAD if bad else BUSY) if message else ""

    def _bind(self, name: str, handle: viser.GuiInputHandle[Any]) -> None:
        @handle.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is None:
                return
            self._options = replace(self._options, **{name: event.target.value})
            self._calls.on_options(self._options)


def _line(text: str, color: str) -> str:
    return (
        f'<div data-testid="world-message" role="status" style="padding:.1em .75em;'
        f'font-size:.8em;color:{color}">{escape(text)}</div>'
    )
