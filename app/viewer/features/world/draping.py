"""Ways over the ground: tracks and outlines that no hill hides, and that move with submaps."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from app.viewer.features.world.merged import MergedTerrain
from app.viewer.scene.nodes import LinePoints
from gpgrad_core.arrays import Array

MOST_PIECES = 1500
"""Straight pieces of one way."""
REACH = 3
"""A way is level over so many of its pieces at either side, so that no bump pierces it."""


@dataclass(frozen=True, eq=False)
class Drape:
    """How a way through some places runs over the ground.

    A place of it is a number: 2.5 is halfway between the third and the fourth vertex.
    """

    at: Float[Array, "m"]
    rise: Float[Array, "m"]  # above the straight way there [m]
    num_places: int

    def over(self, places: Float[Array, "n 3"]) -> Float[Array, "m 3"]:
        """The way through the same places, wherever they have moved since [m]."""
        return _along(places, self.at) + self.rise[:, None] * np.array([0.0, 0.0, 1.0])


def drape(places: Float[Array, "n 3"], terrain: MergedTerrain | None, margin: float) -> Drape:
    """Drape the way through places of the world over its ground, with a margin above it [m].

    Where there is no ground, it goes on as far above or below the places as beside it.
    """
    if terrain is None or len(places) < 2:
        return Drape(np.arange(float(len(places))), np.full(len(places), margin), len(places))
    steps = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1)
    step = max(2 * terrain.resolution, float(steps.sum()) / MOST_PIECES)
    counts = np.maximum(np.ceil(steps / step).astype(int), 1)
    at = np.concatenate([k + np.arange(count) / count for k, count in enumerate(counts)])
    at = np.append(at, len(places) - 1.0)
    straight = _along(places, at)
    rise = terrain.heights_near(straight[:, :2]) - straight[:, 2]
    seen = np.flatnonzero(np.isfinite(rise))
    rise = np.interp(np.arange(len(at)), seen, rise[seen]) if len(seen) else 0.0 * at
    # The highest near each place, and of those the mean: smooth, and nowhere below the ground.
    near = np.lib.stride_tricks.sliding_window_view
    for reduce in (np.max, np.mean):
        rise = reduce(near(np.pad(rise, REACH, mode="edge"), 2 * REACH + 1), axis=1)
    return Drape(at, rise + margin, len(places))


def _along(places: Float[Array, "n 3"], at: Float[Array, "m"]) -> Float[Array, "m 3"]:
    numbers = np.arange(len(places))
    return np.column_stack([np.interp(at, numbers, column) for column in places.T])


def lines_of(way: Float[Array, "m 3"], dash: float = 0.0) -> LinePoints:
    """Join a way's places, all of them or as dashes of a length [m]."""
    lines = np.stack([way[:-1], way[1:]], axis=1).astype(np.float32)
    if dash <= 0.0 or not len(lines):
        return lines
    lengths = np.linalg.norm(lines[:, 1, :2] - lines[:, 0, :2], axis=1)
    middles = np.cumsum(lengths) - lengths / 2
    return lines[(middles % (1.6 * dash)) < dash]
