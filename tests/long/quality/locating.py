"""Submaps found on elevation models of their ground: ``python -m tests.long.quality.locating``.

The model of each submap is made from all other submaps at their true poses, so it has seen the
ground at other times: the mean height of each cell, then errors of its own, white and with long
waves, as models from orbit and from drones have them. The submap itself has no part in it. Ground
that no other submap saw has no height. A submap counts if the model knows most of its ground.

Around its ground lie eight other places: the same ground mirrored, which no rotation makes alike,
and the ground of the other datasets, mirrored too.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from jaxtyping import Float
from scipy import ndimage

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.io.rasters import Elevations
from gpgrad_core.locating import cut_windows, locate, merge_submaps, parameters_for, width_of
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.threads import num_workers
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Submap

ELLIPSES = -2 * np.log(1 - np.array([0.68, 0.95]))
"""Squared distances within which that share of the errors of a plane lies."""
RIGHT, FAR = 0.5, 1.0
"""A found place is right within the first [m]; beyond the second it is another place."""
WAVES = 8.0
"""Width of the Gaussian that gives the model's error its long waves [cells]."""
LEAST_KNOWN = 0.5
"""Share of a submap's cells that the model must know."""
MIRRORS = ((1, 1), (1, -1), (-1, 1))
"""Steps along rows and columns. Two mirrors are half a turn, which makes no other place."""


@dataclass(frozen=True)
class Options:
    """Arguments.

    Attributes:
        datasets: Datasets with true poses.
        cell: Side of the model's cells [m].
        noise: Standard deviation of the model's white error, and of that with long waves [m].
        merged: Whether to find this many neighbouring submaps as one.
        alone: Whether to leave out the other places.
        unrelated: Whether to leave out the ground itself, so that nothing can be found.
    """

    datasets: Annotated[tuple[Path, ...], tyro.conf.Positional]
    cell: float = 0.25
    noise: float = 0.03
    merged: int = 1
    alone: bool = False
    unrelated: bool = False


def make_model(submaps: Sequence[Submap], cell: float, noise: float, seed: int = 0) -> Elevations:
    """Make an elevation model from submaps at their true poses, with errors of its own."""
    world = np.concatenate([_in_world(one) for one in submaps])
    low = np.floor(world[:, :2].min(axis=0) / cell)
    where = np.floor(world[:, :2] / cell) - low
    columns, rows = (where.max(axis=0) + 1).astype(int)
    flat = (where[:, 1] * columns + where[:, 0]).astype(int)
    count = np.bincount(flat, minlength=rows * columns)
    total = np.bincount(flat, world[:, 2], minlength=rows * columns)
    with np.errstate(invalid="ignore"):
        heights = (total / count).reshape(rows, columns)
    chance = np.random.default_rng(seed)
    waves = ndimage.gaussian_filter(chance.normal(size=heights.shape), WAVES)
    heights += noise * (chance.normal(size=heights.shape) + waves / waves.std())
    corner = (low + 0.5) * cell
    return Elevations(heights, (cell, cell), (float(corner[0]), float(corner[1])))


def known_share(model: Elevations, submap: Submap, pose: Pose) -> float:
    """Compute the share of a submap's cells that a model knows."""
    xy = pose.apply(submap.points)[:, :2]
    places = np.unique(np.floor((xy - model.corner) / model.cell + 0.5).astype(int), axis=0)
    shape = np.array(model.heights.shape[::-1])
    inside = places[np.all((places >= 0) & (places < shape), axis=1)]
    known = np.isfinite(model.heights[inside[:, 1], inside[:, 0]])
    return float(known.sum() / len(places))


def surround(model: Elevations, others: Sequence[Elevations], *, itself: bool) -> Elevations:
    """Put a model into the middle of eight other places; without itself, these alone are left."""
    places = [_mirrored(one, mirror) for mirror in MIRRORS for one in (model, *others)][1:9]
    rows, columns = np.max([one.shape for one in (model.heights, *places)], axis=0) + 4
    mosaic = np.full((3 * rows, 3 * columns), np.nan)
    for k, heights in enumerate([*places[:4], model.heights, *places[4:]]):
        if k != 4 or itself:
            row, column = (k // 3) * rows, (k % 3) * columns
            mosaic[row : row + heights.shape[0], column : column + heights.shape[1]] = heights
    (width, height), (east, north) = model.cell, model.corner
    return replace(model, heights=mosaic, corner=(east - columns * width, north - rows * height))


def main() -> None:
    """Measure."""
    options = tyro.cli(Options)
    loaded = {path.name: load_dataset(path).submaps for path in options.datasets}
    models = {name: make_model(some, options.cell, options.noise) for name, some in loaded.items()}
    print("| set | submaps | accepted | right | wrong | right at all | median error [m] | in the "
          "68 %, 95 % ellipse | windows | seconds a submap |\n|" + "---|" * 10)  # fmt: skip
    for name, submaps in loaded.items():
        others = [model for other, model in models.items() if other != name]
        print(_row(name, submaps, others, options), flush=True)


def _row(
    name: str, submaps: Sequence[Submap], others: Sequence[Elevations], options: Options
) -> str:
    groups = [submaps[k : k + options.merged] for k in range(len(submaps) - options.merged + 1)]
    queries = [_joined(group, options.cell) for group in groups]
    width = max(width_of(one) for one, _ in queries)
    whole = make_model(submaps, options.cell, options.noise)
    params = parameters_for([one for one, _ in queries], cut_windows(whole, width), options.cell)
    errors: list[float] = []
    squared: list[float] = []
    spent: list[float] = []
    right_at_all = num_windows = 0
    with workers(num_workers(), 1000) as executor:
        for (query, true), group in zip(queries, groups, strict=True):
            names = {one.id for one in group}
            model = make_model(
                [one for one in submaps if one.id not in names], options.cell, options.noise
            )
            if known_share(model, query, true) < LEAST_KNOWN:
                continue
            if not options.alone:
                model = surround(model, others, itself=not options.unrelated)
            start = time.perf_counter()
            windows = cut_windows(model, width)
            (place,) = locate([query], windows, params, executor=executor)
            spent.append(time.perf_counter() - start)
            num_windows = len(windows)
            if place.pose is None:
                continue
            off = place.pose.translation[:2] - true.translation[:2]
            error = float(np.linalg.norm(off))
            right_at_all += error <= RIGHT
            found = place.verdict.registration
            if place.verdict.accepted:
                errors.append(error)
                if found.covariance is not None and error <= FAR:
                    covariance = found.covariance_at(np.zeros(2))  # of the submap's origin
                    squared.append(float(off @ np.linalg.solve(covariance[:2, :2], off)))
    right, wrong = (sum(one) for one in ([e <= RIGHT for e in errors], [e > FAR for e in errors]))
    inside = [np.mean(np.array(squared) <= limit) if squared else np.nan for limit in ELLIPSES]
    cells = (
        name, len(spent), len(errors), right, wrong, right_at_all,
        f"{np.median(errors) if errors else np.nan:.3f}", f"{inside[0]:.2f}, {inside[1]:.2f}",
        num_windows, f"{np.median(spent):.1f}",
    )  # fmt: skip
    return f"| {' | '.join(map(str, cells))} |"


def _mirrored(
    model: Elevations, mirror: tuple[int, int]
) -> Float[NDArray[np.floating], "rows columns"]:
    return model.heights[:: mirror[0], :: mirror[1]]


def _joined(group: Sequence[Submap], cell: float) -> tuple[Submap, Pose]:
    """Join submaps by their odometry; the true pose is the first one's."""
    first = group[0]
    assert first.pose_true is not None
    if len(group) == 1:
        return first, first.pose_true
    poses = [one.pose_odometry for one in group if one.pose_odometry is not None]
    return merge_submaps(group, poses, cell / 4), first.pose_true


def _in_world(submap: Submap) -> Float[Array, "n 3"]:
    assert submap.pose_true is not None
    return submap.pose_true.apply(submap.points)


if __name__ == "__main__":
    main()
