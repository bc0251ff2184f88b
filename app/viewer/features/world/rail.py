"""What stands beside the map: figures of the world, the way from before to after, and a place."""

from collections.abc import Callable
from html import escape
from math import hypot

import numpy as np
from jaxtyping import Float

from app.viewer.features.world.merged import MergedTerrain
from app.viewer.features.world.model import Correction, World
from app.viewer.features.world.scene import SCORE_MAP, TRAJECTORY_COLORS
from app.viewer.scene.colors import css
from app.viewer.scene.layers import Scale
from app.viewer.server.host import Host
from app.viewer.widgets.actions import on_choice
from app.viewer.widgets.html import FAINT, figures, paragraph
from app.viewer.widgets.legend import canvas_legend
from gpgrad_core.arrays import Array
from gpgrad_core.errors import count

BAR = 180
"""Width of the colour bars on the map's canvas [pixels]."""
MOST_SEEN = 8
"""Submaps that are listed with what each says of a place; the others are counted."""


class WorldRail:
    """The rail of Explore; it is visible while the map is."""

    def __init__(self, host: Host, on_share: Callable[[float], None]) -> None:
        """Make it in the current container, unseen; it reports how far from before to after."""
        gui = host.gui
        self._figures = gui.add_html("", visible=False)
        hint = "Moves the map from odometry, on the left, to the corrected poses."
        self._slider = gui.add_slider(
            "Before → after", 0.0, 1.0, 0.01, 1.0, visible=False, hint=hint
        )
        self._place = gui.add_html("", visible=False)
        self._moves = False
        on_choice(self._slider, on_share)

    def set_visible(self, visible: bool) -> None:
        self._figures.visible = self._place.visible = visible
        self._slider.visible = visible and self._moves

    def show(self, world: World, terrain: MergedTerrain | None) -> None:
        self._moves = world.correction.graph is not None
        self._slider.visible = self._figures.visible and self._moves
        if self._slider.value != world.share:
            self._slider.value = world.share
        self._figures.content = figures("world-figures", figures_of_world(world, terrain))

    def show_place(
        self, terrain: MergedTerrain | None, place: Float[Array, "2"] | None
    ) -> int | None:
        """Show the terrain at a place of the world [m]; returns its cell, if there is one."""
        cell = None if terrain is None or place is None else terrain.cell_at(place)
        if terrain is None or cell is None:
            words = "Click a place: who saw it, and what is known of it."
            if place is not None:
                words = "At these poses, no submap saw the chosen place."
            self._place.content = paragraph(words, FAINT)
            return None
        self._place.content = figures("place", rows_of_place(terrain, cell), "<b>Place</b>")
        return cell


def figures_of_world(world: World, terrain: MergedTerrain | None) -> tuple[tuple[str, str], ...]:
    """Write the figures of all submaps as rows of a name and a value with its unit."""
    total, shown = len(world.dataset.submaps), len(world.poses)
    submaps = f"{total:,}" if shown == total else f"{shown:,} of {total:,} have a pose"
    if world.past is not None:
        submaps = f"{shown:,} so far" if world.grows else f"{shown:,} of {total:,} so far"
    rows = [("submaps", submaps), ("poses", world.options.poses)]
    smoothed = sum(not surface.inferred for surface in world.placed.values())
    if smoothed:
        rows.append(("smoothed grids", f"{count(smoothed, 'submap')}, not inferred"))
    if terrain is not None:
        rows.append(("ground", f"{terrain.area:,.0f} m²"))
        if np.isfinite(terrain.disagreement):
            rows.append(("heights differ by", f"{1000 * terrain.disagreement:.0f} mm (median)"))
    places = np.array([pose.translation for pose in world.poses.values()]).reshape(-1, 3)
    if world.options.poses != "in rows":
        length = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
        rows.append(("track", f"{length:,.1f} m"))
    rows += [(f"{source} is off by", off) for source, off in world.track_errors.items()]
    if world.correction.loops:
        loops, neighbours = world.num_accepted
        rows += [("loop closures", f"{loops:,}"), ("odometry neighbours", f"{neighbours:,}")]
        wrong = sum(loop.pair in world.correction.wrong for loop in world.correction.loops)
        if wrong:
            rows.append(("left out", f"{wrong:,} that the others contradict"))
    return tuple(rows)


def rows_of_place(terrain: MergedTerrain, cell: int) -> tuple[tuple[str, str], ...]:
    """Write the values of a cell of the terrain as rows of a name and a value."""
    x, y, z = (float(value) for value in terrain.positions[cell])
    first, stop = (int(end) for end in terrain.first[cell : cell + 2])
    rows = [
        ("x, y", f"{x:z.2f}, {y:z.2f} m"),
        ("elevation", f"{z:z.3f} ± {terrain.std[cell]:.3f} m"),
        ("slope", f"{hypot(*terrain.slope[cell]):.2f} m/m"),
        ("seen by", count(stop - first, "submap")),
    ]
    for k in range(first, min(stop, first + MOST_SEEN)):
        value = f"{terrain.heights[k]:z.3f} ± {terrain.deviations[k]:.3f} m"
        rows.append((terrain.names[terrain.seen_by[k]], value))
    if stop - first > MOST_SEEN:
        rows.append(("", f"and {stop - first - MOST_SEEN} more"))
    return tuple(rows)


def map_legend(world: World, scale: Scale | None) -> str:
    """Write what stands on the map's canvas: ground, tracks with their error, and closures."""
    errors = world.track_errors
    tracks = "".join(
        f'<div style="white-space:nowrap"><span style="display:inline-block;width:22px;height:4px;'
        f"border-radius:2px;margin-right:.5em;vertical-align:middle;outline:1.5px solid #12141899;"
        f'background:{css(TRAJECTORY_COLORS[source])}"></span>{escape(source)}'
        f"{f' {errors[source]} off' if source in errors else ''}</div>"
        for source in (world.trajectories if world.options.trajectories else ())
    )
    drawn = world.options.loops and any(loop.accepted for loop in world.correction.loops)
    closures = canvas_legend(score_scale(world.correction), "", f"{BAR}px") if drawn else ""
    bars = canvas_legend(scale, "", f"{BAR}px")
    bars = "".join(f"<div>{bar}</div>" for bar in (bars, closures) if bar)
    look = "display:flex;gap:.2em 1.4em;flex-wrap:wrap;justify-content:center"
    return "".join(f'<div style="{look}">{row}</div>' for row in (tracks, bars) if row)


def score_scale(correction: Correction) -> Scale:
    """What the colours of the closures' arcs mean."""
    return Scale("Closures", "score", SCORE_MAP, 0.0, correction.highest_score)
