"""Algorithm 1: SE(2) RANSAC over the associations, then a dense check of the slope fields."""

from dataclasses import dataclass
from math import log1p, sqrt
from typing import Annotated

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from typing_extensions import Doc

from gpgrad_core.bounds import Bounds, check_bounds
from gpgrad_core.progress import Progress, silent
from gpgrad_core.se2 import SE2, fit_se2
from gpgrad_core.types import Array, GradientMap, Grid, Matches, Registration

BoolArray = NDArray[np.bool_]

MAX_STD_RATIO = 0.3
"""The dense check compares cells whose standard deviation is at most this share of signal_std."""
CHECKED_CELLS = 6000
"""Cells of a map that the dense check looks at; slopes are smooth over many cells."""
REFITS = 3
"""Rounds of fitting the motion to its inliers and choosing these anew."""


@dataclass(frozen=True)
class RegistrationParams:
    """How a pair of maps is registered."""

    inlier_radius: Annotated[
        float,
        Bounds(0.01, 10.0, 0.01, "m", slider=(0.05, 1.0)),
        Doc("An association is an inlier if its keypoints meet within this distance."),
    ] = 0.3
    trials: Annotated[
        int,
        Bounds(10, 100_000, 10, "", slider=(100, 10_000)),
        Doc("Random pairs of associations that RANSAC tries."),
    ] = 5000
    hypotheses: Annotated[
        int,
        Bounds(1, 100, 1, "", slider=(1, 30)),
        Doc("Best motions by inliers whose overlap is checked densely."),
    ] = 12
    seed: Annotated[int, Doc("Of the random choices; the same seed gives the same answer.")] = 0

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)


def register(
    query: GradientMap,
    database: GradientMap,
    matches: Matches,
    params: RegistrationParams | None = None,
    progress: Progress = silent,
) -> Registration:
    """Register the query map to the database map, Algorithm 1.

    All trials run at once. The best motions by inliers are then compared densely: the one
    under which the slope fields agree best is returned. Acceptance comes after
    (`loop_closure.classify`), so that sweeping its thresholds costs nothing.

    Args:
        query: Map to be placed.
        database: Map it is placed on.
        matches: The set of associations A.
        params: Of RANSAC and the check.
        progress: Called once a motion checked; may raise Cancelled.

    Returns:
        The best motion; `T_database_query` is None where no two associations support one.
    """
    params = params or RegistrationParams()
    motions = _ransac(matches, params)
    checker = _DenseCheck(query, database)
    best = _nothing(len(matches))
    for k, motion in enumerate(motions):
        candidate = _refine(motion, matches, params.inlier_radius)
        if candidate is not None:
            T_database_query, inliers = candidate
            area, correlation = checker.compare(T_database_query)
            score = checker.score(area, correlation, int(inliers.sum()))
            if best.T_database_query is None or score > best.score:
                best = Registration(T_database_query, inliers, np.inf, area, correlation, score)
        progress((k + 1) / len(motions))
    if best.T_database_query is None:
        return best
    return Registration(
        best.T_database_query,
        best.inliers,
        checker.dissimilarity(best.T_database_query),
        best.overlap_area,
        best.correlation,
        best.score,
    )


def closure_score(patches: float, correlation: float, num_inliers: int) -> float:
    """How likely a registration is a loop closure: ``r² √N log(1 + n)``.

    Over N independent patches, the correlation of unrelated slopes scatters by 1/√N: a large
    overlap that agrees is harder to come by than a small one. Inliers are evidence of another
    kind. All three are pure numbers, so one threshold serves at any scale and steepness.

    Args:
        patches: Overlap in patches of 2π length_scale², over which terrain is alike: N.
        correlation: Of the slope fields over it, r; below zero it says nothing.
        num_inliers: n.
    """
    return max(correlation, 0.0) ** 2 * sqrt(patches) * log1p(num_inliers)


def _nothing(num_matches: int) -> Registration:
    return Registration(None, np.zeros(num_matches, bool), np.inf, 0.0, 0.0, 0.0)


# --- RANSAC -------------------------------------------------------------------------------


def _ransac(matches: Matches, params: RegistrationParams) -> list[SE2]:
    """Find the distinct motions with the most inliers, best first."""
    num = len(matches)
    if num < 2:
        return []
    first, second = _sample_pairs(num, params.trials, params.seed)
    query, database = matches.query_xy, matches.database_xy
    a, b = query[second] - query[first], database[second] - database[first]
    # Two associations of one rigid motion span the same length in both maps; and too short a
    # span says nothing about the turn.
    span_a, span_b = np.hypot(*a.T), np.hypot(*b.T)
    radius = params.inlier_radius
    rigid = (np.abs(span_a - span_b) <= 2 * radius) & (np.minimum(span_a, span_b) >= 2 * radius)
    a, b, first, second = a[rigid], b[rigid], first[rigid], second[rigid]
    if len(a) == 0:
        return []
    # GetSE2Transform of two pairs, in closed form.
    yaw = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.sum(a * b, axis=1))
    turned = _rotate(yaw, (query[first] + query[second]) / 2)
    offset = (database[first] + database[second]) / 2 - turned
    counts = _count_inliers(yaw, offset, matches, radius)
    order = np.argsort(-counts, kind="stable")
    return _distinct(yaw[order], offset[order], query.mean(axis=0), radius, params.hypotheses)


def _sample_pairs(
    num: int, trials: int, seed: int
) -> tuple[Int[NDArray[np.intp], "t"], Int[NDArray[np.intp], "t"]]:
    """SelectRandomAsso: pairs of different associations; all of them if they are few enough."""
    if num * (num - 1) // 2 <= trials:
        first, second = np.triu_indices(num, 1)
        return first, second
    generator = np.random.default_rng(seed)
    first = generator.integers(num, size=trials)
    second = generator.integers(num - 1, size=trials)
    return first, second + (second >= first)


def _rotate(yaw: Float[Array, "t"], points: Float[Array, "t 2"]) -> Float[Array, "t 2"]:
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = points.T
    return np.column_stack([c * x - s * y, s * x + c * y])


def _count_inliers(
    yaw: Float[Array, "t"], offset: Float[Array, "t 2"], matches: Matches, radius: float
) -> Int[NDArray[np.intp], "t"]:
    """GetInliers for all trials; associations that share a position may count twice here."""
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x, y = matches.query_xy.T
    error_x = c * x - s * y + offset[:, :1] - matches.database_xy[:, 0]
    error_y = s * x + c * y + offset[:, 1:] - matches.database_xy[:, 1]
    return np.count_nonzero(error_x**2 + error_y**2 <= radius**2, axis=1)


def _distinct(
    yaw: Float[Array, "t"],
    offset: Float[Array, "t 2"],
    centre: Float[Array, "2"],
    radius: float,
    wanted: int,
) -> list[SE2]:
    """Take the first motions that differ: by where they put the centre, or by their turn."""
    centres = _rotate(yaw, np.broadcast_to(centre, offset.shape)) + offset
    left = np.ones(len(yaw), bool)
    motions: list[SE2] = []
    while len(motions) < wanted and left.any():
        k = int(np.argmax(left))
        motions.append(SE2(float(offset[k, 0]), float(offset[k, 1]), float(yaw[k])))
        near = np.hypot(*(centres - centres[k]).T) <= 2 * radius
        turn = np.abs(np.angle(np.exp(1j * (yaw - yaw[k])))) <= 0.1
        left &= ~(near & turn)
    return motions


def _refine(motion: SE2, matches: Matches, radius: float) -> tuple[SE2, BoolArray] | None:
    """Fit the motion to its inliers, twice over; None if fewer than two are left."""
    for _ in range(REFITS):
        inliers = _one_to_one(motion, matches, radius)
        if inliers.sum() < 2:
            return None
        motion = fit_se2(matches.query_xy[inliers], matches.database_xy[inliers])
    return motion, _one_to_one(motion, matches, radius)


def _one_to_one(motion: SE2, matches: Matches, radius: float) -> Bool[BoolArray, "m"]:
    """Inliers of which no two share a keypoint position: of these, the closest counts."""
    errors = np.hypot(*(motion.apply(matches.query_xy) - matches.database_xy).T)
    inliers = np.zeros(len(matches), bool)
    taken_query: set[tuple[float, float]] = set()
    taken_database: set[tuple[float, float]] = set()
    for k in np.argsort(errors, kind="stable"):
        if errors[k] > radius:
            break
        in_query = (float(matches.query_xy[k, 0]), float(matches.query_xy[k, 1]))
        in_database = (float(matches.database_xy[k, 0]), float(matches.database_xy[k, 1]))
        if in_query not in taken_query and in_database not in taken_database:
            taken_query.add(in_query)
            taken_database.add(in_database)
            inliers[k] = True
    return inliers


# --- dense check --------------------------------------------------------------------------


class _DenseCheck:
    """Compares two maps under a motion, on thinned grids: slopes are smooth over many cells."""

    def __init__(self, query: GradientMap, database: GradientMap) -> None:
        stride = _stride(database)
        thin = (slice(None, None, stride), slice(None, None, stride))
        trusted = database.trusted(MAX_STD_RATIO)[thin]
        y, x = np.meshgrid(database.grid.y[thin[0]], database.grid.x[thin[1]], indexing="ij")
        self._positions = np.column_stack([x[trusted], y[trusted]])
        self._slope = database.slope[thin][trusted]
        self._variance = database.variance[thin][trusted]
        self._cell_area = (stride * database.grid.resolution) ** 2
        self._map_cells = stride**2
        self._patch_area = 2 * np.pi * database.length_scale**2

        stride = _stride(query)
        thin = (slice(None, None, stride), slice(None, None, stride))
        # One image of four channels: one remapping a motion.
        self._query_image = np.dstack(
            [query.slope[thin], query.variance[thin], query.trusted(MAX_STD_RATIO)[thin]]
        ).astype(np.float32)
        self._query_grid = Grid(
            query.grid.origin, stride * query.grid.resolution, self._query_image.shape[:2]
        )

    def _overlap(
        self, T_database_query: SE2
    ) -> tuple[BoolArray, Float[Array, "common 2"], Float[Array, "common"]]:
        """Which cells both maps know; the query's slope there (turned) and its variance."""
        there = T_database_query.inverse().apply(self._positions)
        pixels = self._query_grid.to_pixel(there).astype(np.float32)
        sampled = (
            cv2.remap(
                self._query_image,
                pixels[:, :1],
                pixels[:, 1:],
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=(0, 0, 0, 0),
            )
            .reshape(-1, 4)
            .astype(np.float64)
        )
        common = sampled[:, 3] > 0.999  # all four neighbours are trusted
        return common, T_database_query.rotate(sampled[common, :2]), sampled[common, 2]

    def compare(self, T_database_query: SE2) -> tuple[float, float]:
        """Overlap area [m²], and correlation of the slope vectors over it."""
        common, query, _ = self._overlap(T_database_query)
        area = len(query) * self._cell_area
        if len(query) < 2:
            return area, 0.0
        database = self._slope[common]
        # As matrix products: NumPy's own means of long arrays of pairs are ten times slower.
        share = np.full(len(query), 1 / len(query))
        query, database = query - share @ query, database - share @ database
        energy = float(np.sqrt(np.vdot(query, query) * np.vdot(database, database)))
        return area, float(np.vdot(query, database)) / energy if energy > 0 else 0.0

    def score(self, area: float, correlation: float, num_inliers: int) -> float:
        """Score a motion by its overlap counted in independent patches."""
        return closure_score(area / self._patch_area, correlation, num_inliers)

    def dissimilarity(self, T_database_query: SE2) -> float:
        """ComputeSSDMetric, the paper's h: Σ (I_g^q - I_g^d)² / (I_v^q I_v^d) over the overlap.

        Summed over the thinned cells, each for the map's cells that it stands for.
        """
        common, query, variance = self._overlap(T_database_query)
        difference = np.hypot(*query.T) - np.hypot(*self._slope[common].T)
        return float(self._map_cells * np.sum(difference**2 / (variance * self._variance[common])))


def _stride(gradient_map: GradientMap) -> int:
    return max(1, round(np.sqrt(gradient_map.grid.num_cells / CHECKED_CELLS)))
