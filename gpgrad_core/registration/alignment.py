"""Aligns two reliefs to a few centimetres: robust Gauss-Newton on their elevation."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.registration.relief import Image, Relief
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Array

FEWEST_CELLS = 30
"""Fewer common cells hold no motion."""
STRETCHES_ACROSS = 40.0
"""Submaps are warped by drift, and what one view hides is wrong in whole stretches: an independent
sample of the difference stands for a stretch of 2π (width / this)², and not for a cell."""
COVARIANCE_FACTOR = 3.0
"""Errors of accepted pairs have this many times the covariance of independent stretches (measured
on four sets, whole, thinned and noisy)."""
ROBUSTNESS = 1.0
"""Residuals count half from this many (robust) variances on."""


@dataclass(frozen=True)
class Warp:
    """How far one map may be out of shape against the other; none of it is a part of the motion.

    Attributes:
        tilt_std: Of their tilt [rad]: how well gravity is known.
        bend_std: Of the coefficients of x², xy and y² of their difference [1/m], by which a
            submap bends as its odometry drifts; None: they are not bent.
    """

    tilt_std: float
    bend_std: float | None = None


LEVEL = Warp(0.005)
"""Little freedom: what many wrong starts could not use to look right."""
DRIFTED = Warp(0.03, 0.005)
"""Enough for submaps as odometry makes them: a right motion is placed a quarter to a third
better (measured on three sets), and beyond it nothing is gained."""


@dataclass(frozen=True, eq=False)
class Alignments:
    """Motions after alignment, a row each.

    Attributes:
        motions: x [m], y [m], yaw [rad] of ``T_database_query``.
        z_offsets: What is to be added to the query's heights [m].
        z_stds: Standard deviations of these [m].
        covariances: Of x, y and yaw.
        likeness: How well the levelled terrain correlates, all octaves at once: a quick look at how
            good a motion is.
        held: Where the maps have enough in common; elsewhere the motion is as it was.
    """

    motions: Float[Array, "m 3"]
    z_offsets: Float[Array, "m"]
    z_stds: Float[Array, "m"]
    covariances: Float[Array, "m 3 3"]
    likeness: Float[Array, "m"]
    held: Bool[NDArray[np.bool_], "m"]

    def motion(self, k: int) -> SE2:
        """One motion, its yaw in (-pi, pi]."""
        x, y, yaw = (float(value) for value in self.motions[k])
        return SE2(x, y, float(np.arctan2(np.sin(yaw), np.cos(yaw))))


def align(
    query: Relief,
    database: Relief,
    starts: list[SE2],
    *,
    num_cells: int,
    iterations: int,
    warp: Warp = LEVEL,
) -> Alignments:
    """Improve motions by what the ground says, all at once.

    Minimises the difference in elevation over the overlap, less an offset and a small warp:
    what is left of it under the right motion is noise. Residuals weigh as Cauchy's, since
    rocks hide the ground behind them from one side only.

    Args:
        query: Map to be placed.
        database: Map it is placed on.
        starts: ``T_database_query``, up to a few scales of comparison off.
        num_cells: Cells of the database that are looked at, about, evenly chosen.
        iterations: Of Gauss-Newton.
        warp: How far the maps may be out of shape.
    """
    problem = _Problem(query, database, num_cells, warp)
    motions = np.array([[one.x, one.y, one.yaw] for one in starts])
    weight: Float[Image, "m cells"] | None = None
    for _ in range(iterations):
        step = problem.linearise(motions, weight)
        weight = step.weight
        motions = motions + np.where(step.held[:, None], step.change[:, :3], 0.0)
    last = problem.linearise(motions, weight)
    return Alignments(
        motions,
        last.change[:, 3] + database.base - query.base,
        np.sqrt(np.maximum(last.covariance[:, 3, 3], 0.0)),
        last.covariance[:, :3, :3],
        problem.likeness(motions),
        last.held,
    )


@dataclass(frozen=True, eq=False)
class _Step:
    change: Float[Array, "m p"]  # of x, y [m], yaw [rad], offset [m], tilts [rad], bends [1/m]
    covariance: Float[Array, "m p p"]
    weight: Float[Image, "m cells"]
    held: Bool[NDArray[np.bool_], "m"]


class _Problem:
    """The least-squares problems of one query and one database."""

    def __init__(self, query: Relief, database: Relief, num_cells: int, warp: Warp) -> None:
        rows, columns = np.nonzero(database.trusted)
        every = max(1, len(rows) // num_cells)
        rows, columns = rows[::every], columns[::every]
        self._query, self._database = query, database
        self._warp = warp
        positions = database.grid.to_position(np.column_stack([columns, rows]).astype(float))
        # About their middle half the digits are fine, however far the frame's origin lies.
        self._middle = positions.mean(axis=0) if len(positions) else np.zeros(2)
        x, y = (positions - self._middle).astype(np.float32).T
        self._positions = np.stack([x, y, np.ones_like(x)])
        self._elevation = database.elevation[rows, columns]
        self._half_slope = np.float32(0.5) * database.slope[rows, columns].T
        self._terrain = database.terrain[rows, columns]
        # How many cells one independent sample of the residual stands for.
        patch = 2 * np.pi * database.scale**2
        cell = every * database.grid.resolution**2
        self._cells_a_patch = max(1.0, patch / cell)
        extent = database.grid.num_cells * database.grid.resolution**2
        self._cells_a_stretch = max(1.0, 2 * np.pi * extent / STRETCHES_ACROSS**2 / cell)
        self._image = np.dstack([query.elevation, query.slope, query.trusted.astype(np.float32)])
        self._precision = _precision(warp)

    def linearise(
        self, motions: Float[Array, "m 3"], weight: Float[Image, "m cells"] | None
    ) -> _Step:
        """Take one step of each motion, with the weights that the step before found.

        Cell by cell in float32, which noise of centimetres allows and which takes half the time.
        """
        elevation, along, across, trusted = cv2.split(self._sample(self._image, motions))
        common = trusted > 0.999
        count = np.count_nonzero(common, axis=1)
        held = count >= FEWEST_CELLS
        shown = common.astype(np.float32)
        weight = shown if weight is None else weight * shown

        # The Jacobian, a row each for x, y, yaw, offset, tilts and bends; and the residual.
        size = len(self._precision)
        system = np.empty((len(motions), size + 1, shown.shape[1]), np.float32)
        by_x, by_y, by_yaw = system[:, 0], system[:, 1], system[:, 2]
        # The mean of both slopes: it is less noisy, and swapping the maps changes nothing.
        c, s = (np.float32(0.5) * factor for factor in _cos_sin(motions))
        np.subtract(s * across - c * along, self._half_slope[0], out=by_x)
        np.subtract(-s * along - c * across, self._half_slope[1], out=by_y)
        x, y, _ = self._positions
        arm = (motions[:, :2] - self._middle).astype(np.float32)
        np.subtract(by_y * (x - arm[:, :1]), by_x * (y - arm[:, 1:]), out=by_yaw)
        system[:, 3] = 1.0
        per_cell = (1 / np.maximum(count, 1)[:, None]).astype(np.float32)
        middle = (shown @ self._positions[:2].T) * per_cell
        tilts = np.subtract(self._positions[:2], middle[..., None], out=system[:, 4:6])
        if self._warp.bend_std is not None:
            bends = system[:, 6:9]
            np.multiply(tilts[:, [0, 0, 1]], tilts[:, [0, 1, 1]], out=bends)
            bends -= (bends @ shown[..., None]) * per_cell[..., None]
        residual = np.subtract(elevation, self._elevation, out=system[:, size])

        products = ((system * weight[:, None]) @ system.transpose(0, 2, 1)).astype(np.float64)
        normal, gradient = products[:, :size, :size], products[:, :size, size]
        # The warp is held by its prior, worth as much as the noise of one patch.
        weighed = np.maximum(products[:, 3, 3, None], 1e-12)
        off = residual - (gradient[:, 3, None] / weighed).astype(np.float32)
        scale = _robust_variance(np.square(off, out=off), common, count)
        diagonal = np.arange(size)
        normal[:, diagonal, diagonal] *= 1 + 1e-9
        normal[:, diagonal, diagonal] += 1e-9 + np.outer(
            scale * self._cells_a_patch, self._precision
        )
        inverse = np.linalg.inv(normal)
        change = -(inverse @ gradient[..., None])[..., 0]
        applied = np.concatenate([change, np.ones((len(change), 1))], axis=1)
        left = (applied[:, None].astype(np.float32) @ system)[:, 0]
        squared = np.square(left, out=left)
        variance = _robust_variance(squared, common, count)
        half = (ROBUSTNESS * variance[:, None]).astype(np.float32)
        return _Step(
            change,
            (COVARIANCE_FACTOR * variance * self._cells_a_stretch)[:, None, None] * inverse,
            half / (half + squared),
            held,
        )

    def likeness(self, motions: Float[Array, "m 3"]) -> Float[Array, "m"]:
        """Correlate the terrain under each motion; see `Alignments`."""
        image = np.dstack([self._query.terrain, self._image[..., 3]])
        terrain, trusted = cv2.split(self._sample(image, motions))
        common = (trusted > 0.999).astype(np.float32)
        theirs, ours = terrain * common, self._terrain * common
        energy = np.sum(theirs**2, axis=1) * np.sum(ours**2, axis=1)
        product = np.sum(theirs * ours, axis=1).astype(np.float64)
        correlation = product / np.sqrt(np.maximum(energy, 1e-20))
        squared = np.clip(correlation, 0.0, 0.9999) ** 2
        return -np.log1p(-squared) * np.sqrt(common.sum(axis=1))

    def _sample(
        self, image: Float[Image, "rows columns fields"], motions: Float[Array, "m 3"]
    ) -> Float[Image, "m cells fields"]:
        """Fields of the query under the database's cells; 0 beyond its edge."""
        grid = self._query.grid
        yaw = motions[:, 2]
        c, s = np.cos(yaw) / grid.resolution, np.sin(yaw) / grid.resolution
        x, y = (self._middle - motions[:, :2]).T
        column, row = (origin / grid.resolution for origin in grid.origin)
        onto = [[c, s, c * x + s * y - column], [-s, c, c * y - s * x - row]]
        columns, rows = (
            np.column_stack(of_cell).astype(np.float32) @ self._positions for of_cell in onto
        )
        sampled = cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        return np.asarray(sampled, np.float32)


def _precision(warp: Warp) -> Float[Array, "p"]:
    """Of the prior of each column of the Jacobian; the motion and the offset have none."""
    tilts = [warp.tilt_std**-2] * 2
    bends = [] if warp.bend_std is None else [warp.bend_std**-2] * 3
    return np.array([0.0] * 4 + tilts + bends)


def _cos_sin(motions: Float[Array, "m 3"]) -> tuple[Float[Image, "m 1"], Float[Image, "m 1"]]:
    yaw = motions[:, 2:]
    return np.cos(yaw).astype(np.float32), np.sin(yaw).astype(np.float32)


def _robust_variance(
    squared: Float[Image, "m cells"],
    common: Bool[NDArray[np.bool_], "m cells"],
    count: NDArray[np.intp],
) -> Float[Array, "m"]:
    """Variance by the median of squared residuals, which rocks do not move."""
    ordered = np.sort(np.where(common, squared, np.float32(np.inf)), axis=1)
    median = ordered[np.arange(len(squared)), np.maximum(count - 1, 0) // 2]
    return np.where(count > 0, median, 0.0).astype(np.float64) / 0.455 + 1e-12
