"""Hyperparameters of the terrain out of its points: maximum marginal likelihood."""

from collections.abc import Collection, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.likelihood import Hyperparameters, Patch, log_marginal_likelihood
from gpgrad_core.gp.patches import Members, draw_patches
from gpgrad_core.gp.spacing import MOST_INFORMATION, information
from gpgrad_core.gradient_map import (
    NoiseModel,
    TerrainParams,
    kept_rows,
    point_noise,
    signal_std_of,
)
from gpgrad_core.params.fields import bounds_of
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.run.threads import num_workers, single_threaded_blas
from gpgrad_core.types import Submap

PATCHES = 16
"""Of one submap alone; of each of m submaps, this over the root of m."""
MOST_SUBMAPS = 8
"""Of more, as many are taken, evenly spaced."""
MOST_ROUNDS = 4
"""Of choosing points; one or two are the rule."""
MOST_LENGTH_SCALE = 2.0
"""That is believed, in radii of the patches; when longer, wider patches are drawn."""
MOST_EVALUATIONS = 40
"""Of the likelihood, in a round; about 10 are the rule."""
HALF_WAY = 8
"""Evaluations after which progress says half; nobody knows beforehand how many it takes."""
TOLERANCE = 1e-5
"""Gain of log likelihood a point, relative to its size, that is not worth another step: with
8,000 points a tenth or two in all, far below what a standard error moves it by, one half."""
MOST_INFORMATION_SOLVED = MOST_INFORMATION / 30
"""Where the ground is a plane almost free of noise, the noise is raised up to here, so that the
map can be solved for with digits to spare, and that of a denser submap too."""

Hyperparameter = Literal["length_scale", "signal_std", "noise"]
HYPERPARAMETERS: tuple[Hyperparameter, ...] = ("length_scale", "signal_std", "noise")
"""What is searched over, in the order of `Hyperparameters`; the noise is a factor on all of it."""

NOISE_PARAMETERS: dict[NoiseModel, tuple[str, ...]] = {
    "constant": ("noise_std",),
    "range": ("noise_std", "noise_growth"),
    "measured": ("noise_factor",),
    "file": ("noise_factor",),
}
"""What is multiplied, by noise model, so that the noise of every point is."""


@dataclass(frozen=True)
class FitResult:
    """What a fit found.

    Attributes:
        params: The start with the length-scale, the signal's and the noise's parameters replaced;
            the start itself where nothing better was found.
        log_likelihood_before: Per point, at the start; of heights in metres.
        log_likelihood_after: Per point, at the result.
        num_points: Points of all patches; one that is in two counts twice.
        num_evaluations: How often the likelihood of all patches was evaluated.
        submap_ids: Submaps that the points are from.
    """

    params: TerrainParams
    log_likelihood_before: float
    log_likelihood_after: float
    num_points: int
    num_evaluations: int
    submap_ids: tuple[str, ...]


def fit_parameters(
    submaps: Sequence[Submap],
    start: TerrainParams | None = None,
    *,
    fixed: Collection[Hyperparameter] = (),
    seed: int = 0,
    progress: Progress = silent,
) -> FitResult:
    """Find the hyperparameters that explain the points best, for all submaps jointly.

    The log marginal likelihood (Rasmussen & Williams 2006, Sec. 5.4.1) of n points costs n³, so
    it is summed over patches as if these were independent of each other: a composite likelihood.
    The score of each patch has expectation zero at the truth, whatever the others are, so the
    estimate is consistent (Varin, Reid & Firth, Statistica Sinica 21, 2011).

    The first patches are as dense as the cloud, and tell the noise and short length-scales best.
    If the length-scale turns out longer than they reach, wider and thinner ones are drawn, and
    the search goes on with those. Heights count from each submap's mean, as in `fit_terrain`.

    Args:
        submaps: One or more; of many, `MOST_SUBMAPS` evenly spaced ones are used.
        start: Where the search begins; None: the defaults. Its noise model stays; where noise
            differs from point to point, one factor for all is searched for.
        fixed: What stays as the start has it.
        seed: Of the random choice of points.
        progress: Called once an evaluation; may raise Cancelled.

    Raises:
        InputError: If there is no submap, or none of the noise that the noise model wants.
    """
    if not submaps:
        raise InputError("nothing to fit to: give one submap or more")
    start = start or TerrainParams()
    chosen = [submaps[k] for k in representative(len(submaps))]
    with single_threaded_blas(), ThreadPoolExecutor(num_workers()) as executor:
        evaluate = _Evaluate(executor, progress)
        params, areas = _search(chosen, start, fixed, np.random.default_rng(seed), evaluate)
        before, after = (_likelihood(areas, one, evaluate) for one in (start, params))
    progress(1.0)
    return FitResult(
        params if after > before else start,
        before,
        max(after, before),
        sum(area.num_points for area in areas),
        evaluate.count,
        tuple(submap.id for submap in chosen),
    )


def _search(
    submaps: list[Submap],
    start: TerrainParams,
    fixed: Collection[Hyperparameter],
    rng: np.random.Generator,
    evaluate: "_Evaluate",
) -> tuple[TerrainParams, "list[_Area]"]:
    """Find the maximum, and the points that it is a maximum for."""
    count = int(np.ceil(PATCHES / np.sqrt(len(submaps))))
    params = replace(start, signal_std=_common_signal_std(submaps, start))
    areas = [_Area.of(submap, start, count, 0.0, rng) for submap in submaps]
    for rounds_left in reversed(range(MOST_ROUNDS)):
        params = _maximum(areas, params, fixed, evaluate)
        if "noise" not in fixed:
            params = _solvable(params, areas)
        radius = params.length_scale
        if rounds_left == 0 or radius <= MOST_LENGTH_SCALE * _reach(areas):
            break
        areas = [_Area.of(submap, start, count, radius, rng) for submap in submaps]
    return params, areas


def fitted_names(params: TerrainParams) -> tuple[str, ...]:
    """Names of the parameters that a fit changes, given the noise model."""
    return ("length_scale", "signal_std", *NOISE_PARAMETERS[params.noise_model])


def representative(count: int) -> list[int]:
    """Tell which of so many submaps a fit looks at: up to `MOST_SUBMAPS`, evenly spaced.

    >>> representative(3)
    [0, 1, 2]
    """
    chosen = np.linspace(0, count - 1, min(count, MOST_SUBMAPS))
    return [int(k) for k in chosen.round()]


def _common_signal_std(submaps: list[Submap], start: TerrainParams) -> float:
    """One for all, where the start's None means each submap's own [m]."""
    each = [signal_std_of(submap.points, start) for submap in submaps]
    bounds = bounds_of(TerrainParams)["signal_std"]
    return float(np.clip(np.sqrt(np.mean(np.square(each))), bounds.low, bounds.high))


@dataclass(frozen=True, eq=False)
class _Area:
    """A submap, and which of its points are explained together."""

    submap: Submap
    kept: Members  # rows of the points that the map is made of
    patches: list[Members]  # rows of these

    @classmethod
    def of(
        cls,
        submap: Submap,
        start: TerrainParams,
        count: int,
        radius: float,
        rng: np.random.Generator,
    ) -> "_Area":
        kept = kept_rows(submap, start.max_points)
        return cls(submap, kept, draw_patches(submap.points[kept, :2], count, radius, rng))

    @property
    def points(self) -> Float[Array, "n 3"]:
        return self.submap.points[self.kept]

    @property
    def num_points(self) -> int:
        return sum(map(len, self.patches))

    def noise(self, params: TerrainParams) -> Float[Array, "n"]:
        return point_noise(self.submap, params).std[self.kept]

    def with_noise(self, params: TerrainParams) -> list[Patch]:
        """The patches, each point with the noise that the params give it."""
        xy, z, noise = self.points[:, :2], self.points[:, 2], self.noise(params)
        heights = z - z.mean()
        return [Patch(xy[rows], heights[rows], noise[rows]) for rows in self.patches]


def _reach(areas: list[_Area]) -> float:
    """How far the median patch reaches from its middle [m]."""
    sides = [np.ptp(area.points[rows, :2], axis=0) for area in areas for rows in area.patches]
    return float(np.median(np.sqrt(np.prod(sides, axis=1)) / 2))


class _Evaluate:
    """The log likelihood of patches, summed, with its gradient.

    The patches are shared out to threads and summed up in their order, so that the sum does not
    depend on the number of threads.
    """

    def __init__(self, executor: Executor, progress: Progress) -> None:
        self._executor, self._progress = executor, progress
        self.count = 0

    def __call__(self, patches: list[Patch], at: list[Hyperparameters]) -> tuple[float, Array]:
        """Evaluate each patch at its own; what the progress hook raises, comes through."""
        self._progress(self.count / (self.count + HALF_WAY))
        self.count += 1
        value, gradient = 0.0, np.zeros(3)
        for one_value, one_gradient in self._executor.map(log_marginal_likelihood, patches, at):
            value += one_value
            gradient += one_gradient
        return value, gradient


def _likelihood(areas: list[_Area], params: TerrainParams, evaluate: _Evaluate) -> float:
    """Log likelihood per point; where the signal is the points' own, of each submap by itself."""
    patches: list[Patch] = []
    at: list[Hyperparameters] = []
    for area in areas:
        patches += area.with_noise(params)
        signal_std = signal_std_of(area.points, params)
        at += [Hyperparameters(params.length_scale, signal_std, 1.0)] * len(area.patches)
    return evaluate(patches, at)[0] / sum(map(len, patches))


def _maximum(
    areas: list[_Area],
    params: TerrainParams,
    fixed: Collection[Hyperparameter],
    evaluate: _Evaluate,
) -> TerrainParams:
    """Climb from params, whose signal is set, to a maximum of the likelihood of all areas."""
    # Here, because it takes a while to load, and only a fit needs it.
    from scipy.optimize import Bounds, minimize  # noqa: PLC0415

    patches = [patch for area in areas for patch in area.with_noise(params)]
    num_points = sum(map(len, patches))

    def descend(logs: Float[Array, "3"]) -> tuple[float, Float[Array, "3"]]:
        value, gradient = evaluate(patches, [Hyperparameters.from_logs(logs)] * len(patches))
        return -value / num_points, -gradient / num_points

    limits = _limits(areas, params)
    start = Hyperparameters(params.length_scale, signal_std_of(areas[0].points, params), 1.0)
    for k, name in enumerate(HYPERPARAMETERS):
        if name in fixed:
            limits[:, k] = np.exp(start.logs[k])
    found: Array = minimize(
        descend,
        np.clip(start.logs, *np.log(limits)),
        jac=True,
        method="L-BFGS-B",
        bounds=Bounds(*np.log(limits)),
        options={"ftol": TOLERANCE, "gtol": 1e-3, "maxfun": MOST_EVALUATIONS},
    ).x
    # Rounding may carry the exponential of a limit past it.
    length_scale, signal_std, noise = np.clip(np.exp(found), *limits).tolist()
    return _with_noise_times(
        noise, replace(params, length_scale=length_scale, signal_std=signal_std)
    )


def _limits(areas: list[_Area], params: TerrainParams) -> Float[Array, "2 3"]:
    """Least and largest length-scale, signal and factor on the noise.

    All within what the params allow. A length-scale is neither below half the points' spacing,
    where it and noise look alike, nor above half the clouds' width, where it and a slope do.
    """
    bounds = bounds_of(TerrainParams)
    sides = np.array([np.ptp(area.points[:, :2], axis=0) for area in areas])
    spacings = np.sqrt(sides.prod(axis=1) / [len(area.kept) for area in areas])
    length, signal = bounds["length_scale"], bounds["signal_std"]
    shortest, longest = np.clip([spacings.min() / 2, sides.max() / 2], length.low, length.high)
    scaled = [
        (getattr(params, name), bounds[name]) for name in NOISE_PARAMETERS[params.noise_model]
    ]
    # A parameter of zero stays zero, whatever the factor.
    least = max(one.low / value for value, one in scaled if value > 0)
    most = min(one.high / value for value, one in scaled if value > 0)
    return np.array([(shortest, signal.low, least), (longest, signal.high, most)])


def _with_noise_times(factor: float, params: TerrainParams) -> TerrainParams:
    """Multiply the noise of every point, as far as the bounds allow."""
    bounds = bounds_of(TerrainParams)
    changes = {
        name: float(np.clip(factor * getattr(params, name), bounds[name].low, bounds[name].high))
        for name in NOISE_PARAMETERS[params.noise_model]
    }
    return replace(params, **changes)


def _solvable(params: TerrainParams, areas: list[_Area]) -> TerrainParams:
    """Raise the noise to the least with which the maps of the areas can be solved for.

    Only clouds that are next to free of noise on ground like a plane are below it.
    """
    most = 0.0
    for area in areas:
        kernel = SquaredExponential(signal_std_of(area.points, params), params.length_scale)
        noise_variance = np.square(area.noise(params))
        most = max(most, information(area.points[:, :2], noise_variance, kernel))
    excess = most / MOST_INFORMATION_SOLVED
    return params if excess <= 1 else _with_noise_times(float(np.sqrt(excess)), params)
