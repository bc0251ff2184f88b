"""Algorithm 1, and what gpgrad adds to it: more candidate motions, alignment, one score.

How the numbers were chosen is written in the guide (assets/guide/method.md, *Numbers of the
registration*).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter

import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import Array, Mask
from gpgrad_core.registration.align import Alignment, Alignments, align, align_all, align_fine
from gpgrad_core.registration.candidates import find_motions, one_to_one, search_motions
from gpgrad_core.registration.params import RegistrationParams
from gpgrad_core.registration.score import (
    INLIER_WEIGHT,
    check_dense,
    closure_score,
    rough_evidence,
    shares_of_evidence,
    weigh,
)
from gpgrad_core.registration.surface import Prepared, Surface, prepare
from gpgrad_core.run import Progress, silent
from gpgrad_core.se2 import SE2, turned_by
from gpgrad_core.types import Agreement, GradientMap, Matches, Registration

COARSE_CELLS, COARSE_ITERATIONS = 250, 4
"""Number of cells and of steps with which all candidates are aligned."""
ALIGNED_CELLS, ALIGNED_ITERATIONS = 600, 5
"""Number of cells and of steps with which the best of these are aligned again."""
NUM_ALIGNED, NUM_SCORED = 10, 6
"""Number of the best candidates that are aligned again, and of those that are then scored."""
MIN_FINE_SCORE = 0.75
"""Score from which motions are aligned finely."""
CLEARLY_BEST = 2.0
"""Score from which the best motion alone is aligned finely; below, the next one is too if it has at
least half of the score."""
REFINED_CELLS = 3000
"""Number of cells with which a motion that a person has set is aligned."""


def register(
    query: GradientMap,
    database: GradientMap,
    matches: Matches,
    params: RegistrationParams | None = None,
    progress: Progress = silent,
) -> Registration:
    """Register the query map to the database map (Algorithm 1).

    The candidates are RANSAC's best motions and the best motions of an exhaustive search, which
    needs no associations. They are aligned densely, and the one with the highest score is
    returned. AcceptTransformation comes afterwards (`detection.verdict.classify`), so that moving
    its thresholds costs nothing. `methods.paper` has the algorithm as it is printed.

    Args:
        query: The map to be placed.
        database: The map on which it is placed.
        matches: The set of associations A.
        params: Parameters of RANSAC and of the search.
        progress: Called with the fraction done; may raise Cancelled.

    Returns:
        The best motion. ``T_database_query`` is None if no motion was found.
    """
    params = params or RegistrationParams()
    sides = prepare(query), prepare(database)
    return register_prepared(
        *sides, matches, search_candidates(*sides, params.searched), params, progress
    )


def register_prepared(
    query: Prepared,
    database: Prepared,
    matches: Matches,
    searched: Sequence[SE2],
    params: RegistrationParams,
    progress: Progress = silent,
) -> Registration:
    """As `register`, with maps that are already prepared."""
    pair = _PreparedPair(query, database, matches, params)
    if not all(surface.trusted.any() for surface in pair.surfaces):
        return pair.without_motion(progress, nothing_trusted=True)
    # SelectRandomAsso, GetSE2Transform and GetInliers, until Max Nb Iterations: the motions with
    # the most inliers. gpgrad adds those of an exhaustive search.
    motions = [*find_motions(matches, params, pair.inlier_radius), *searched]
    progress(0.3)
    if not motions:
        return pair.without_motion(progress)
    # GetSE2Transform(A_i): the paper fits a motion to its inliers; here to the heights of the maps.
    coarse = align_all(
        *pair.surfaces, motions, num_cells=COARSE_CELLS, iterations=COARSE_ITERATIONS
    )
    motions = [coarse.motion(k) for k in pair.rank(coarse)[:NUM_ALIGNED]]
    aligned = align_all(
        *pair.surfaces, motions, num_cells=ALIGNED_CELLS, iterations=ALIGNED_ITERATIONS
    )
    progress(0.6)
    # |A_i|, and in the place of ComputeSSDMetric a score that is comparable between pairs.
    chosen = pair.rank(aligned)[:NUM_SCORED]
    candidates = pair.score(
        [aligned.motion(k) for k in chosen], [partial(aligned.alignment, k) for k in chosen]
    )
    progress(1.0)
    return pair.best_of(candidates)


def search_candidates(query: Prepared, database: Prepared, count: int) -> tuple[SE2, ...]:
    """Find up to so many candidate motions that need no keypoints; see `search_motions`."""
    return tuple(search_motions(query.smooth, database.smooth, count))


def refine(
    query: GradientMap,
    database: GradientMap,
    matches: Matches,
    start: SE2,
    params: RegistrationParams | None = None,
) -> Registration:
    """Register two maps from a motion that is nearly right, such as one that a person has set.

    Args:
        query: The map to be placed.
        database: The map on which it is placed.
        matches: Associations, of which the inliers are counted; there need not be any.
        start: ``T_database_query``, up to a few scales of comparison off.
        params: Gives the inlier radius.

    Returns:
        The motion near the start under which the ground agrees best, scored as by `register`.
        If the overlap is too small, the motion is `start` itself.
    """
    pair = _PreparedPair(prepare(query), prepare(database), matches, params or RegistrationParams())
    aligned = align(*pair.surfaces, start, num_cells=REFINED_CELLS, iterations=ALIGNED_ITERATIONS)
    return pair.best_of(pair.score([aligned.motion], [lambda: aligned]))


@dataclass(frozen=True, eq=False)
class _Candidate:
    motion: SE2
    alignment: Callable[[], Alignment]
    inliers: Bool[Mask, "m"]
    score: float
    agreement: Agreement | None
    evidence: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class _PreparedPair:
    query: Prepared
    database: Prepared
    matches: Matches
    params: RegistrationParams

    @property
    def surfaces(self) -> tuple[Surface, Surface]:
        return self.query.smooth, self.database.smooth

    @property
    def inlier_radius(self) -> float:
        return self.params.radius(self.database.smooth.scale)

    def without_motion(self, progress: Progress, *, nothing_trusted: bool = False) -> Registration:
        progress(1.0)
        none = np.zeros(len(self.matches), bool)
        return Registration(None, none, np.inf, 0.0, 0.0, 0.0, nothing_trusted=nothing_trusted)

    def rank(self, aligned: Alignments) -> list[int]:
        """Rank distinct motions; those that are first by likeness or by evidence come first."""
        query, database = self.surfaces
        distinct = _distinct(aligned, query.disc[0], database.scale)
        motions = aligned.motions[distinct]
        c, s = np.cos(motions[:, 2:]), np.sin(motions[:, 2:])
        x, y = self.matches.query_xy.T
        off_x = c * x - s * y + motions[:, :1] - self.matches.database_xy[:, 0]
        off_y = s * x + c * y + motions[:, 1:2] - self.matches.database_xy[:, 1]
        near = np.hypot(off_x, off_y) <= self.inlier_radius
        evidence = rough_evidence(query, database, motions, ALIGNED_CELLS)
        evidence += INLIER_WEIGHT * np.log1p(np.count_nonzero(near, axis=1))
        by_evidence, by_likeness = np.empty(len(distinct), int), np.arange(len(distinct))
        by_evidence[np.argsort(-evidence, kind="stable")] = by_likeness
        order = np.lexsort((by_evidence, np.minimum(by_evidence, by_likeness)))
        return [distinct[k] for k in order]

    def score(
        self, motions: Sequence[SE2], alignments: Sequence[Callable[[], Alignment]]
    ) -> list[_Candidate]:
        candidates: list[_Candidate] = []
        evidence = weigh(*self.surfaces, motions)
        for motion, alignment, one in zip(motions, alignments, evidence, strict=True):
            inliers = one_to_one(motion, self.matches, self.inlier_radius)
            count = int(inliers.sum())
            shares = () if one.agreement is None else shares_of_evidence(one, count)
            score = closure_score(one, count)
            candidates.append(_Candidate(motion, alignment, inliers, score, one.agreement, shares))
        return candidates

    def best_of(self, candidates: Sequence[_Candidate]) -> Registration:
        """Align the best motions finely if one could be right; each keeps its higher score."""
        ranked = sorted(candidates, key=attrgetter("score"), reverse=True)
        best = scored = ranked[0]
        if best.score >= MIN_FINE_SCORE:
            outcomes: list[tuple[_Candidate, _Candidate]] = []
            least = best.score / 2 if best.score < CLEARLY_BEST else best.score
            for coarse in (each for each in ranked[:2] if each.score >= least):
                fine = self._aligned_finely(coarse)
                outcomes.append((fine, max(fine, coarse, key=attrgetter("score"))))
            best, scored = max(outcomes, key=lambda outcome: outcome[1].score)
        aligned = best.alignment()
        # ComputeSSDMetric
        area, correlation, dissimilarity, num_cells = check_dense(
            self.query.thin, self.database.thin, best.motion
        )
        return Registration(
            best.motion,
            best.inliers,
            dissimilarity,
            area,
            correlation,
            scored.score,
            z_offset=aligned.z_offset if aligned.held else 0.0,
            covariance=aligned.covariance if aligned.held else None,
            z_std=aligned.z_std if aligned.held else None,
            scale=self.database.smooth.scale,
            agreement=best.agreement,
            evidence=scored.evidence,
            mean_dissimilarity=dissimilarity / num_cells if num_cells else np.inf,
            overlap_middle=aligned.middle if aligned.held else None,
        )

    def _aligned_finely(self, candidate: _Candidate) -> _Candidate:
        aligned = align_fine(self.query.sharp, self.database.sharp, candidate.motion)
        return self.score([aligned.motion], [lambda: aligned])[0]


def _distinct(aligned: Alignments, middle: Float[Array, "2"], scale: float) -> list[int]:
    """Sort motions by their likeness, and drop those that place the query's middle [m] alike."""
    there = aligned.motions[:, :2] + turned_by(middle, aligned.motions[:, 2])
    placed = np.column_stack([there, aligned.motions[:, 2]])
    x, y, yaw = np.moveaxis(placed[:, None] - placed, 2, 0)
    near = ((np.hypot(x, y) < 0.5 * scale) & (np.abs(np.sin(yaw / 2)) < 0.02)).tolist()
    chosen: list[int] = []
    for k in np.argsort(-aligned.likeness, kind="stable").tolist():
        if not any(near[k][j] for j in chosen):
            chosen.append(k)
    return chosen
