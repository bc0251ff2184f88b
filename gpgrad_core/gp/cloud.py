"""The points of a cloud: binned where they are dense, and in the order that the solvers need."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import Array, Indices, Mask
from gpgrad_core.gp.kernel import group

AXES_POINTS = 4096
"""Largest number of a cloud's points from which its own axes are computed."""
POINTS_TOGETHER = 256
"""Number of points of a square patch that are sorted next to each other."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points sorted so that neighbours are together."""

    xy: Float[Array, "n 2"]  # positions (n, 2) [m]
    heights: Float[Array, "n"]  # heights relative to the mean (n,) [m]
    noise_variance: Float[Array, "n"]  # variance of each height (n,) [m²]

    @classmethod
    def of(
        cls, points: Float[Array, "n 3"], noise_std: float | Float[Array, "n"], mean: float
    ) -> "Cloud":
        """Sort points patch by patch, and subtract the mean from their heights."""
        order = _patch_by_patch(points[:, :2])
        noise = np.broadcast_to(noise_std, len(points))[order]
        return cls(points[order, :2], points[order, 2] - mean, noise**2)

    def __len__(self) -> int:
        return len(self.xy)

    def select(self, chosen: Bool[Mask, "n"] | Int[Indices, "k"] | slice) -> "Cloud":
        return Cloud(self.xy[chosen], self.heights[chosen], self.noise_variance[chosen])

    def signal_to_noise(self, signal_std: float) -> float:
        """Compute the terrain's standard deviation [m] in those of the middle point."""
        return signal_std / float(np.sqrt(np.median(self.noise_variance)))

    def residual_rms(self, residual: Float[Array, "n"]) -> float:
        return float(np.sqrt(np.mean(residual**2 / self.noise_variance)))


def _patch_by_patch(xy: Float[Array, "n 2"]) -> Int[Indices, "n"]:
    """Sort points by square patches, row by row, with every other row backwards."""
    low = xy.min(axis=0)
    width, height = np.maximum(xy.max(axis=0) - low, 1e-9)
    num_patches = max(1.0, len(xy) / POINTS_TOGETHER)
    # On a narrow cloud the patches are as wide as the cloud, and shorter.
    side = max(np.sqrt(width * height / num_patches), max(width, height) / num_patches)
    column, row = ((xy - low) / side).astype(np.int64).T
    last = column.max()
    along = np.where(row % 2 == 0, column, last - column)
    # Within a patch points are sorted by y, so that equal patches of two clouds have one order.
    return np.lexsort((xy[:, 0], xy[:, 1], row * (last + 1) + along))


@dataclass(frozen=True, eq=False)
class OwnAxes:
    """A frame in which a cloud, seen from above, is the same however its own frame lies."""

    centre: Float[Array, "2"]  # mean of the points (2,) [m]
    directions: Float[Array, "2 2"]  # the unit vectors as columns, that of the least scatter first

    @classmethod
    def of(cls, xy: Float[Array, "n 2"]) -> "OwnAxes":
        import cv2  # noqa: PLC0415 - loads slowly

        some = xy[:: -(-len(xy) // AXES_POINTS)]
        centre = some.mean(axis=0)
        centred = some - centre
        angle = np.deg2rad(cv2.minAreaRect(centred.astype(np.float32))[2])
        sides = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        moved = centred @ sides
        scatter = moved * moved
        longer_tail = np.where((scatter * moved).sum(axis=0) < 0, -1.0, 1.0)
        return cls(centre, (sides * longer_tail)[:, np.argsort(scatter.sum(axis=0))])

    def along(self, xy: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """Express positions (n, 2) [m] in this frame (n, 2) [m]."""
        return (xy - self.centre) @ self.directions


def extent_of(points: Float[Array, "n d"]) -> Float[Array, "2"]:
    """Compute the sides (2,) [m] of the smallest rectangle around points, seen from above."""
    xy = points[:, :2]
    return np.ptp(OwnAxes.of(xy).along(xy), axis=0)


def bin_points(
    points: Float[Array, "n 3"], cell: float, noise_std: float | Float[Array, "n"] = 1.0
) -> tuple[Float[Array, "b 3"], Float[Array, "b"]]:
    """Replace the points [m] of each square cell by their weighted mean; also give its noise."""
    cells = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / cell).astype(np.int64)
    owner = group(cells[:, ::-1])
    precision = np.broadcast_to(noise_std, len(points)) ** -2.0
    total = np.bincount(owner, precision)
    occupied = total > 0
    total = total[occupied]
    means = [np.bincount(owner, precision * points[:, k])[occupied] / total for k in range(3)]
    return np.column_stack(means), 1 / np.sqrt(total)


def thin_dense(
    points: Float[Array, "n 3"],
    noise_std: Float[Array, "n"],
    length_scale: float,
    signal_std: float,
) -> tuple[Float[Array, "b 3"], Float[Array, "b"]]:
    """Bin a cloud [m] to cells of up to an eighth of a length-scale, if that at least halves it."""
    # The curvature of the ground within a cell must stay far below the noise.
    flat_enough = float(np.sqrt(np.median(noise_std) / (5 * signal_std)))
    means, noise_of_mean = bin_points(points, length_scale * min(1 / 8, flat_enough), noise_std)
    return (means, noise_of_mean) if len(means) <= len(points) / 2 else (points, noise_std)
