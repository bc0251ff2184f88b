"""RANSAC for motions in space over associations of 3D keypoints (the paper's Sec. VII-C)."""

from math import log

import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import Array, NDArray

CONFIDENCE = 0.99
"""RANSAC stops when it has drawn a sample without outliers with this probability (the paper's)."""
MAX_TRIALS = 50_000
BATCH = 5_000
SIMILAR_EDGES = 0.9
"""Two triangles are similar if the shorter of each two sides has at least this share of the longer
one, as in Open3D's examples."""
REFITS = 3


def ransac_se3(
    query: Float[Array, "m 3"],
    database: Float[Array, "m 3"],
    radius: float,
    seed: int,
) -> tuple[Float[Array, "4 4"], Bool[NDArray[np.bool_], "m"]] | None:
    """Find the rigid motion with the most inliers.

    Args:
        query: Keypoints in the query's frame (m, 3) [m].
        database: The associated keypoints in the database's frame (m, 3) [m].
        radius: An association is an inlier if the motion brings its keypoints within this
            distance of each other [m].
        seed: Seed of the random triples.

    Returns:
        The motion from the query's frame to the database's (4, 4), fitted to its inliers, and
        which associations these are (m,). None if no motion has three inliers.
    """
    num = len(query)
    if num < 3:
        return None
    rng = np.random.default_rng(seed)
    best, most = None, 2
    needed, tried = float(MAX_TRIALS), 0
    while tried < needed:
        tried += BATCH
        triples = _similar_triples(rng.integers(num, size=(BATCH, 3)), query, database)
        if len(triples) == 0:
            continue
        motions = fit_rigid(query[triples], database[triples])
        counts = np.count_nonzero(_errors(motions, query, database) <= radius**2, axis=1)
        k = int(np.argmax(counts))
        if counts[k] > most:
            best, most = motions[k], int(counts[k])
            good_sample = (most / num) ** 3
            needed = min(MAX_TRIALS, log(1 - CONFIDENCE) / log(max(1 - good_sample, 1e-12)))
    return None if best is None else _refitted(best, query, database, radius)


def _similar_triples(
    triples: NDArray[np.int64], query: Float[Array, "m 3"], database: Float[Array, "m 3"]
) -> NDArray[np.int64]:
    """Keep the triples that form similar triangles in both clouds."""
    similar = np.ones(len(triples), bool)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        first, second = triples[:, a], triples[:, b]
        in_query = np.linalg.norm(query[first] - query[second], axis=1)
        in_database = np.linalg.norm(database[first] - database[second], axis=1)
        shorter, longer = np.minimum(in_query, in_database), np.maximum(in_query, in_database)
        similar &= (shorter >= SIMILAR_EDGES * longer) & (shorter > 0)
    return triples[similar]


def fit_rigid(
    query: Float[Array, "t k 3"], database: Float[Array, "t k 3"]
) -> Float[Array, "t 4 4"]:
    """Fit t rigid motions to k associations each by least squares, with the SVD of Arun 1987.

    Args:
        query: Keypoints in the query's frame (t, k, 3) [m].
        database: The associated keypoints in the database's frame (t, k, 3) [m].

    Returns:
        The motions (t, 4, 4).
    """
    middle_query, middle_database = query.mean(axis=1), database.mean(axis=1)
    covariance = np.einsum(
        "tki,tkj->tij", query - middle_query[:, None], database - middle_database[:, None]
    )
    u, _, vt = np.linalg.svd(covariance)
    v, ut = vt.transpose(0, 2, 1).copy(), u.transpose(0, 2, 1)
    v[:, :, 2] *= np.sign(np.linalg.det(v @ ut))[:, None]  # a rotation, not a reflection
    motions = np.broadcast_to(np.eye(4), (len(query), 4, 4)).copy()
    motions[:, :3, :3] = v @ ut
    motions[:, :3, 3] = middle_database - np.einsum("tij,tj->ti", v @ ut, middle_query)
    return motions


def _errors(
    motions: Float[Array, "t 4 4"], query: Float[Array, "m 3"], database: Float[Array, "m 3"]
) -> Float[Array, "t m"]:
    """Compute the squared distances between associated keypoints under each motion [m²]."""
    moved = np.einsum("tij,mj->tmi", motions[:, :3, :3], query) + motions[:, None, :3, 3]
    return np.sum((moved - database) ** 2, axis=2)


def _refitted(
    motion: Float[Array, "4 4"],
    query: Float[Array, "m 3"],
    database: Float[Array, "m 3"],
    radius: float,
) -> tuple[Float[Array, "4 4"], Bool[NDArray[np.bool_], "m"]] | None:
    inliers = np.zeros(len(query), bool)
    for _ in range(REFITS):
        inliers = _errors(motion[None], query, database)[0] <= radius**2
        if np.sum(inliers) < 3:
            return None
        motion = fit_rigid(query[inliers][None], database[inliers][None])[0]
    return motion, inliers
