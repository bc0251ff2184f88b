"""Lines of the world: the trajectory of the robot, and the loops that join places on it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from app.viewer.draw.associations import arcs
from app.viewer.draw.colors import Rgb, colorize
from app.viewer.state import ColorMap
from app.viewer.world.submaps import PoseSource, WorldOptions
from gpgrad_core.arrays import NDArray
from gpgrad_core.se2 import Pose

LinePoints = Float[NDArray[np.float32], "n 2 3"]

TRAJECTORY_COLORS: dict[PoseSource, Rgb] = {
    "true": (90, 90, 90),
    "odometry": (222, 120, 20),
    "corrected": (31, 119, 200),
}
REFUSED_LOOP: Rgb = (165, 165, 165)
WRONG_LOOP: Rgb = (0, 0, 0)
SCORE_MAP: ColorMap = "viridis"
MOST_ARCHES = 60
"""Accepted loops that are drawn, and refused pairs; those of the chosen submap come on top."""
LOOP_PIECES = 12
"""Straight pieces of the arch of one loop."""
LOOP_RISE = 0.45
"""Height of the arch over its feet, as a share of its span."""


@dataclass(frozen=True)
class Loop:
    """One pair of submaps as an edge of the picture.

    Attributes:
        query: Id of the later submap.
        database: Id of the earlier one.
        score: What its colour tells.
        accepted: Whether it is taken for a loop closure.
        wrong: Whether the pose graph found that the others contradict it.
    """

    query: str
    database: str
    score: float
    accepted: bool
    wrong: bool = False

    @property
    def pair(self) -> tuple[str, str]:
        """Query and database."""
        return self.query, self.database


def trajectory_lines(poses: Mapping[str, Pose], lift: float) -> LinePoints:
    """Join the submaps' origins in order.

    Args:
        poses: ``T_world_submap`` in the order of the traverse.
        lift: How far above the ground [m].
    """
    points = np.array([pose.translation for pose in poses.values()], dtype=np.float64)
    points = points.reshape(-1, 3) + np.array([0.0, 0.0, lift])
    return np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)


def arches(loops: Iterable[Loop], poses: Mapping[str, Pose], lift: float) -> LinePoints:
    """Span each loop as an arch over the ground between its submaps.

    Args:
        loops: Those with a submap that has no pose are left out: see `drawable`.
        poses: ``T_world_submap`` by id.
        lift: How far above the ground the feet stand [m].
    """
    chosen = drawable(loops, poses)
    if not chosen:
        return np.zeros((0, 2, 3), np.float32)
    raised = {name: pose.translation + np.array([0.0, 0.0, lift]) for name, pose in poses.items()}
    start = np.array([raised[loop.database] for loop in chosen])
    end = np.array([raised[loop.query] for loop in chosen])
    return arcs(start, end, LOOP_PIECES, LOOP_RISE)


def arch_colors(loops: Iterable[Loop], highest: float) -> UInt8[NDArray[np.uint8], "n 3"]:
    """Colour the pieces of `arches` by the score, from 0 to the highest; wrong ones are black.

    Args:
        loops: The drawable ones.
        highest: Score of the last colour.
    """
    drawn = list(loops)
    scores = np.array([loop.score for loop in drawn], dtype=np.float64)
    colors = colorize(scores, 0.0, highest, SCORE_MAP)
    colors[[loop.wrong for loop in drawn]] = WRONG_LOOP
    return np.repeat(colors, LOOP_PIECES, axis=0)


def choose_arches(
    loops: Iterable[Loop], options: WorldOptions, selected: str | None
) -> tuple[Loop, ...]:
    """Choose the loops to draw: those with the highest scores, and all of the chosen submap.

    Hundreds of arches would hide the ground and each other.

    Args:
        loops: All that could be drawn.
        options: Which kinds are to be seen.
        selected: Id of the submap that is chosen.
    """
    chosen: list[Loop] = []
    for accepted, wanted in ((True, options.loops), (False, options.refused)):
        if wanted:
            ranked = sorted(
                (loop for loop in loops if loop.accepted is accepted), key=lambda loop: -loop.score
            )
            chosen += ranked[:MOST_ARCHES]
            chosen += [loop for loop in ranked[MOST_ARCHES:] if selected in loop.pair]
    return tuple(chosen)


def drawable(loops: Iterable[Loop], poses: Mapping[str, Pose]) -> tuple[Loop, ...]:
    """Keep the loops both of whose submaps have a pose."""
    return tuple(loop for loop in loops if loop.query in poses and loop.database in poses)
