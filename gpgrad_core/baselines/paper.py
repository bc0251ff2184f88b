"""The paper to the letter: its map, its keypoints, its Algorithm 1 with n and h.

Where the paper leaves a number or a step open, `paper_params` says what was taken. The pipeline
itself differs by its detector, by its noise, by one-to-one inliers and by its dense check.
"""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from gpgrad_core.features import DetectorParams
from gpgrad_core.gradient_map import MapParams
from gpgrad_core.matching import MatchParams
from gpgrad_core.memo import Memo
from gpgrad_core.pipeline import PipelineParams, infer_features, infer_map
from gpgrad_core.se2 import SE2, fit_se2
from gpgrad_core.types import (
    GradientMap,
    LoopDetector,
    Matches,
    Registration,
    Submap,
)

Array = NDArray[np.float64]

LENGTH_SCALE = 0.316
"""√0.1 m: Eq. (6) prints 2 l_k where others have 2 l², and l_k is about 0.1 (Sec. VI-B)."""
MIN_INLIERS = 5
"""Of a loop closure: all the paper's were right from five inliers on (Sec. VII-C)."""
INLIER_RADIUS = 0.1
"""The paper's "2D distance threshold" [m] has no number: about three pixels of its maps."""
MAX_DISSIMILARITY = np.inf
"""AcceptTransformation's threshold on h: the paper found that on n "the most effective"."""


def paper_params(params: PipelineParams) -> PipelineParams:
    """Turn parameters into the paper's, Secs. V and VI-B; only the seed and the noise stay.

    | what | paper | taken |
    |---|---|---|
    | points, resolution | 5000, 0.03 m/pixel | the same |
    | length-scale | l_k "around 0.1 m" in Eq. (6), unsquared, before fine-tuning | √0.1 m |
    | signal | the empirical variance | the same |
    | noise | "typical elevation accuracy" of the sensor | that of the parameters |
    | keypoints | SURF, masked by variance | the same, all of them; the default mask |
    | matching | brute force, L2 | nearest of each other, as OpenCV's cross-check |
    | inliers | "2D distance threshold" | 0.1 m |
    | acceptance | by h and n, later n alone, right from n = 5 | n of five |
    """
    return replace(
        params,
        map=MapParams(
            length_scale=LENGTH_SCALE,
            noise_std=params.map.noise_std,
            max_points=5000,
            resolution=0.03,
        ),
        features=replace(params.features, max_keypoints=20_000, detector=DetectorParams("surf")),
        matching=MatchParams(ratio=1.0, mutual=True),
        registration=replace(params.registration, inlier_radius=INLIER_RADIUS, trials=5000),
        closure=replace(params.closure, min_inliers=MIN_INLIERS, min_score=0.0),
    )
