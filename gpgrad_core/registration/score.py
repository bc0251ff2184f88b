"""How well two maps agree under a motion: the evidence, its score, and the paper's h."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import exp, expm1, log, log1p, pi, sqrt

import cv2
import numpy as np
from jaxtyping import Float, Float32

from gpgrad_core.arrays import Array, Floats, Singles
from gpgrad_core.registration.align import (
    FEWEST_CELLS,
    Overlay,
    median,
    overlay,
    smooth_between,
    sparse_overlay,
    take_warp_out,
)
from gpgrad_core.registration.surface import NUM_BANDS, Surface, ThinMap, band_edges, smooth_surface
from gpgrad_core.se2 import SE2
from gpgrad_core.types import MAX_STD_RATIO, Agreement, GradientMap, Grid

DRIFT_SHARE = 0.04
"""Share of a band's relief that drift and a slightly wrong motion may change."""
FREEDOM = 3.0
"""Degrees of freedom of Student's t, whose long tails keep a moved rock from deciding alone."""
INLIER_WEIGHT = 3.0
"""Weight of log(1 + n), for n inliers, relative to the terrain's evidence."""
BAND_WEIGHTS = (1.0, 0.5)
"""Weights of the bands; the warp absorbs much of the second."""
UNRELATED_LEVEL, UNRELATED_SPREAD = 0.8, 2.0
"""Level and spread of the Gumbel distribution of the highest evidence of unrelated pairs."""


@dataclass(frozen=True)
class Evidence:
    """What both maps say about one motion."""

    patches: float  # area of the overlap in patches of 2π scale². Within a patch terrain is alike.
    # for each band, the mean log-likelihood ratio of one terrain against two
    log_ratios: tuple[float, ...]
    # how well the heights agree; None if too few cells are common
    agreement: Agreement | None = None


def weigh(query: Surface, database: Surface, motions: Sequence[SE2]) -> list[Evidence]:
    """Compare the terrain of two maps over their overlap under each motion, band by band.

    If both maps show one terrain, the difference of their heights in a band has the variance of
    the uncertainty of both, N, and of drift. If they show two terrains, the variance S of the
    terrain itself is added. With w the difference divided by √2, and t the density of Student's
    t, the log ratio of the two likelihoods of a cell is

        log t(w; N + share² S) - log t(w; S + N)

    Where N is as large as S, neither noise nor flat ground says anything. An offset, a tilt and a
    bend are removed first. The log ratios are 0 if fewer than `FEWEST_CELLS` cells are common.
    """
    overlap = overlay(query, database, motions)
    patches = (overlap.counts * overlap.step**2 / (2 * pi * overlap.scale**2)).tolist()
    evidence = [Evidence(area, (0.0,) * NUM_BANDS) for area in patches]
    held = overlap.counts >= FEWEST_CELLS
    if not held.any():
        return evidence
    overlap = overlap.select(held)
    bands, ends = list(_compare_bands(overlap)), np.cumsum(overlap.counts)
    for row, k in enumerate(np.flatnonzero(held).tolist()):
        cells = slice(ends[row] - overlap.counts[row], ends[row])
        evidence[k] = Evidence(
            patches[k],
            tuple(float(np.mean(band.log_ratio[cells])) for band in bands),
            Agreement(
                sqrt(sum(2 * median(band.squared[cells]) / 0.455 for band in bands)),
                sqrt(sum(2 * float(np.mean(band.variance_of_one[cells])) for band in bands)),
                sqrt(sum(float(band.signal[row]) for band in bands)),
            ),
        )
    return evidence


def rough_evidence(
    query: Surface, database: Surface, motions: Float[Array, "m 3"], num_cells: int
) -> Float[Array, "m"]:
    """Weigh several motions (x, y, yaw) at once, in one band and over fewer cells than `weigh`."""
    overlaps = sparse_overlay(query, database, motions, num_cells)
    x, y = overlaps.positions
    warp = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    weight = overlaps.common.astype(np.float32)
    count = weight.sum(axis=1)
    size = len(warp)
    products = (warp[:, None] * warp).reshape(size**2, -1)
    normal = (weight @ products.T).reshape(-1, size, size).astype(np.float64)
    diagonal = np.arange(size)
    normal[:, diagonal, diagonal] = 1e-9 + (1 + 1e-6) * normal[:, diagonal, diagonal]

    def flat(heights: Float32[Singles, "m cells"]) -> Singles:
        """Remove the offset, tilt and bend over the common cells."""
        projected = ((heights * weight) @ warp.T).astype(np.float64)
        bent = np.linalg.solve(normal, projected[..., None])[..., 0].astype(np.float32) @ warp
        return np.asarray((heights - bent) * weight, np.float32)

    ours, theirs = (
        flat(overlaps.query),
        flat(np.broadcast_to(overlaps.database, overlaps.query.shape)),
    )
    per_cell = 1 / np.maximum(count, 1)
    signal = 0.5 * ((ours**2).sum(axis=1) + (theirs**2).sum(axis=1)) * per_cell
    noise = (overlaps.noise * weight).sum(axis=1) * per_cell
    squared = 0.5 * np.square(ours - theirs)
    one, two = noise + DRIFT_SHARE**2 * signal + 1e-8, noise + signal + 1e-8
    log_ratio = _log_ratio(squared, one[:, None], two[:, None])
    ratio = (log_ratio * weight).sum(axis=1) * per_cell
    patches = np.where(count >= FEWEST_CELLS, count / overlaps.cells_a_patch, 0.0)
    return np.sqrt(patches).astype(np.float64) * ratio


def map_agreement(
    query: GradientMap,
    database: GradientMap,
    T_database_query: SE2,
    max_std_ratio: float = MAX_STD_RATIO,
) -> tuple[Grid, Float32[Singles, "rows columns"]]:
    """Show where two maps agree under a motion, and where not.

    A cell of the overlap, as coarse as the comparison and in the database's frame, has the weighted
    log ratio of `weigh`: below 0 where heights differ by more than the uncertainty of both maps
    allows, NaN where there is nothing to compare. The mean, times √N, is what the terrain adds to
    the evidence.
    """
    surfaces = smooth_surface(query, max_std_ratio), smooth_surface(database, max_std_ratio)
    overlap = overlay(*surfaces, [T_database_query])
    shown = np.full(overlap.grid.shape, np.nan, np.float32)
    if overlap.counts[0] >= FEWEST_CELLS:
        shown[overlap.common[0]] = sum(
            weight / 2**k * band.log_ratio
            for k, (weight, band) in enumerate(
                zip(BAND_WEIGHTS, _compare_bands(overlap), strict=True)
            )
        )
    return overlap.grid, shown


@dataclass(frozen=True, eq=False)
class _Band:
    """A band of the heights of two maps at the common cells of one motion after the other."""

    squared: Float[Array, "n"]  # square of the difference of the heights, divided by 2 [m²]
    variance_of_one: Float[Array, "n"]  # variance of that if both maps show one terrain [m²]
    log_ratio: Float[Array, "n"]  # of one terrain against two
    signal: Float[Array, "m"]  # variance S of the terrain itself under each motion [m²]


def _compare_bands(overlap: Overlay) -> Iterator[_Band]:
    """Compare the heights in one band after the other, from the shortest waves."""
    cells = np.flatnonzero(overlap.common)
    counts = overlap.counts
    unknown = overlap.noise.astype(np.float64)
    pair = take_warp_out(overlap)
    for band in range(NUM_BANDS):
        smoother = smooth_between(*pair, overlap, band_edges(overlap.scale, band))
        a, b = (
            (fine - coarse).reshape(-1)[cells].astype(np.float64)
            for fine, coarse in zip(pair, smoother, strict=True)
        )
        pair = smoother
        squared = 0.5 * np.square(a - b)
        signal = 0.5 * np.add.reduceat(a * a + b * b, np.cumsum(counts) - counts) / counts
        of_cells = np.repeat(signal, counts)
        variance_of_one = unknown[:, band] + DRIFT_SHARE**2 * of_cells + 1e-8
        variance_of_two = unknown[:, band] + of_cells + 1e-8
        log_ratio = _log_ratio(squared, variance_of_one, variance_of_two).astype(np.float64)
        yield _Band(squared, variance_of_one, log_ratio, signal)


def closure_score(evidence: Evidence, num_inliers: int) -> float:
    """Score a motion: -log10 of the probability that unrelated ground reaches as much evidence.

    The sum of log ratios over N patches of varying ground scatters by √N, so the mean ratio times
    √N means the same for every overlap. Each band has a quarter of the patches of the band before.

        evidence = Σ_k weight_k √(N / 4^k) log_ratio_k + weight log(1 + n)

    The highest evidence of a pair of unrelated submaps over all motions follows a Gumbel
    distribution.
    """
    if evidence.agreement is None:
        return 0.0
    total = sum(shares_of_evidence(evidence, num_inliers))
    tail = exp(min(-(total - UNRELATED_LEVEL) / UNRELATED_SPREAD, 700.0))
    # log10(1 - exp(-tail)) without a loss of digits where the tail is small.
    chance = -expm1(-tail)
    return max(0.0, -log(chance) / log(10)) if chance > 0 else 300.0


def shares_of_evidence(evidence: Evidence, num_inliers: int) -> tuple[float, ...]:
    """List what is added up: for the inliers, and for each band from the shortest waves."""
    bands = (
        weight * sqrt(evidence.patches) / 2**band * ratio
        for band, (weight, ratio) in enumerate(zip(BAND_WEIGHTS, evidence.log_ratios, strict=True))
    )
    return (INLIER_WEIGHT * log1p(num_inliers), *bands)


def _log_ratio(
    squared: Float[Floats, "*n"], of_one: Float[Floats, "*#n"], of_two: Float[Floats, "*#n"]
) -> Float[Floats, "*n"]:
    """Log ratio of two densities of Student's t of a squared difference, by their variances."""
    tails = (1 + squared / (FREEDOM * of_one)) / (1 + squared / (FREEDOM * of_two))
    return -0.5 * np.log(of_one / of_two) - (FREEDOM + 1) / 2 * np.log(tails)


@lru_cache(maxsize=16)
def _trusted_cells(thin: ThinMap) -> tuple[Float[Array, "n 2"], Float32[Singles, "n 4"]]:
    trusted = thin.image[..., 3] > 0
    y, x = np.meshgrid(thin.grid.y, thin.grid.x, indexing="ij")
    return np.column_stack([x[trusted], y[trusted]]), thin.image[trusted]


def check_dense(
    query: ThinMap, database: ThinMap, T_database_query: SE2
) -> tuple[float, float, float, int]:
    """Compute the overlap area [m²], the correlation of the slopes, h, and its number of cells.

        h = Σ (I_g^q - I_g^d)² / (I_v^q I_v^d)    ComputeSSDMetric, Le Gentil 2020, Sec. V

    Each thinned cell counts for the cells of the map that it stands for.
    """
    positions, image = _trusted_cells(database)
    pixels = query.grid.to_pixel(T_database_query.inverse().apply(positions)).astype(np.float32)
    sampled = cv2.remap(
        query.image,
        pixels[:, :1],
        pixels[:, 1:],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(0, 0, 0, 0),
    ).reshape(-1, 4)
    common = sampled[:, 3] > 0.999  # all four neighbours are trusted
    theirs = image[common]
    # In the database's frame.
    ours = T_database_query.rotate(sampled[common, :2].astype(np.float64))
    slope = np.ascontiguousarray(theirs[:, :2], np.float64)
    variances = sampled[common, 2].astype(np.float64), theirs[:, 2].astype(np.float64)
    difference = np.hypot(*ours.T) - np.hypot(*slope.T)
    h = float(database.map_cells * np.sum(difference**2 / (variances[0] * variances[1])))
    count = len(ours)
    area, num_cells = count * database.grid.resolution**2, database.map_cells * count
    if count < 2:
        return area, 0.0, h, num_cells
    # By matrix products, because NumPy's means of long arrays of pairs are ten times slower.
    share = np.full(count, 1 / count)
    ours, slope = ours - share @ ours, slope - share @ slope
    energy = float(np.sqrt(np.vdot(ours, ours) * np.vdot(slope, slope)))
    return area, float(np.vdot(ours, slope)) / energy if energy > 0 else 0.0, h, num_cells
