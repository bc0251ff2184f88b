"""Draws the patches of a cloud over which its likelihood is summed."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, NDArray

Members = Int[NDArray[np.intp], "_"]

PATCH_POINTS = 500
"""Number of points of a patch; its dense GP takes 10 ms. More but smaller patches gave a worse fit
to held-out points of real terrain, which is not a stationary GP."""
MOST_OFTEN = 2.0
"""Largest mean number of patches that a point of a small cloud is in."""


def draw_patches(
    xy: Float[Array, "n 2"],
    count: int,
    radius: float,
    rng: np.random.Generator,
    size: int = PATCH_POINTS,
) -> list[Members]:
    """Draw patches spread over a cloud; each is a disc seen from above.

    A patch is the nearest neighbours of a point. If these span less than the radius, it is as
    many random points within the radius.

    Args:
        xy: Positions of the points (n, 2) [m].
        count: Number of patches wanted; a small cloud has fewer.
        radius: Smallest radius of a patch [m], as far as the cloud reaches.
        rng: Generator of the random choices.
        size: Number of points of a patch.

    Returns:
        The indices of each patch's points.
    """
    if len(xy) <= size:
        return [np.arange(len(xy))]
    count = min(count, int(np.ceil(MOST_OFTEN * len(xy) / size)))
    # Imported here because it loads slowly and only a fit needs it.
    from scipy.spatial import KDTree  # noqa: PLC0415

    tree = KDTree(xy)
    patches: list[Members] = []
    for centre in xy[_centres(tree, count, rng)]:
        members = np.asarray(tree.query(centre, size)[1])
        if np.hypot(*(xy[members[-1]] - centre)) < radius:
            within = np.sort(tree.query_ball_point(centre, radius))
            members = rng.choice(within, size, replace=False)
        patches.append(members)
    return patches


def _centres(tree: Any, count: int, rng: np.random.Generator) -> Members:
    """Choose points evenly along the leaves of the tree, in which neighbours are together.

    So every part of the cloud gets its share, by its number of points.
    """
    steps = (np.arange(count) + rng.uniform(size=count)) / count
    return tree.indices[(steps * tree.n).astype(np.intp)]
