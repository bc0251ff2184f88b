"""Ground strewn with rocks, seen twice without noise: what any method should recognise."""

import numpy as np

from gpgrad_core.arrays import Array
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Submap


def rocks(seed: int, xy: Array) -> Array:
    """Heights [m] of gently rolling ground with half-buried rocks of 10 to 60 cm."""
    rng = np.random.default_rng(seed)
    z = 0.1 * np.sin(0.7 * xy[:, 0] + rng.uniform(0, 6)) * np.cos(0.6 * xy[:, 1])
    for _ in range(120):
        centre, radius = rng.uniform(-6, 6, 2), rng.uniform(0.1, 0.6)
        above = radius**2 - np.sum((xy - centre) ** 2, axis=1)
        z = np.maximum(z, np.sqrt(np.maximum(above, 0)) * rng.uniform(0.4, 0.9))
    return z


def look(T_world_submap: SE2, name: str, *, seed: int, ground: int = 1) -> Submap:
    """Sample a disc of 3 m around a pose, then thin it to one point a voxel of 5 cm.

    As in clouds of real sensors, steep sides thus hold more points than what lies flat.
    """
    rng = np.random.default_rng(seed)
    local = rng.uniform(-3, 3, (60_000, 2))
    local = local[np.hypot(*local.T) < 3]
    heights = rocks(ground, T_world_submap.apply(local))
    points = np.column_stack([local, heights])
    _, first = np.unique(np.floor(points / 0.05).astype(int), axis=0, return_index=True)
    kept = points[np.sort(first)]
    world = T_world_submap.apply(kept[:, :2])
    stains = [rocks(ground + 10 * k, world) for k in (1, 2, 3)]  # no relation to the shape
    colors = np.clip(0.3 + np.column_stack(stains), 0, 1)
    return Submap.from_points(kept, name, colors=colors)
