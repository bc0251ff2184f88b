"""Algorithm 1, and what gpgrad adds to it: more candidate motions, alignment, one score."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter

import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.registration.align import Alignment, Approached, align, approach, place
from gpgrad_core.registration.candidates import find_motions, one_to_one, search_motions
from gpgrad_core.registration.params import RegistrationParams
from gpgrad_core.registration.score import (
    INLIER_WEIGHT,
    DenseCheck,
    closure_score,
    rough_evidence,
    shares_of_evidence,
    weigh,
)
from gpgrad_core.registration.surface import Prepared, Surface, prepare
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.se2 import SE2, turned_by
from gpgrad_core.types import Agreement, GradientMap, Matches, Registration

SIFTED_CELLS, SIFTED_ITERATIONS = 250, 4
"""Number of cells and of steps with which all candidates are roughly aligned."""
LEAST_HOPE, CLEAR = 2.0, 20.0
"""A pair has no hope if its best candidate, roughly weighed, has less evidence than the first,
though equal heights would give as much as the second: flat or noisy ground says little even where
it is the same. On fifteen sets (five grounds; whole, sparse and noisy) 957 of 959 right motions
that score 3 have more than 2. Without the second, average precision on noisy clouds falls from
1.000 to .977 on apollo15 and to .965 on hillside (tests/long/quality/test_hard_ground.py). Of 0,
12, 16 and 20, 20 is best or as good as 16, whichever ground is left out; more was not tried."""
TRIED = (10, 3)
"""Number of the best candidates that are then aligned more exactly, with hope and without. On four
sparse and noisy datasets eight with hope lose one or two right motions in 180, and eighteen find no
more than ten."""
TRIED_CELLS, TRIED_ITERATIONS = 600, 5
"""Number of cells and of steps with which these are aligned."""
SCORED = (6, 1)
"""Number of these that are then scored, with hope before and after that, and without. In the mean
of four draws of noisy hillside, six instead of four raise average precision from .990 to .998, and
lower recall at full precision from .97 to .94; on other ground they change little. Without hope,
two instead of one accept no other motion on fifteen sets."""
REFINED_CELLS = 3000
"""Number of cells with which a motion that a person has set is aligned."""
LEAST_PLACED = 0.75
"""Score from which motions are placed exactly, which takes a third of a pair's time. On fifteen
sets (whole, thinned and noisy) right motions that slid as they were aligned stay unseen with 1, and
wrong ones are raised with .7. Whichever ground is left out, nothing between .5 and 1 is better."""
CLEARLY_BEST = 2.0
"""Score from which the best motion alone is placed. Below it the next one is placed too, unless it
has less than half of the score, because submaps that bend can let the right motion slide as far as
a scale of comparison."""


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
    its thresholds costs nothing.

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


def search_candidates(query: Prepared, database: Prepared, wanted: int) -> tuple[SE2, ...]:
    """Find up to so many candidate motions that need no keypoints; see `search_motions`."""
    return tuple(search_motions(query.smooth, database.smooth, wanted))


def register_prepared(
    query: Prepared,
    database: Prepared,
    matches: Matches,
    searched: Sequence[SE2],
    params: RegistrationParams,
    progress: Progress = silent,
) -> Registration:
    """Do the same as `register` with maps that are already prepared.

    Args:
        query: The map to be placed.
        database: The map on which it is placed.
        matches: The set of associations A.
        searched: The motions of `search_candidates`, which depend on neither the associations nor
            the inlier radius.
        params: Parameters of RANSAC.
        progress: Called with the fraction done; may raise Cancelled.
    """
    surfaces = query.smooth, database.smooth
    if not all(surface.trusted.any() for surface in surfaces):
        return _nothing(len(matches), progress, nothing_trusted=True)
    scale = database.smooth.scale
    starts = [*find_motions(matches, params, params.radius(scale)), *searched]
    progress(0.3)
    if not starts:
        return _nothing(len(matches), progress)
    sifted = approach(*surfaces, starts, num_cells=SIFTED_CELLS, iterations=SIFTED_ITERATIONS)
    sides = *surfaces, matches, params
    likely, hopeful = _most_likely(sifted, *sides)
    promising = [sifted.motion(k) for k in likely[: TRIED[not hopeful]]]
    tried = approach(*surfaces, promising, num_cells=TRIED_CELLS, iterations=TRIED_ITERATIONS)
    progress(0.6)
    likely, still_hopeful = _most_likely(tried, *sides)
    candidates = [
        _judge(tried.motion(k), partial(tried.alignment, k), query, database, matches, params)
        for k in likely[: SCORED[not (hopeful and still_hopeful)]]
    ]
    progress(1.0)
    return _finish(query, database, matches, candidates, params)


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
    params, sides = params or RegistrationParams(), (prepare(query), prepare(database))
    surfaces = sides[0].smooth, sides[1].smooth
    tried = align(*surfaces, start, num_cells=REFINED_CELLS, iterations=TRIED_ITERATIONS)
    only = _judge(tried.motion, lambda: tried, *sides, matches, params)
    return _finish(*sides, matches, [only], params)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A motion that was judged, with what the registration says of it."""

    motion: SE2
    alignment: Callable[[], Alignment]
    inliers: Bool[NDArray[np.bool_], "m"]
    score: float
    agreement: Agreement | None
    evidence: tuple[float, ...]


def _judge(
    motion: SE2,
    alignment: Callable[[], Alignment],
    query: Prepared,
    database: Prepared,
    matches: Matches,
    params: RegistrationParams,
) -> _Candidate:
    """Count the inliers of a motion, and weigh how well the ground agrees."""
    inliers = one_to_one(motion, matches, params.radius(database.smooth.scale))
    evidence, num_inliers = weigh(query.smooth, database.smooth, motion), int(inliers.sum())
    return _Candidate(
        motion,
        alignment,
        inliers,
        closure_score(evidence, num_inliers),
        evidence.agreement,
        () if evidence.agreement is None else shares_of_evidence(evidence, num_inliers),
    )


def _finish(
    query: Prepared,
    database: Prepared,
    matches: Matches,
    candidates: Sequence[_Candidate],
    params: RegistrationParams,
) -> Registration:
    """Align the best motions to a few centimetres on the sharp surfaces, if there is hope.

    A motion has the higher of its scores before and after that. The best motion is returned.
    """
    roughly = sorted(candidates, key=attrgetter("score"), reverse=True)
    best = scored = roughly[0]
    if best.score >= LEAST_PLACED:
        outcomes: list[tuple[_Candidate, _Candidate]] = []
        least = best.score / 2 if best.score < CLEARLY_BEST else best.score
        for rough in (each for each in roughly[:2] if each.score >= least):
            placed = place(query.sharp, database.sharp, rough.motion)
            fine = _judge(
                placed.motion, lambda placed=placed: placed, query, database, matches, params
            )
            outcomes.append((fine, max(fine, rough, key=attrgetter("score"))))
        best, scored = max(outcomes, key=lambda outcome: outcome[1].score)
    aligned = best.alignment()
    check = DenseCheck(query.thin, database.thin, best.motion)
    area, correlation = check.compare()
    dissimilarity, num_cells = check.dissimilarity()
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
        scale=database.smooth.scale,
        agreement=best.agreement,
        evidence=scored.evidence,
        mean_dissimilarity=dissimilarity / num_cells if num_cells else np.inf,
        overlap_middle=aligned.middle if aligned.held else None,
    )


def _most_likely(
    aligned: Approached,
    query: Surface,
    database: Surface,
    matches: Matches,
    params: RegistrationParams,
) -> tuple[list[int], bool]:
    """Sort distinct motions by their likeness, and by a rough score that weighs all in one pass.

    Correlated terrain leads from far off, and small differences of heights tell similar ground. So
    the first by either comes first.

    Args:
        aligned: The motions.
        query: The map to be placed.
        database: The map on which it is placed.
        matches: The associations.
        params: Gives the inlier radius.

    Returns:
        The motions, and whether the pair has hope; see `LEAST_HOPE`.
    """
    distinct = _distinct(aligned, query.disc[0], database.scale)
    motions = aligned.motions[distinct]
    c, s = np.cos(motions[:, 2:]), np.sin(motions[:, 2:])
    x, y = matches.query_xy.T
    off_x = c * x - s * y + motions[:, :1] - matches.database_xy[:, 0]
    off_y = s * x + c * y + motions[:, 1:2] - matches.database_xy[:, 1]
    near = np.hypot(off_x, off_y) <= params.radius(database.scale)
    rough, could_be = rough_evidence(query, database, motions, TRIED_CELLS)
    rough += INLIER_WEIGHT * np.log1p(np.count_nonzero(near, axis=1))
    by_rough, by_likeness = np.empty(len(distinct), int), np.arange(len(distinct))
    by_rough[np.argsort(-rough, kind="stable")] = by_likeness
    order = np.lexsort((by_rough, np.minimum(by_rough, by_likeness)))
    hopeful = bool(rough.max() >= LEAST_HOPE or could_be.max() < CLEAR)
    return [distinct[k] for k in order], hopeful


def _nothing(
    num_matches: int, progress: Progress, *, nothing_trusted: bool = False
) -> Registration:
    progress(1.0)
    none = np.zeros(num_matches, bool)
    return Registration(None, none, np.inf, 0.0, 0.0, 0.0, nothing_trusted=nothing_trusted)


def _distinct(tried: Approached, middle: Float[Array, "2"], scale: float) -> list[int]:
    """Sort motions by their likeness, and drop duplicates: many starts end at the same motion.

    They are compared by where they place the query's middle (2,) [m].
    """
    there = tried.motions[:, :2] + turned_by(middle, tried.motions[:, 2])
    placed = np.column_stack([there, tried.motions[:, 2]])
    x, y, yaw = np.moveaxis(placed[:, None] - placed, 2, 0)
    near = ((np.hypot(x, y) < 0.5 * scale) & (np.abs(np.sin(yaw / 2)) < 0.02)).tolist()
    chosen: list[int] = []
    for k in np.argsort(-tried.likeness, kind="stable").tolist():
        if not any(near[k][j] for j in chosen):
            chosen.append(k)
    return chosen
