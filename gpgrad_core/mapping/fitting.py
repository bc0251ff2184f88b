"""Fits the hyperparameters of the terrain to its points by maximum marginal likelihood."""

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import pi, sqrt
from typing import Literal

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.gp.cloud import extent_of
from gpgrad_core.gp.kernel import MOST_INFORMATION, SquaredExponential, information
from gpgrad_core.gp.likelihood import (
    PATCH_POINTS,
    Hyperparameters,
    Likelihood,
    Members,
    Patch,
    draw_patches,
    log_marginal_likelihood,
)
from gpgrad_core.mapping.gradient_map import (
    NOISES,
    TerrainParams,
    sample_rows,
    signal_std_of,
    subsample,
)
from gpgrad_core.mapping.sensor_noise import (
    Residuals,
    SensorNoise,
    choose_noise,
    measured_by_others,
)
from gpgrad_core.params import bounds_of
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.threads import own_threads
from gpgrad_core.types import Submap

PATCHES = 16
"""Number of patches of a single submap. With m submaps each has this number divided by √m."""
LEAST_SHARE = 1 / 6
"""Least area of a patch with a trend, as a share of the submap's: a smaller one's is detail."""
MOST_SUBMAPS = 8
"""Largest number of submaps that a fit uses; of more, this many are taken, evenly spaced."""
MOST_POINTS = 300_000
"""Largest number of points of a submap that a fit uses; of more, as many are drawn at random."""
MOST_ROUNDS = 4
"""Largest number of times that patches are drawn."""
MOST_LENGTH_SCALE = 2.0
"""Largest length-scale that is accepted, in radii of the patches; else wider ones are drawn."""
MOST_EVALUATIONS = 40
"""Largest number of evaluations of the likelihood in a round."""
HALF_WAY = 8
"""Number of evaluations after which the progress is one half."""
TOLERANCE = 1e-5
"""The last step of the search promises less than this gain of the log likelihood per point."""
SIGNAL_TOLERANCE = 1e-3
"""The same for the signal alone, on which a map depends little."""
MOST_STEP = 1.0
"""Largest step of the search in the logarithm of a hyperparameter."""
MOST_BENDS = 2
"""Number of last steps that correct the information of the next."""
LEAST_DAMPING = 1e-3
"""Smallest damping of a step, as a share of the information."""
LEAST_INFORMATION = 1e-3
"""Added to the information of a point, so that a step exists where the heights tell nothing."""
MOST_INFORMATION_SOLVED = MOST_INFORMATION / 30
"""The noise is raised until the information is at most this, so that the map, and that of a denser
submap too, can be solved."""

Hyperparameter = Literal["length_scale", "signal_std", "noise"]
HYPERPARAMETERS: tuple[Hyperparameter, ...] = ("length_scale", "signal_std", "noise")
"""What a fit searches over, in the order of `Hyperparameters`; the noise is one factor for all
points."""


@dataclass(frozen=True)
class FitResult:
    """The result of a fit.

    Attributes:
        params: The fitted parameters: the start, with the length-scale, the signal and the
            parameters of the noise replaced. If no better ones were found, it is the start.
        log_likelihood_before: Log likelihood per point of the heights in metres, at the start.
        log_likelihood_after: The same at the result.
        num_points: Number of points in all patches; a point in two patches counts twice.
        num_evaluations: Number of evaluations of the likelihood of all patches.
        submap_ids: Names of the submaps that were used.
    """

    params: TerrainParams
    log_likelihood_before: float
    log_likelihood_after: float
    num_points: int
    num_evaluations: int
    submap_ids: tuple[str, ...]


@dataclass(frozen=True)
class FitOptions:
    """What the patches of a fit are, and when its search stops."""

    # number of points of a patch; a submap of no more points is one patch, and its likelihood is
    # the exact one
    patch_points: int = PATCH_POINTS
    # whether each patch has a plane of its own as its mean while noise and length-scale are found
    trend: bool = True
    tolerance: float = TOLERANCE  # as `TOLERANCE`


USUAL = FitOptions()


def fit_parameters(
    submaps: Sequence[Submap],
    start: TerrainParams | None = None,
    *,
    fixed: Collection[Hyperparameter] = (),
    choose: bool = False,
    seed: int = 0,
    options: FitOptions = USUAL,
    progress: Progress = silent,
) -> FitResult:
    """Find the hyperparameters under which the points of all submaps are most likely.

    The log marginal likelihood of n points (Rasmussen & Williams 2006, Sec. 5.4.1, Eq. (5.8))
    costs n³. So it is summed over patches of points as if they were independent: a composite
    likelihood. The expected score of each patch is zero at the true parameters, so the estimate
    is consistent (Varin, Reid & Firth, Statistica Sinica 21, 2011).

    The first patches are as dense as the cloud, and determine the noise and short length-scales
    best. If the length-scale turns out to be longer than they reach, wider and thinner patches
    are drawn, and the search continues with those.

    Noise and length-scale are found with an unknown plane as the mean of each patch (Sec. 2.7):
    hills that are longer than a patch say nothing of the detail on them, but with one kernel for
    both would pull the length-scale towards their own. The signal is found last, for heights
    relative to each submap's mean, as in `fit_terrain`.

    Args:
        submaps: One or more submaps. Of many, `MOST_SUBMAPS` evenly spaced ones are used.
        start: Where the search starts; None takes the defaults. The noise model stays. If the
            noise differs from point to point, one factor for all of it is searched for.
        fixed: Hyperparameters that stay as they are in the start.
        choose: Whether the noise model is chosen too (`choose_noise`). The search begins with
            constant noise; then models are compared on points left out, and the terrain is fitted
            again with the noise chosen.
        seed: Seed of the random choice of points.
        options: Size and trend of the patches, and where the search stops.
        progress: Called with the fraction done; may raise Cancelled.

    Raises:
        InputError: If there is no submap, or if the noise model is ``file`` and a cloud gives no
            noise.
    """
    if not submaps:
        raise InputError("nothing to fit to: give one submap or more")
    start = start or TerrainParams()
    trend = options.trend and not {"length_scale", "noise"} <= set(fixed)
    tolerance = options.tolerance
    chosen = [subsample(submaps[k], MOST_POINTS) for k in representative(len(submaps))]
    about_mean_std = _common_signal_std(chosen, start)
    with own_threads() as executor:
        evaluate = _Evaluate(executor, progress)
        rng = np.random.default_rng(seed)
        params, areas, patches = _search(
            partial(_Area.of_each, chosen, start, rng, options.patch_points, trend),
            replace(start, signal_std=about_mean_std),
            fixed,
            evaluate,
            tolerance,
        )
        if choose:
            params = _with_chosen_noise(areas, patches, params, fixed, evaluate, tolerance)
        before, after = (_likelihood(areas, each, evaluate) for each in (start, params))
        better = after > before or params.noise_model != start.noise_model
        params = params if better else start
        if better and trend and "signal_std" not in fixed:
            about_mean = [replace(area, trend=False) for area in areas]
            params = replace(params, signal_std=about_mean_std)
            held = ("length_scale", "noise")
            params, _ = _maximum(about_mean, params, held, evaluate, SIGNAL_TOLERANCE)
            if "noise" not in fixed:
                params = _solvable(params, areas)
    progress(1.0)
    return FitResult(
        params,
        before,
        after if better else before,
        sum(area.num_points for area in areas),
        evaluate.count,
        tuple(submap.id for submap in chosen),
    )


def _search(
    draw: Callable[[float], list["_Area"]],
    params: TerrainParams,
    fixed: Collection[Hyperparameter],
    evaluate: "_Evaluate",
    tolerance: float,
) -> tuple[TerrainParams, list["_Area"], list[Likelihood]]:
    """Find the maximum of the likelihood, and the points that it was computed from."""
    areas = draw(0.0)
    if areas[0].trend and "signal_std" not in fixed:
        params = replace(params, signal_std=_detrended_std(areas))
    for rounds_left in reversed(range(MOST_ROUNDS)):
        params, patches = _maximum(areas, params, fixed, evaluate, tolerance)
        if "noise" not in fixed:
            params = _solvable(params, areas)
        radius = params.length_scale
        if rounds_left == 0 or radius <= MOST_LENGTH_SCALE * _reach(areas):
            return params, areas, patches
        areas = draw(radius)
    raise AssertionError  # the last round returns


def _with_chosen_noise(
    areas: list["_Area"],
    patches: list[Likelihood],
    params: TerrainParams,
    fixed: Collection[Hyperparameter],
    evaluate: "_Evaluate",
    tolerance: float,
) -> TerrainParams:
    """Choose the noise model on points left out, and fit the terrain with it."""
    constant, residuals = params, evaluate.left_out(areas, patches, params)
    noise = choose_noise(residuals)
    if noise.model == "constant":
        return constant
    params = _solvable(_with_noise(params, noise), areas)
    params, patches = _maximum(areas, params, (*fixed, "noise"), evaluate, tolerance)
    noise = choose_noise(residuals.with_terrain(patches))
    if noise.model == "constant":
        return constant
    return _solvable(_with_noise(params, noise), areas)


def _with_noise(params: TerrainParams, noise: SensorNoise) -> TerrainParams:
    """Set a chosen noise, clipped to the bounds of the params."""
    bounds = bounds_of(TerrainParams)
    names = NOISES[noise.model].scales
    numbers = {
        name: float(np.clip(number, bounds[name].low, bounds[name].high))
        for name, number in zip(names, noise.numbers, strict=True)
    }
    usual = {"noise_growth": 0.0, "noise_factor": 1.0}
    return replace(params, noise_model=noise.model, **(usual | numbers))


def fitted_names(params: TerrainParams) -> tuple[str, ...]:
    """List the names of the parameters that a fit changes; they depend on the noise model."""
    return ("length_scale", "signal_std", *params.noise.scales)


def representative(count: int) -> list[int]:
    """Choose which of so many submaps a fit uses: up to `MOST_SUBMAPS`, evenly spaced.

    >>> representative(3)
    [0, 1, 2]
    """
    chosen = np.linspace(0, count - 1, min(count, MOST_SUBMAPS))
    return [int(k) for k in chosen.round()]


def _common_signal_std(submaps: list[Submap], start: TerrainParams) -> float:
    """Compute one signal for all submaps [m]: the root mean square of theirs."""
    each = [signal_std_of(submap.points, start) for submap in submaps]
    bounds = bounds_of(TerrainParams)["signal_std"]
    return float(np.clip(np.sqrt(np.mean(np.square(each))), bounds.low, bounds.high))


def _detrended_std(areas: list["_Area"]) -> float:
    """Compute by how much heights differ from a plane through each patch [m], root mean square."""
    squared: list[float] = []
    for area in areas:
        for rows in area.patches:
            x, y, z = (area.points[rows] - area.points[rows].mean(axis=0)).T
            plane = np.column_stack([x, y])
            rest = z - plane @ np.linalg.lstsq(plane, z, rcond=None)[0]
            squared.append(float(np.mean(rest**2)))
    bounds = bounds_of(TerrainParams)["signal_std"]
    return float(np.clip(np.sqrt(np.mean(squared)), bounds.low, bounds.high))


@dataclass(frozen=True, eq=False)
class _Area:
    submap: Submap  # the submap
    rows: Members  # indices of the points that the map is inferred from
    patches: list[Members]  # indices into these points, for each patch
    trend: bool  # whether each patch has a plane of its own as its mean

    @classmethod
    def of_each(
        cls,
        submaps: list[Submap],
        start: TerrainParams,
        rng: np.random.Generator,
        patch_points: int,
        trend: bool,
        radius: float,
    ) -> list["_Area"]:
        """Draw the patches of each submap, of at least a radius [m]."""
        count = int(np.ceil(PATCHES / np.sqrt(len(submaps))))
        areas: list[_Area] = []
        for submap in submaps:
            rows = sample_rows(submap, start.max_points)
            xy = submap.points[rows, :2]
            least = sqrt(LEAST_SHARE * extent_of(xy).prod() / pi) if trend else 0.0
            patches = draw_patches(xy, count, max(radius, least), rng, patch_points)
            areas.append(cls(submap, rows, patches, trend))
        return areas

    @property
    def points(self) -> Float[Array, "n 3"]:
        return self.submap.points[self.rows]

    @property
    def num_points(self) -> int:
        return sum(map(len, self.patches))

    def noise(self, params: TerrainParams) -> Float[Array, "n"]:
        without_signal = replace(params, signal_std=None)  # the noise does not depend on it
        if without_signal not in self._noises:
            self._noises[without_signal] = params.noise.of_points(self.submap).std[self.rows]
        return self._noises[without_signal]

    def beside(self, params: TerrainParams) -> tuple[Float[Array, "k"], Float[Array, "k"]]:
        """The range of the patches' points [m], and the noise measured without them [m]."""
        rows = np.concatenate(self.patches)
        prior = float(np.median(self.noise(params)))
        measured = measured_by_others(self.points, rows, params.length_scale, prior)
        ranges = self.submap.ranges
        return np.full(len(rows), np.nan) if ranges is None else ranges[self.rows[rows]], measured

    def with_noise(self, params: TerrainParams) -> list[Patch]:
        noise = self.noise(params)
        drawn = zip(self.patches, self._unit_patches, strict=True)
        return [patch.with_noise(noise[rows]) for rows, patch in drawn]

    @cached_property
    def _noises(self) -> dict[TerrainParams, Float[Array, "n"]]:
        return {}

    @cached_property
    def _unit_patches(self) -> list[Patch]:
        xy, z = self.points[:, :2], self.points[:, 2]
        mean = z.mean()
        return [
            Patch(
                xy[rows],
                z[rows] - (z[rows].mean() if self.trend else mean),
                np.ones(len(rows)),
                has_trend=self.trend,
            )
            for rows in self.patches
        ]


def _reach(areas: list[_Area]) -> float:
    """Compute the median distance from the middle of a patch to its edge [m]."""
    sides = [extent_of(area.points[rows]) for area in areas for rows in area.patches]
    return float(np.median(np.sqrt(np.prod(sides, axis=1)) / 2))


class _Evaluate:
    """The sum of the patches' log likelihoods, with its gradient."""

    def __init__(self, executor: Executor, progress: Progress) -> None:
        self._executor, self._progress = executor, progress
        self.count = 0

    def __call__(
        self, patches: list[Patch], at: list[Hyperparameters], *, gradient: bool = True
    ) -> list[Likelihood]:
        self._progress(self.count / (self.count + HALF_WAY))
        self.count += 1
        one_patch = partial(log_marginal_likelihood, gradient=gradient)
        return list(self._executor.map(one_patch, patches, at))

    def left_out(
        self, areas: list[_Area], patches: list[Likelihood], params: TerrainParams
    ) -> Residuals:
        self._progress(self.count / (self.count + HALF_WAY))
        beside = list(self._executor.map(partial(_Area.beside, params=params), areas))
        ranges, measured = (np.concatenate(each) for each in zip(*beside, strict=True))
        return Residuals.of(patches, ranges, measured)


def _likelihood(areas: list[_Area], params: TerrainParams, evaluate: _Evaluate) -> float:
    """Compute the log likelihood per point; a signal of None is that of each submap's points."""
    patches: list[Patch] = []
    at: list[Hyperparameters] = []
    for area in areas:
        patches += area.with_noise(params)
        signal_std = signal_std_of(area.points, params)
        at += [Hyperparameters(params.length_scale, signal_std, 1.0)] * len(area.patches)
    value = sum(patch.value for patch in evaluate(patches, at, gradient=False))
    return value / sum(map(len, patches))


def _maximum(
    areas: list[_Area],
    params: TerrainParams,
    fixed: Collection[Hyperparameter],
    evaluate: _Evaluate,
    tolerance: float,
) -> tuple[TerrainParams, list[Likelihood]]:
    """Search from params, whose signal is set, for a maximum of the likelihood of all areas.

    Each step solves for it with the average information in place of the second derivatives, damped
    as by Levenberg and Marquardt. The likelihoods returned are from before the last step.
    """
    patches = [patch for area in areas for patch in area.with_noise(params)]
    num_points = sum(map(len, patches))
    limits = _limits(areas, params)
    start = Hyperparameters(params.length_scale, signal_std_of(areas[0].points, params), 1.0)
    for k, name in enumerate(HYPERPARAMETERS):
        if name in fixed:
            limits[:, k] = (start.length_scale, start.signal_std, start.noise_std)[k]
    low, high = np.log(limits)
    logs, damping = np.clip(start.logs, low, high), LEAST_DAMPING
    each = evaluate(patches, [Hyperparameters.from_logs(logs)] * len(patches))
    steps: list[tuple[Array, Array]] = []
    for left in reversed(range(MOST_EVALUATIONS)):
        gradient = sum((patch.gradient for patch in each), np.zeros(3)) / num_points
        information = sum((patch.information for patch in each), np.zeros((3, 3))) / num_points
        information = _bent(information + LEAST_INFORMATION * np.eye(3), steps[-MOST_BENDS:])
        further, promised = _step(logs, gradient, information, damping, low, high)
        if promised <= tolerance or left == 0:
            logs = further
            break
        there = evaluate(patches, [Hyperparameters.from_logs(further)] * len(patches))
        gain = sum(new.value - old.value for new, old in zip(there, each, strict=True)) / num_points
        ahead = sum((patch.gradient for patch in there), np.zeros(3)) / num_points
        steps.append((further - logs, gradient - ahead))
        if gain > 0:
            logs, each = further, there
        damping = np.clip(damping * (0.1 if gain > 0.5 * promised else 10), LEAST_DAMPING, 1e6)
    # Rounding may move the exponential of a limit beyond the limit.
    length_scale, signal_std, noise = np.clip(np.exp(logs), *limits).tolist()
    optimum = replace(params, length_scale=length_scale, signal_std=signal_std)
    return _with_noise_times(noise, optimum), each


def _bent(
    information: Float[Array, "3 3"], steps: list[tuple[Array, Array]]
) -> Float[Array, "3 3"]:
    """Correct the information by how the gradient fell along the last steps (BFGS)."""
    for step, fall in steps:
        if step @ fall > 1e-3 * (step @ information @ step):
            turned = information @ step
            information = information + np.outer(fall, fall) / (step @ fall)
            information -= np.outer(turned, turned) / (step @ turned)
    return information


def _step(
    logs: Float[Array, "3"],
    gradient: Float[Array, "3"],
    information: Float[Array, "3 3"],
    damping: float,
    low: Float[Array, "3"],
    high: Float[Array, "3"],
) -> tuple[Float[Array, "3"], float]:
    """Compute a damped step within the limits: its end, and the gain that it promises."""
    held = ((logs <= low) & (gradient <= 0)) | ((logs >= high) & (gradient >= 0))
    free = np.flatnonzero(~held)
    damped = (information + damping * np.diag(np.diagonal(information)))[np.ix_(free, free)]
    step = np.zeros(3)
    step[free] = np.linalg.solve(damped, gradient[free])
    step *= min(1.0, MOST_STEP / max(float(np.abs(step).max()), 1e-12))
    further = np.clip(logs + step, low, high)
    step = further - logs
    return further, float(gradient @ step - 0.5 * step @ information @ step)


def _limits(areas: list[_Area], params: TerrainParams) -> Float[Array, "2 3"]:
    """Compute the smallest and largest length-scale, signal and factor on the noise."""
    bounds = bounds_of(TerrainParams)
    sides = np.array([extent_of(area.points) for area in areas])
    spacings = np.sqrt(sides.prod(axis=1) / [len(area.rows) for area in areas])
    length, signal = bounds["length_scale"], bounds["signal_std"]
    shortest, longest = np.clip([spacings.min() / 2, sides.max() / 2], length.low, length.high)
    scaled = [(getattr(params, name), bounds[name]) for name in params.noise.scales]
    # A parameter of zero stays zero under any factor.
    least = max(limits.low / value for value, limits in scaled if value > 0)
    most = min(limits.high / value for value, limits in scaled if value > 0)
    return np.array([(shortest, signal.low, least), (longest, signal.high, most)])


def _with_noise_times(factor: float, params: TerrainParams) -> TerrainParams:
    """Multiply the noise of every point, within the bounds of the params."""
    bounds = bounds_of(TerrainParams)
    changes = {
        name: float(np.clip(factor * getattr(params, name), bounds[name].low, bounds[name].high))
        for name in params.noise.scales
    }
    return replace(params, **changes)


def _solvable(params: TerrainParams, areas: list[_Area]) -> TerrainParams:
    """Raise the noise as little as needed for the maps of the areas to be solvable."""
    most = 0.0
    for area in areas:
        kernel = SquaredExponential(signal_std_of(area.points, params), params.length_scale)
        noise_variance = np.square(area.noise(params))
        most = max(most, information(area.points[:, :2], noise_variance, kernel))
    excess = most / MOST_INFORMATION_SOLVED
    return params if excess <= 1 else _with_noise_times(float(np.sqrt(excess)), params)
