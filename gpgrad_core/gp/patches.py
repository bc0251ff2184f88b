"""Which points of a cloud are explained together, when its likelihood is taken patch by patch."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, NDArray

Members = Int[NDArray[np.intp], "_"]

PATCH_POINTS = 500
"""Points of a patch: its dense GP takes 10 ms. Smaller ones, though more, were worse on held-out
points of real terrain, which is no stationary GP."""
MOST_OFTEN = 2.0
"""How often, in the mean, a point of a small cloud may be in a patch."""


def draw_patches(
    xy: Float[Array, "n 2"], count: int, radius: float, rng: np.random.Generator
) -> list[Members]:
    """Draw patches spread over a cloud, each a disc seen from above.

    A patch is the nearest neighbours of a point. Where these span less than the radius, it is as
    many points within that radius, at random.

    Args:
        xy: Positions of the points [m].
        count: Patches wanted; fewer where the cloud is small.
        radius: Least one of a patch [m], as far as the cloud goes.
        rng: Chooses.

    Returns:
        The rows of each patch's points.
    """
    if len(xy) <= PATCH_POINTS:
        return [np.arange(len(xy))]
    count = min(count, int(np.ceil(MOST_OFTEN * len(xy) / PATCH_POINTS)))
    # Here, because it takes a while to load, and only a fit needs it.
    from scipy.spatial import KDTree  # noqa: PLC0415

    tree = KDTree(xy)
    patches: list[Members] = []
    for centre in xy[_centres(tree, count, rng)]:
        members = np.asarray(tree.query(centre, PATCH_POINTS)[1])
        if np.hypot(*(xy[members[-1]] - centre)) < radius:
            within = np.sort(tree.query_ball_point(centre, radius))
            members = rng.choice(within, PATCH_POINTS, replace=False)
        patches.append(members)
    return patches


def _centres(tree: Any, count: int, rng: np.random.Generator) -> Members:
    """Choose points evenly along the leaves of the tree, where neighbours are together.

    So every part of the cloud has its share, by its number of points.
    """
    steps = (np.arange(count) + rng.uniform(size=count)) / count
    return tree.indices[(steps * tree.n).astype(np.intp)]
