"""The exact GP for sparse clouds: small tiles of points, each with its neighbours.

If there are few points in a length-scale, a tile and its neighbours hold about a hundred points,
and their covariance is inverted directly. The variance is local enough to be computed from that
inverse. The mean is not: the tiles' inverses correct it sweep by sweep, and each tile writes only
its own points (restricted additive Schwarz), until the heights are met everywhere.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.polynomial.chebyshev import chebvander

from gpgrad_core.arrays import Array, Floats, Indices, Mask
from gpgrad_core.gp.cloud import Cloud
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.solution import Cost, GPProblem, Posterior, Solver, TerrainFields, clip_variance
from gpgrad_core.gp.splat import FineKernel, MeanField
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.threads import own_threads
from gpgrad_core.types import Grid

Group = tuple[tuple[int, int], Indices]
"""A tile (column, row) and the indices of the points that it sees."""

TILE = 5.0
"""Side of a tile [length-scales]."""
MOST_INFORMATION_IN_SINGLE = 1e3
"""Up to this information the inverses are float32, which takes half the time."""
MOST_INFORMATION_BY_HALVES = 1e5
"""Up to this information matrices are inverted by halves; beyond it, digits would be lost."""
MAX_SWEEPS = 30
"""Where as many do not converge, the lattice is used instead."""
LARGEST_LEAF = 24
"""Largest number of rows that NumPy's own inversion handles."""
BATCH = 32
"""Number of tiles that are inverted or sampled at once."""
MOST_PRODUCTS = 2_000_000
"""Largest number of covariances of cells and points that are held at once."""
NODES = {4: 32, 8: 40}
"""Number of Chebyshev nodes along a side of a tile, by the bytes of a number."""
MOST_SMOOTH = 6.0
"""Largest side of a tile for which that holds [length-scales]."""
WORTH = 1.2
"""A tile is interpolated if it has this many times as many cells as nodes."""
BYTES_A_POINT = 3500
"""Memory of a point in the factors of its Gaussians, and in the tiles that see it."""
SECONDS_A_PRODUCT, SECONDS_A_TILE, SECONDS_A_POINT, SECONDS = 2.7e-10, 5.8e-5, 1.2e-5, 0.034
"""Seconds of a fit and its samples on two cores of 2.8 GHz: for the cube of the points that a tile
sees, for a tile, for a point, and constant."""


@dataclass(frozen=True, eq=False)
class _Batch:
    """Tiles with about the same number of points, padded to the same number."""

    tiles: Int[Indices, "b 2"]  # (column, row) of each tile
    members: Int[Indices, "b p"]  # indices of the points of the tile and its neighbours
    padding: Bool[Mask, "b p"]  # entries of `members` that are only padding
    owned: Bool[Mask, "b p"]  # members that lie in the tile itself
    inverse: Float[Floats, "b p p"]  # A = [K + D]⁻¹ of the members, or its root W: A = Wᵀ W
    is_root: bool

    def solve(self, right: Float[Array, "b p"]) -> Float[Floats, "b p"]:
        narrow = right.astype(self.inverse.dtype)[..., None]
        if self.is_root:
            return (self.inverse.transpose(0, 2, 1) @ (self.inverse @ narrow))[..., 0]
        return (self.inverse @ narrow)[..., 0]

    def reduction(
        self, tiles: slice, covariance: Float[Floats, "t cells p"]
    ) -> Float[Floats, "t cells"]:
        """Compute ``k A k`` for the covariances k of some cells of some tiles."""
        if self.is_root:
            product = covariance @ self.inverse[tiles].transpose(0, 2, 1)
            return np.einsum("bcp,bcp->bc", product, product)
        return np.einsum("bcp,bcp->bc", covariance @ self.inverse[tiles], covariance)


@dataclass(frozen=True, eq=False)
class TilePosterior(Posterior):
    """The posterior mean as one field, and the variance in tiles."""

    field: MeanField  # relative to the mean
    points_xy: Float[Array, "n 2"]  # [m]
    tiling: "_Tiling"
    batches: tuple[_Batch, ...]  # the inverses of all tiles

    def sample(self, grid: Grid) -> TerrainFields:
        fields = TerrainFields.prior(grid, self.kernel, self.mean)
        self.field.add_to(grid.x, grid.y, fields.elevation, fields.slope)
        self._reduce(fields.variance, grid, sloping=(False, False))
        clip_variance(fields.variance, self.kernel.signal_std**2)
        return fields

    def sample_slope_variance(self, grid: Grid) -> Float[Array, "rows columns 2"]:
        prior = self.kernel.slope_std**2
        variance = np.full((*grid.shape, 2), prior)
        self._reduce(variance[..., 0], grid, sloping=(True, False))
        self._reduce(variance[..., 1], grid, sloping=(False, True))
        return clip_variance(variance, prior)

    def _reduce(
        self, variance: Float[Array, "rows columns"], grid: Grid, *, sloping: tuple[bool, bool]
    ) -> None:
        """Subtract what the data know from a prior variance in place, Eq. (3)."""
        columns = self.tiling.edges(grid.x, axis=0)
        rows = self.tiling.edges(grid.y, axis=1)

        def reduction(batch: _Batch) -> Float[Floats, "b height width"]:
            x = grid.x[_cells(columns, batch.tiles[:, 0])]
            y = grid.y[_cells(rows, batch.tiles[:, 1])]
            nodes = NODES[batch.inverse.dtype.itemsize]
            widest = max(float(np.ptp(at, axis=1).max()) for at in (x, y))
            # The outermost tiles may have cells far beyond the points.
            smooth = widest <= MOST_SMOOTH * self.kernel.length_scale
            if x.shape[1] * y.shape[1] <= WORTH * nodes**2 or not smooth:
                return self._reduction(batch, x, y, sloping)
            (at_x, by_x), (at_y, by_y) = (_interpolation(at, nodes) for at in (x, y))
            return by_y @ self._reduction(batch, at_x, at_y, sloping) @ by_x.transpose(0, 2, 1)

        with own_threads() as executor:
            for batch, reduced in zip(
                self.batches, executor.map(reduction, self.batches), strict=True
            ):
                for (column, row), tile in zip(batch.tiles, reduced, strict=True):
                    own = variance[rows[row] : rows[row + 1], columns[column] : columns[column + 1]]
                    height, width = own.shape
                    own -= tile[:height, :width]

    def _reduction(
        self,
        batch: _Batch,
        x: Float[Array, "b width"],
        y: Float[Array, "b height"],
        sloping: tuple[bool, bool],
    ) -> Float[Floats, "b height width"]:
        """Compute the reduction of the variance in each tile, ``k(x, X) [K + D]⁻¹ k(X, x)``."""
        at = self.points_xy[batch.members]
        length = self.kernel.length_scale
        along: list[Float[Floats, "b cells p"]] = []
        for axis, cells in enumerate((x, y)):
            offset = ((cells[:, :, None] - at[:, None, :, axis]) / length).astype(
                batch.inverse.dtype
            )
            bell = np.exp(-0.5 * offset**2)
            along.append(bell * offset / length if sloping[axis] else bell)
        along_x, along_y = along
        along_y *= np.where(batch.padding, 0.0, self.kernel.signal_std**2)[:, None, :].astype(
            batch.inverse.dtype
        )
        reduced = np.empty((len(at), y.shape[1], x.shape[1]), batch.inverse.dtype)
        # Some tiles, or some rows of one tile, at a time: all at once would take gigabytes.
        row = x.shape[1] * at.shape[1]
        height = max(1, min(y.shape[1], MOST_PRODUCTS // row))
        together = max(1, MOST_PRODUCTS // (row * height))
        for first in range(0, len(at), together):
            tiles = slice(first, first + together)
            for start in range(0, y.shape[1], height):
                rows = slice(start, start + height)
                covariance = along_y[tiles, rows, None, :] * along_x[tiles, None, :, :]
                shape = covariance.shape
                reduced[tiles, rows] = batch.reduction(
                    tiles, covariance.reshape(shape[0], -1, shape[3])
                ).reshape(shape[:3])
        return reduced


class TileSolver(Solver):
    """Takes a time that grows with the cube of the points in a tile."""

    def fit(self, problem: GPProblem, progress: Progress = silent) -> TilePosterior | None:
        cloud, kernel, bits = problem.cloud, problem.kernel, problem.information
        dtype = np.float32 if bits <= MOST_INFORMATION_IN_SINGLE else np.float64
        tiling = _Tiling.over(cloud.xy, TILE * kernel.length_scale)
        owner = tiling.owner(cloud.xy)
        exactly = bits > MOST_INFORMATION_BY_HALVES
        groups = tiling.members(cloud.xy, problem.accuracy.tile_halo_of(bits) * kernel.length_scale)
        chunks = [groups[start : start + BATCH] for start in range(0, len(groups), BATCH)]
        batches: list[_Batch] = []

        def invert(chunk: list[Group]) -> _Batch:
            return _invert(chunk, owner, cloud, kernel, dtype, exactly=exactly)

        with own_threads() as executor:
            fine = FineKernel(cloud, kernel, bits)
            for batch in executor.map(invert, chunks):
                batches.append(batch)
                progress(0.8 * len(batches) / len(chunks))
            limit = problem.accuracy.residual_of(bits, cloud.signal_to_noise(kernel.signal_std))
            weights = _sweep(cloud, fine, batches, limit)
            if weights is None:
                return None
            field = fine.field(weights)
        progress(1.0)
        return TilePosterior(kernel, problem.mean, field, cloud.xy, tiling, tuple(batches))

    def cost(self, problem: GPProblem) -> Cost:
        from scipy.ndimage import correlate1d  # noqa: PLC0415 - loads slowly

        xy, bits = problem.cloud.xy, problem.information
        cells = np.floor((xy - xy.min(axis=0)) / (TILE * problem.kernel.length_scale)).astype(
            np.int64
        )
        columns = int(cells[:, 0].max()) + 1
        tiles, counts = np.unique(cells[:, 1] * columns + cells[:, 0], return_counts=True)
        image = np.zeros((int(cells[:, 1].max()) + 1, columns))
        image.flat[tiles] = counts
        # A halo takes its share of the neighbours' points.
        halo = problem.accuracy.tile_halo_of(bits) / TILE
        near, next_but_one = min(halo, 1.0), max(halo - 1.0, 0.0)
        for axis in (0, 1):
            weights = [next_but_one, near, 1.0, near, next_but_one]
            image = correlate1d(image, weights, axis=axis, mode="constant")
        num_points = image.flat[tiles]
        seconds = (
            SECONDS
            + SECONDS_A_PRODUCT * np.sum(num_points**3)
            + SECONDS_A_TILE * len(num_points)
            + SECONDS_A_POINT * len(xy)
        )
        digits = 4 if bits <= MOST_INFORMATION_IN_SINGLE else 8
        # While they are inverted, a batch of them on each thread takes several times its size.
        inverses = (
            digits * np.sum(num_points**2)
            + 8 * 6 * min(BATCH, len(num_points)) * num_points.max() ** 2
        )
        return Cost(float(seconds), float(inverses + BYTES_A_POINT * len(xy)))


@dataclass(frozen=True)
class _Tiling:
    """Square tiles over the points; the outermost tiles cover everything beyond."""

    low: tuple[float, float]  # [m]
    side: float  # [m]
    counts: tuple[int, int]  # (columns, rows)

    @classmethod
    def over(cls, xy: Float[Array, "n 2"], side: float) -> "_Tiling":
        low = xy.min(axis=0)
        counts = np.floor((xy.max(axis=0) - low) / side).astype(int) + 1
        return cls((float(low[0]), float(low[1])), side, (int(counts[0]), int(counts[1])))

    def edges(self, coordinates: Float[Array, "c"], *, axis: int) -> Int[Indices, "tiles_and_one"]:
        """Find the index of the first sorted coordinate in each tile; the last is their number."""
        inner = self.low[axis] + self.side * np.arange(1, self.counts[axis])
        return np.concatenate([[0], np.searchsorted(coordinates, inner), [len(coordinates)]])

    def owner(self, xy: Float[Array, "n 2"]) -> Int[Indices, "n 2"]:
        tile = np.floor((xy - np.array(self.low)) / self.side).astype(np.intp)
        return np.clip(tile, 0, np.array(self.counts) - 1)

    def members(self, xy: Float[Array, "n 2"], halo: float) -> list[Group]:
        """List each tile with the points within its halo [m]; the tile with fewest comes first."""
        own = self.owner(xy)
        reach = int(np.ceil(halo / self.side))
        steps = np.arange(-reach, reach + 1)
        members: list[Int[Indices, "f 3"]] = []
        for step in np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2):
            tile = own + step
            corner = np.array(self.low) + tile * self.side
            exists = (tile >= 0) & (tile < np.array(self.counts))
            near = (xy >= corner - halo) & (xy <= corner + self.side + halo)
            point = np.flatnonzero((exists & near).all(axis=1))
            members.append(np.column_stack([tile[point], point]))
        rows = np.concatenate(members)
        rows = rows[np.lexsort(rows.T[::-1])]  # by column, row, point
        first = np.flatnonzero(np.any(rows[1:, :2] != rows[:-1, :2], axis=1)) + 1
        groups = [
            ((int(group[0, 0]), int(group[0, 1])), group[:, 2]) for group in np.split(rows, first)
        ]
        return sorted(groups, key=lambda group: len(group[1]))


def _invert(
    groups: list[Group],
    owner: Int[Indices, "n 2"],
    cloud: Cloud,
    kernel: SquaredExponential,
    dtype: type[np.float32] | type[np.float64],
    *,
    exactly: bool,
) -> _Batch:
    tiles = np.array([tile for tile, _ in groups], dtype=np.intp)
    size = max(len(members) for _, members in groups)
    members = np.zeros((len(groups), size), dtype=np.intp)
    padding = np.ones((len(groups), size), dtype=bool)
    for k, (_, chosen) in enumerate(groups):
        members[k, : len(chosen)] = chosen
        padding[k, : len(chosen)] = False
    at = cloud.xy[members]
    # Relative to the tile's middle, in length-scales, float32 is precise enough for positions.
    at = ((at - at.mean(axis=1, keepdims=True)) / kernel.length_scale).astype(dtype)
    kernel_rows = (at[:, :, None, 0] - at[:, None, :, 0]) ** 2
    kernel_rows += (at[:, :, None, 1] - at[:, None, :, 1]) ** 2
    kernel_rows *= dtype(-0.5)
    np.exp(kernel_rows, out=kernel_rows)
    # float64 from here: an inversion by halves loses digits if the matrix is ill-conditioned.
    covariance = kernel_rows * np.float64(kernel.signal_std**2)
    covariance[padding[:, :, None] | padding[:, None, :]] = 0
    diagonal = np.einsum("bpp->bp", covariance)  # a view
    diagonal += np.where(padding, 1.0, cloud.noise_variance[members])
    owned = ~padding & (owner[members] == tiles[:, None, :]).all(axis=-1)
    if exactly:
        return _Batch(tiles, members, padding, owned, _root_of_inverse(covariance), is_root=True)
    inverse = _invert_by_halves(covariance).astype(dtype)
    return _Batch(tiles, members, padding, owned, inverse, is_root=False)


def _root_of_inverse(stack: Float[Array, "b m m"]) -> Float[Array, "b m m"]:
    """Compute W with ``Wᵀ W`` the inverse of each matrix: a sum of squares loses no digits."""
    from scipy.linalg.lapack import dtrtri  # noqa: PLC0415 - loads slowly

    roots = np.empty_like(stack)
    for k, factor in enumerate(np.linalg.cholesky(stack)):
        roots[k], _ = dtrtri(factor, lower=1)
    return roots


def _invert_by_halves(stack: Float[Array, "b m m"]) -> Float[Array, "b m m"]:
    """Invert symmetric positive definite matrices: `invert_pivot` for many small ones at once."""
    size = stack.shape[-1]
    if size <= LARGEST_LEAF:
        leaf = np.linalg.inv(stack)
        # The next steps rely on symmetry; without this, rounding errors grew a million times.
        return 0.5 * (leaf + leaf.transpose(0, 2, 1))
    half = size // 2
    first = _invert_by_halves(stack[:, :half, :half])
    gain = stack[:, half:, :half] @ first
    second = _invert_by_halves(stack[:, half:, half:] - gain @ stack[:, :half, half:])
    below = second @ gain
    inverse = np.empty_like(stack)
    inverse[:, half:, half:] = second
    inverse[:, :half, :half] = first + gain.transpose(0, 2, 1) @ below
    inverse[:, half:, :half] = -below
    inverse[:, :half, half:] = -below.transpose(0, 2, 1)
    return inverse


def _cells(edges: Int[Indices, "e"], tiles: Int[Indices, "b"]) -> Int[Indices, "b most"]:
    """List the indices of each tile's cells along one axis, padded by repeating the last."""
    most = max(1, int(np.diff(edges)[tiles].max()))
    return np.minimum(edges[tiles][:, None] + np.arange(most), max(int(edges[-1]) - 1, 0))


def _interpolation(
    at: Float[Array, "b cells"], count: int
) -> tuple[Float[Array, "b count"], Float[Array, "b cells count"]]:
    """Lay Chebyshev nodes over each row of coordinates, and make matrices to interpolate."""
    low, high = at.min(axis=1, keepdims=True), at.max(axis=1, keepdims=True)
    half, middle = np.maximum((high - low) / 2, 1e-12), (low + high) / 2
    angles = np.pi * (np.arange(count) + 0.5) / count
    order = np.arange(count)
    # Values at the nodes to coefficients of Chebyshev's polynomials, and these to the values.
    coefficients = np.cos(order[:, None] * angles) * 2 / count
    coefficients[0] /= 2
    polynomials = chebvander((at - middle) / half, count - 1)
    return middle + half * np.cos(angles), polynomials @ coefficients


def _sweep(
    cloud: Cloud, fine: FineKernel, batches: list[_Batch], tolerance: float
) -> Float[Array, "n"] | None:
    """Solve ``(K + D) weights = heights``; return None if it does not converge."""
    weights = np.zeros_like(cloud.heights)
    residual = cloud.heights
    for _ in range(MAX_SWEEPS):
        for batch in batches:
            step = batch.solve(np.where(batch.padding, 0.0, residual[batch.members]))
            weights[batch.members[batch.owned]] += step[batch.owned]
        residual = cloud.heights - fine.times(weights) - cloud.noise_variance * weights
        if cloud.residual_rms(residual) <= tolerance:
            return weights
    return None
