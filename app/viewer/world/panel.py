"""The world: which poses and colours, and the submap that is looked at."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from html import escape
from typing import Any

import viser

from app.viewer.host import Host
from app.viewer.widgets.actions import on_choice, on_option, on_press_by, on_step
from app.viewer.widgets.html import FAINT, paragraph, table
from app.viewer.widgets.work_bar import WorkBar
from app.viewer.world.submaps import WORLD_COLORS, PoseSource, WorldOptions

NOTHING: str = "none"
COLOR_HINT = "submap: each has its own colour. elevation: height in the world. deviation and "
"gradient: of the Gaussian-process maps, which are made on first use."


@dataclass(frozen=True)
class WorldCalls:
    """What the panel calls; all must be quick.

    Attributes:
        on_options: Given the whole new options after each change by a user.
        on_select: Given the id of the submap chosen, or None.
        on_step: Given 1 for the next submap, -1 for the previous.
        on_role: Given "query" or "database": the chosen submap is to be that, in Tune.
        on_look: Given the page whose camera is to go to the chosen submap.
        on_all: Given the page whose camera is to show all.
    """

    on_options: Callable[[WorldOptions], None]
    on_select: Callable[[str | None], None]
    on_step: Callable[[int], None]
    on_role: Callable[[str], None]
    on_look: Callable[[viser.ClientHandle], None]
    on_all: Callable[[viser.ClientHandle], None]


class WorldPanel:
    """Widgets of the world and of one submap in it."""

    def __init__(self, host: Host, options: WorldOptions, calls: WorldCalls) -> None:
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
            hint="Which poses the submaps have: from odometry, corrected by the pose graph, or "
            "true.",
        )
        self._color: viser.GuiDropdownHandle[Any] = gui.add_dropdown(
            "Colour by", WORLD_COLORS, initial_value=options.color, hint=COLOR_HINT
        )
        self._legend = gui.add_html("")
        self.work_bar = WorkBar(host, "Cancel maps", "world")
        names = gui.add_checkbox(
            "Names", options.names, hint="Writes the id of each submap above it."
        )
        trajectories = gui.add_checkbox(
            "Trajectories",
            options.trajectories,
            hint="Orange is odometry, blue is corrected, grey is true.",
        )
        every = gui.add_button("Show all submaps", hint="Moves the camera back to all submaps.")
        self._chosen: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Submap",
            (NOTHING,),
            initial_value=NOTHING,
            hint="You can also click a submap in the scene.",
        )
        self._steps = gui.add_button_group(
            "Step submap", ("previous", "next"), hint="Go to the previous or the next submap."
        )
        self._figures = gui.add_html("")
        self._look = gui.add_button(
            "Look at it", visible=False, hint="Moves the camera to this submap."
        )
        self._roles = gui.add_button_group(
            "Tune it as",
            ("query", "database"),
            visible=False,
            hint="Opens this submap in Tune, as the query or the database.",
        )
        for name, handle in (
            ("poses", self._poses),
            ("color", self._color),
            ("names", names),
            ("trajectories", trajectories),
        ):
            self._bind(name, handle)

        on_press_by(every, calls.on_all)
        on_press_by(self._look, calls.on_look)
        on_choice(self._chosen, lambda name: calls.on_select(None if name == NOTHING else name))
        on_step(self._steps, calls.on_step)
        on_option(self._roles, calls.on_role)

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

    def _bind(self, name: str, handle: viser.GuiInputHandle[Any]) -> None:
        def change(value: object) -> None:
            self._options = replace(self._options, **{name: value})
            self._calls.on_options(self._options)

        on_choice(handle, change)
