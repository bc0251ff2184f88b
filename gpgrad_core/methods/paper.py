"""The paper to the letter: its map, its keypoints, and its Algorithm 1 with n and h.

If the paper leaves a number or a step open, `paper_params` says what is used. The pipeline differs
from the paper by its detector, its noise, its one-to-one inliers and its dense check.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Int

from gpgrad_core.arrays import NDArray
from gpgrad_core.features import DetectorParams
from gpgrad_core.features.interpolation import interpolate
from gpgrad_core.gradient_map import MapParams
from gpgrad_core.matching import MatchParams, match_features
from gpgrad_core.pipeline import PipelineParams, extract_kept, infer_map
from gpgrad_core.pipeline.all_pairs import StagedDetector
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.se2 import SE2, fit_se2
from gpgrad_core.types import Features, GradientMap, Matches, Registration, Submap

LENGTH_SCALE = 0.316
"""√0.1 m: Eq. (6) prints 2 l_k in place of the usual 2 l², and l_k is about 0.1 (Sec. VI-B)."""
MIN_INLIERS = 5
"""Smallest number of inliers of a loop closure; in the paper's Sec. VII-C all closures with five or
more inliers were right."""
RATIO = 0.8
"""Largest ratio of the nearest descriptor's distance to the second's. Without it, pairs without
overlap reach five inliers too."""
INLIER_RADIUS = 0.15
"""The paper's "2D distance threshold" [m], which has no number there: five pixels of its maps."""
ITERATIONS = 5000
"""Max Nb Iterations of Algorithm 1, for which the paper gives no number."""
MAX_DISSIMILARITY = np.inf
"""Threshold on h in AcceptTransformation; the paper found a threshold on n "the most effective"."""


def paper_params(params: PipelineParams) -> PipelineParams:
    """Replace all parameters but the seed and the noise by the paper's (Secs. V and VI-B).

    | what | paper | taken |
    |---|---|---|
    | points, resolution | 5000, 0.03 m/pixel | the same |
    | length-scale | l_k "around 0.1 m" in Eq. (6), unsquared, before fine-tuning | √0.1 m |
    | signal | the empirical variance | the same |
    | noise | "typical elevation accuracy" of the sensor | that of the parameters |
    | keypoints | SURF, masked by variance | the same, all of them; the default mask |
    | matching | brute force, L2 | the same, nearest of each other, with Lowe's ratio of 0.8 |
    | inliers | "2D distance threshold" | 0.15 m |
    | iterations | a maximum | 5000 |
    | acceptance | by h and n, later n alone, right from n = 5 | n of five |
    """
    return replace(
        params,
        map=MapParams(
            length_scale=LENGTH_SCALE,
            noise_std=params.map.guessed.noise_std,
            max_points=5000,
            resolution=0.03,
        ),
        features=replace(params.features, max_keypoints=20_000, detector=DetectorParams("surf")),
        matching=MatchParams(ratio=RATIO, mutual=True),
        registration=replace(params.registration, inlier_radius=INLIER_RADIUS, trials=ITERATIONS),
        closure=replace(params.closure, min_inliers=MIN_INLIERS, min_score=0.0),
    )


@dataclass(frozen=True, eq=False)
class PaperSubmap:
    """What the paper's comparison needs of one submap.

    Attributes:
        gradient_map: Its gradient map.
        features: Its keypoints.
    """

    gradient_map: GradientMap
    features: Features


@dataclass(frozen=True, eq=False)
class PaperDetector(StagedDetector):
    """The paper as a `LoopDetector`: the pipeline's maps and keypoints, and Algorithm 1 as printed.

    Attributes:
        params: The parameters from `paper_params`.
        memo: Keeps the results of each submap; it is empty at first in another process.
    """

    params: PipelineParams
    memo: Memo

    def infer(self, submap: Submap, progress: Progress = silent) -> GradientMap:
        """Make the map."""
        return infer_map(submap, self.params, self.memo, progress)

    def extract(self, made: GradientMap, progress: Progress = silent) -> PaperSubmap:
        """Extract the keypoints."""
        features = extract_kept(made, self.params, self.memo)
        progress(1.0)
        return PaperSubmap(made, features)

    def keypoints(self, extracted: PaperSubmap) -> Features:
        """Give the keypoints."""
        return extracted.features

    def compare(self, query: PaperSubmap, database: PaperSubmap) -> Registration:
        """Register the query to the database; the score is n."""
        matches = self.memo(match_features, query.features, database.features, self.params.matching)
        params = self.params.registration
        return self.memo(
            register_as_printed,
            query.gradient_map,
            database.gradient_map,
            matches,
            params.radius(None),
            params.trials,
            params.seed,
        )


def register_as_printed(
    query: GradientMap,
    database: GradientMap,
    matches: Matches,
    inlier_radius: float,
    iterations: int,
    seed: int,
) -> Registration:
    """Run Algorithm 1 line by line.

    Two things are computed differently, with the same result: the inliers of all iterations are
    counted at once, and the expensive h is computed only if the rest of the condition holds.

    Args:
        query: The query's map: I_g^q and I_v^q.
        database: The database's map: I_g^d and I_v^d.
        matches: The set of associations A.
        inlier_radius: Distance threshold of GetInliers [m].
        iterations: Max Nb Iterations.
        seed: Seed of SelectRandomAsso.

    Returns:
        The motion T, n as inliers and score, and h as dissimilarity. T is None if no iteration
        has two inliers.
    """
    best = Registration(None, np.zeros(len(matches), bool), np.inf, 0.0, 0.0, 0.0)
    if len(matches) < 2:
        return best
    pairs = _random_pairs(len(matches), iterations, seed)
    inliers_of_all = _inliers_of_all(pairs, matches, inlier_radius)
    counts = np.count_nonzero(inliers_of_all, axis=1)
    for inliers, count in zip(inliers_of_all, counts, strict=True):
        if count <= max(best.num_inliers, 1):
            continue
        # GetSE2Transform(A_i), the motion fitted to all inliers.
        motion = fit_se2(matches.query_xy[inliers], matches.database_xy[inliers])
        h, area = ssd_metric(query, database, motion)
        # AcceptTransformation by h; that by n comes afterwards, so that n can be varied.
        if h <= MAX_DISSIMILARITY:
            best = Registration(motion, inliers, h, area, 0.0, float(count))
    return best


def ssd_metric(
    query: GradientMap, database: GradientMap, T_database_query: SE2
) -> tuple[float, float]:
    """Compute the paper's metric h over all common cells (ComputeSSDMetric).

        h = Σ (I_g^q - I_g^d)² / (I_v^q I_v^d)    Le Gentil 2020, Sec. V

    Args:
        query: The query's map.
        database: The database's map.
        T_database_query: The motion.

    Returns:
        h, which is infinite if the maps do not overlap; and the area of the common cells [m²].
    """
    there = T_database_query.inverse().apply(database.grid.positions)
    pixels = query.grid.to_pixel(there)
    common = ((pixels >= 0) & (pixels <= np.array(query.grid.shape[::-1]) - 1)).all(axis=1)
    if not common.any():
        return np.inf, 0.0
    image = np.dstack([query.gradient, query.variance]).astype(np.float32)
    gradient, variance = interpolate(image, pixels[common][:, None])[:, 0].astype(np.float64).T
    difference = gradient - database.gradient.ravel()[common]
    h = np.sum(difference**2 / (variance * database.variance.ravel()[common]))
    return float(h), float(common.sum() * database.grid.resolution**2)


def _random_pairs(num: int, iterations: int, seed: int) -> Int[NDArray[np.intp], "t 2"]:
    """SelectRandomAsso: draw two different associations for each iteration."""
    generator = np.random.default_rng(seed)
    first = generator.integers(num, size=iterations)
    second = generator.integers(num - 1, size=iterations)
    return np.column_stack([first, second + (second >= first)])


def _inliers_of_all(
    pairs: Int[NDArray[np.intp], "t 2"], matches: Matches, radius: float
) -> Bool[NDArray[np.bool_], "t m"]:
    """Compute GetSE2Transform of each pair, in closed form, and GetInliers."""
    query, database = (xy[:, 0] + 1j * xy[:, 1] for xy in (matches.query_xy, matches.database_xy))
    spans = [np.diff(points[pairs])[:, 0] for points in (query, database)]
    turn = np.exp(1j * np.angle(spans[1] * np.conj(spans[0])))
    offset = database[pairs].mean(axis=1) - turn * query[pairs].mean(axis=1)
    errors = turn[:, None] * query + offset[:, None] - database
    return np.abs(errors) <= radius
