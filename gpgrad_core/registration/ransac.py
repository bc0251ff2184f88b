"""Algorithm 1's RANSAC: motions of the plane that many associations support."""

from math import cos

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import NDArray
from gpgrad_core.registration.params import RegistrationParams
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Array, Matches

BoolArray = NDArray[np.bool_]

TRIALS_AT_ONCE = 256
"""Number of motions whose errors are computed together; they fit into a processor's cache."""
SAME_TURN = 0.1
"""Motions whose yaw differs by less than this are the same candidate [rad]."""


def find_motions(matches: Matches, params: RegistrationParams, radius: float) -> list[SE2]:
    """Find the distinct motions with the most inliers: the RANSAC of Algorithm 1.

    Args:
        matches: The associations A.
        params: Number of trials, number of motions wanted, and seed.
        radius: Largest distance between the keypoints of an inlier [m].

    Returns:
        Up to ``params.hypotheses`` motions ``T_database_query``, the one with the most inliers
        first.
    """
    num = len(matches)
    if num < 2:
        return []
    first, second = _sample_pairs(num, params.trials, params.seed)
    query, database = matches.query_xy, matches.database_xy
    a, b = query[second] - query[first], database[second] - database[first]
    # Two associations of one rigid motion have the same distance in both maps. Two that are too
    # close to each other say nothing about the yaw.
    span_a, span_b = np.hypot(*a.T), np.hypot(*b.T)
    rigid = (np.abs(span_a - span_b) <= 2 * radius) & (np.minimum(span_a, span_b) >= 2 * radius)
    a, b, first, second = a[rigid], b[rigid], first[rigid], second[rigid]
    if len(a) == 0:
        return []
    # GetSE2Transform of each two associations, in closed form.
    yaw = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.sum(a * b, axis=1))
    turned = _rotate(yaw, (query[first] + query[second]) / 2)
    offset = (database[first] + database[second]) / 2 - turned
    # Where each motion moves the middle of the query's keypoints.
    middle = query.mean(axis=0)
    placed = _rotate(yaw, np.broadcast_to(middle, offset.shape)) + offset
    counts = _count_inliers(yaw, placed, query - middle, database, radius)
    order = np.argsort(-counts, kind="stable")
    return _distinct(yaw[order], offset[order], placed[order], radius, params.hypotheses)


def _sample_pairs(
    num: int, trials: int, seed: int
) -> tuple[Int[NDArray[np.intp], "t"], Int[NDArray[np.intp], "t"]]:
    """SelectRandomAsso: draw pairs of different associations; take all if they are few enough."""
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
    yaw: Float[Array, "t"],
    placed: Float[Array, "t 2"],
    query: Float[Array, "m 2"],
    database: Float[Array, "m 2"],
    radius: float,
) -> Int[NDArray[np.intp], "t"]:
    """GetInliers for all trials; associations that share a position may count twice here.

    The squared error of association (q, d) under rotation R and offset t is

        |Rq + t - d|² = |q|² + |d|² + |t|² + 2 Rᵀt·q - 2 t·d - 2 (q·d cos yaw + q×d sin yaw)

    Each term is a product of a number that depends on the motion and one that depends on the
    association, so one matrix product gives all errors.

    Args:
        yaw: Yaw of each motion (t,) [rad].
        placed: Where each motion moves the middle of the query's keypoints (t, 2) [m].
        query: Keypoints relative to that middle (m, 2) [m].
        database: The associated keypoints (m, 2) [m].
        radius: Largest distance between the keypoints of an inlier [m].

    Returns:
        The number of inliers of each motion (t,).
    """
    # Relative to its middle no digits are lost, however far the frame's origin lies.
    middle = database.mean(axis=0)
    database, offset = database - middle, placed - middle
    (qx, qy), (dx, dy) = query.T, database.T
    lengths = np.sum(query**2, axis=1) + np.sum(database**2, axis=1)
    ones = np.ones(len(query))
    of_match = np.stack([lengths, ones, qx, qy, dx, dy, qx * dx + qy * dy, qx * dy - qy * dx])
    back_x, back_y = _rotate(-yaw, offset).T
    tx, ty = offset.T
    alone = [np.ones(len(yaw)), tx**2 + ty**2]
    with_query, with_database = [2 * back_x, 2 * back_y], [-2 * tx, -2 * ty]
    with_both = [-2 * np.cos(yaw), -2 * np.sin(yaw)]
    of_trial = np.column_stack([*alone, *with_query, *with_database, *with_both])
    counts = np.empty(len(yaw), np.intp)
    for first in range(0, len(yaw), TRIALS_AT_ONCE):
        some = slice(first, first + TRIALS_AT_ONCE)
        inside = of_trial[some] @ of_match <= radius**2
        counts[some] = inside.astype(np.float32) @ ones.astype(np.float32)
    return counts


def _distinct(
    yaw: Float[Array, "t"],
    offset: Float[Array, "t 2"],
    placed: Float[Array, "t 2"],
    radius: float,
    wanted: int,
) -> list[SE2]:
    """Take the first motions that differ in where they move the middle, or in their yaw."""
    x, y = placed.T
    c, s = np.cos(yaw), np.sin(yaw)
    left = np.arange(len(yaw))
    motions: list[SE2] = []
    while len(motions) < wanted and len(left):
        k = int(left[0])
        motions.append(SE2(float(offset[k, 0]), float(offset[k, 1]), float(yaw[k])))
        far = np.hypot(x[left] - x[k], y[left] - y[k]) > 2 * radius
        turned = c[left] * c[k] + s[left] * s[k] < cos(SAME_TURN)
        left = left[far | turned]
    return motions


def one_to_one(motion: SE2, matches: Matches, radius: float) -> Bool[BoolArray, "m"]:
    """Find the inliers of a motion, so that no two share a keypoint.

    Of inliers that share a keypoint's position, the one with the smallest error counts.

    Args:
        motion: ``T_database_query``.
        matches: The associations.
        radius: Largest distance between the keypoints of an inlier [m].
    """
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
