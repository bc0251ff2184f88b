"""The real datasets as poorer sensors would have made them: fewer points, noisier heights."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gpgrad_core.io.folder import load_dataset
from gpgrad_core.types import Dataset, Submap

SETS = ("marsyard2021", "sthelens", "apollo15", "hillside")
SEED = 7


def load_degraded(
    folder: Path, points: int | None = None, noise_std: float = 0.0, draw: int = 0
) -> Dataset:
    """Load a dataset, thin its clouds to so many points, and add noise to their heights [m].

    Another draw takes other points and other noise.
    """
    dataset = load_dataset(folder)
    if points is None and noise_std == 0:
        return dataset
    rng = np.random.default_rng(SEED + draw)
    submaps: list[Submap] = []
    for submap in dataset.submaps:
        kept = submap.points
        if points is not None and points < len(kept):
            kept = kept[rng.choice(len(kept), points, replace=False)]
        if noise_std > 0:
            kept = kept + np.c_[np.zeros((len(kept), 2)), rng.normal(0, noise_std, len(kept))]
        submaps.append(
            Submap.from_points(
                kept.astype(np.float32).astype(np.float64),
                submap.id,
                pose_true=submap.pose_true,
                pose_odometry=submap.pose_odometry,
            )
        )
    return replace(dataset, name=dataset.name, submaps=tuple(submaps))
