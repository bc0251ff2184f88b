"""Algorithm 1, and what gpgrad adds to it: more candidate motions, alignment, one score."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.registration.alignment import Alignments, align
from gpgrad_core.registration.dense_check import DenseCheck, ThinMap, thin_out
from gpgrad_core.registration.evidence import closure_score, shares_of_evidence, weigh
from gpgrad_core.registration.params import RegistrationParams
from gpgrad_core.registration.placement import Sharp, place, sharpen
from gpgrad_core.registration.ransac import find_motions, one_to_one
from gpgrad_core.registration.relief import Relief, make_relief
from gpgrad_core.registration.search import search_motions
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.se2 import SE2
from gpgrad_core.types import (
    MAX_STD_RATIO,
    Agreement,
    Array,
    GradientMap,
    Matches,
    Registration,
)

SIFTED_CELLS, SIFTED_ITERATIONS = 250, 4
"""Number of cells and of steps with which all candidates are roughly aligned."""
TRIED = 12
"""Number of the best candidates that are then scored. With eight, the right motion of pairs that
hardly overlap was sometimes lost; eighteen found no more than twelve."""
TRIED_CELLS, TRIED_ITERATIONS = 600, 5
"""Number of cells and of steps with which these are aligned."""
REFINED_CELLS = 3000
"""Number of cells with which a motion that a person has set is aligned."""

LEAST_PLACED = 0.7
"""Score from which a motion is placed exactly, which takes a third of a pair's time. On five sets,
sparse and noisy ones among them, placing raised no score below 1 to 3, and no ranking changed."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """What the registration computes of one map, once for all pairs that it is in.

    Attributes:
        relief: The elevation, smoothed over the scale of comparison.
        sharp: The elevation without smoothing, and its long waves, for the final alignment.
        thin: The cells for the dense check.
    """

    relief: Relief
    sharp: Sharp
    thin: ThinMap


def prepare(gradient_map: GradientMap, max_std_ratio: float = MAX_STD_RATIO) -> Prepared:
    """Prepare a map for registration.

    Args:
        gradient_map: The map.
        max_std_ratio: Threshold of the variance mask; only trusted cells are compared.
    """
    relief = make_relief(gradient_map, max_std_ratio)
    return Prepared(
        relief,
        sharpen(gradient_map, max_std_ratio),
        thin_out(gradient_map, max_std_ratio),
    )


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
    returned. AcceptTransformation comes afterwards (`loop_closure.classify`), so that moving its
    thresholds costs nothing.

    Args:
        query: The map to be placed.
        database: The map on which it is placed.
        matches: The set of associations A.
        params: Parameters of RANSAC and of the search.
        progress: Called with the fraction done; may raise Cancelled.

    Returns:
        The best motion. ``T_database_query`` is None if no motion was found.
    """
    return register_prepared(prepare(query), prepare(database), matches, params, progress)


def register_prepared(
    query: Prepared,
    database: Prepared,
    matches: Matches,
    params: RegistrationParams | None = None,
    progress: Progress = silent,
    found: Sequence[SE2] | None = None,
) -> Registration:
    """Do the same as `register` with maps that are already prepared.

    Args:
        query: The map to be placed.
        database: The map on which it is placed.
        matches: The set of associations A.
        params: Parameters of RANSAC and of the search.
        progress: Called with the fraction done; may raise Cancelled.
        found: What `search_motions` finds for the two reliefs, if that is known: it depends on
            neither the associations nor the inlier radius.
    """
    params = params or RegistrationParams()
    maps = query.relief, database.relief
    if not all(relief.trusted.any() for relief in maps):
        return _nothing(len(matches), progress, nothing_trusted=True)
    starts = find_motions(matches, params, params.radius(maps[1].scale))
    starts += search_motions(*maps, params.searched) if found is None else found
    progress(0.3)
    best: _Candidate | None = None
    if starts:
        sifted = align(*maps, starts, num_cells=SIFTED_CELLS, iterations=SIFTED_ITERATIONS)
        promising = [sifted.motion(k) for k in _distinct(sifted, maps[1].scale)[:TRIED]]
        tried = align(*maps, promising, num_cells=TRIED_CELLS, iterations=TRIED_ITERATIONS)
        progress(0.6)
        chosen = _distinct(tried, maps[1].scale)
        for k, row in enumerate(chosen):
            candidate = _judge(tried, row, maps, matches, params)
            if best is None or candidate.score > best.score:
                best = candidate
            progress(0.6 + 0.4 * (k + 1) / len(chosen))
    if best is None:
        return _nothing(len(matches), progress)
    return _finish(query, database, matches, best, params)


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
    params = params or RegistrationParams()
    of_query, of_database = prepare(query), prepare(database)
    maps = of_query.relief, of_database.relief
    tried = align(*maps, [start], num_cells=REFINED_CELLS, iterations=TRIED_ITERATIONS)
    rough = _judge(tried, 0, maps, matches, params)
    return _finish(of_query, of_database, matches, rough, params)


def _finish(
    query: Prepared,
    database: Prepared,
    matches: Matches,
    rough: "_Candidate",
    params: RegistrationParams,
) -> Registration:
    """Align the best motion to a few centimetres on the unsmoothed maps, if there is hope."""
    maps, best = (query.relief, database.relief), rough
    if rough.score >= LEAST_PLACED:
        placed = place(query.sharp, database.sharp, rough.motion)
        best = _judge(placed, 0, maps, matches, params)
    check = DenseCheck(query.thin, database.thin)
    area, correlation = check.compare(best.motion)
    dissimilarity, num_cells = check.dissimilarity(best.motion)
    return Registration(
        best.motion,
        best.inliers,
        dissimilarity,
        area,
        correlation,
        max(rough.score, best.score),
        z_offset=best.z_offset,
        covariance=best.covariance,
        z_std=best.z_std,
        scale=maps[1].scale,
        agreement=best.agreement,
        evidence=(rough if rough.score > best.score else best).evidence,
        mean_dissimilarity=dissimilarity / num_cells if num_cells else np.inf,
    )


def _nothing(
    num_matches: int, progress: Progress, *, nothing_trusted: bool = False
) -> Registration:
    progress(1.0)
    none = np.zeros(num_matches, bool)
    return Registration(None, none, np.inf, 0.0, 0.0, 0.0, nothing_trusted=nothing_trusted)


@dataclass(frozen=True, eq=False)
class _Candidate:
    motion: SE2
    z_offset: float
    z_std: float | None
    covariance: Float[Array, "3 3"] | None
    inliers: Bool[NDArray[np.bool_], "m"]
    score: float
    agreement: Agreement | None
    evidence: tuple[float, ...]


def _judge(
    placed: Alignments,
    k: int,
    maps: tuple[Relief, Relief],
    matches: Matches,
    params: RegistrationParams,
) -> _Candidate:
    motion, held = placed.motion(k), bool(placed.held[k])
    inliers = one_to_one(motion, matches, params.radius(maps[1].scale))
    evidence, num_inliers = weigh(*maps, motion), int(inliers.sum())
    return _Candidate(
        motion,
        float(placed.z_offsets[k]) if held else 0.0,
        float(placed.z_stds[k]) if held else None,
        placed.covariances[k] if held else None,
        inliers,
        closure_score(evidence, num_inliers),
        evidence.agreement,
        () if evidence.agreement is None else shares_of_evidence(evidence, num_inliers),
    )


def _distinct(tried: Alignments, scale: float) -> list[int]:
    """Sort motions by their likeness, and drop duplicates: many starts end at the same motion."""
    x, y, yaw = np.moveaxis(tried.motions[:, None] - tried.motions, 2, 0)
    near = (np.hypot(x, y) < 0.5 * scale) & (np.abs(np.sin(yaw / 2)) < 0.02)
    chosen: list[int] = []
    for k in np.argsort(-tried.likeness, kind="stable"):
        if not near[k, chosen].any():
            chosen.append(int(k))
    return chosen
