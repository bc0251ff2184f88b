"""Chooses automatic parameters: those that are None are fitted to the dataset, or to a submap."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gpgrad_core.detection.stages import PipelineParams
from gpgrad_core.gp.cloud import extent_of
from gpgrad_core.mapping.fitting import (
    MOST_POINTS,
    FitOptions,
    FitResult,
    Hyperparameter,
    fit_parameters,
    fitted_names,
    representative,
)
from gpgrad_core.mapping.gradient_map import (
    MapParams,
    TerrainParams,
    check_num_points,
    kept_points,
    signal_std_of,
    subsample,
)
from gpgrad_core.params import Bounds, bounds_of
from gpgrad_core.registration import RegistrationParams
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.scale import FEWEST_ACROSS, finest_of_kernel, resolved_scale
from gpgrad_core.types import Submap

SUBMAP_PATCH_POINTS = 400
"""Number of points of a patch if every submap gets its own fit."""
SUBMAP_TOLERANCE = 1e-4
"""Gain, as in `fitting.TOLERANCE`, at which the fit of a single submap stops."""
DIGITS = 4
"""Number of significant digits of the chosen values."""


def is_resolved(params: PipelineParams) -> bool:
    """Whether no parameter is automatic."""
    follows = params.map.scale, params.registration.inlier_radius
    return params.map.has_numbers and None not in follows


def resolve_parameters(
    submaps: Sequence[Submap],
    params: PipelineParams | None = None,
    memo: Memo | None = None,
    progress: Progress = silent,
) -> PipelineParams:
    """Choose the automatic parameters of a dataset, which takes a few seconds.

    Length-scale, noise and signal maximise the marginal likelihood of the points
    (`fit_parameters`). With the noise model auto, held-out points choose the model too.
    Parameters with numbers keep them, and the others are fitted with them. If length-scale and
    noise are fixed, a signal of None stays None, which means the points' own. The scale of
    comparison depends on the points alone: it comes from a fit of all parameters.

    Args:
        submaps: The submaps of the dataset. Those that `fitting.representative` chooses are
            enough; with them alone the result is the same.
        params: The parameters; None makes all of them automatic.
        memo: Keeps the fits, so that a second call for the same submaps costs nothing; with a store
            this also holds for later runs.
        progress: Called with the fraction done; may raise Cancelled.

    Returns:
        The parameters with numbers for ``map.length_scale``, ``map.noise_std`` and ``map.scale``,
        and for the inlier radius, which follows from the scale.

    Raises:
        InputError: If there is no submap, or if the noise model is ``file`` and a cloud gives no
            noise, or if a cloud has too many points for a map.
    """
    params = params or PipelineParams()
    if is_resolved(params):
        return params
    memo, requested = memo or Memo(), params.map
    for submap in submaps:
        check_num_points(submap, requested.max_points)  # refused before the long work
    free = TerrainParams(max_points=requested.max_points)
    if requested.noise_model not in ("auto", "constant"):
        free = replace(
            free,
            noise_model=requested.noise_model,
            noise_growth=requested.noise_growth,
            noise_factor=requested.noise_factor,
        )
    fixed = fixed_hyperparameters(requested)
    some = tuple(submaps[k] for k in representative(len(submaps)))
    map_params = requested
    if not fixed or requested.scale is None:
        choose = requested.noise_model == "auto"
        fitted = memo.lasting(_fitted, some, free, (), choose, progress=part(progress, 0.0, 0.6))
        if requested.scale is None:
            map_params = replace(map_params, scale=_of_map(_scale(submaps, fitted), "scale"))
        if not fixed:
            map_params = _with(map_params, fitted, fixed)
    if fixed and not requested.has_numbers:
        fitted = memo.lasting(
            _fitted,
            some,
            requested.guessed.terrain,
            fixed,
            requested.chooses_noise,
            progress=part(progress, 0.6, 1.0),
        )
        map_params = _with(map_params, fitted, fixed)
    progress(1.0)
    radius = params.registration.radius(map_params.scale)
    if params.registration.inlier_radius is None:
        radius = _rounded(radius, bounds_of(RegistrationParams)["inlier_radius"])
    registration = replace(params.registration, inlier_radius=radius)
    return replace(params, map=map_params, registration=registration)


def with_numbers_of(requested: PipelineParams, used: PipelineParams) -> PipelineParams:
    """Fill in automatic parameters from `used`, or else length-scale and noise by a first guess."""
    names = ("length_scale", "noise_std", "signal_std", "scale")
    if requested.map.has_numbers:
        names = ("scale",)  # then a signal of None is the points' own
    changes: dict[str, float] = {}
    for name in names:
        value = getattr(used.map, name)
        if getattr(requested.map, name) is None and value is not None:
            changes[name] = value
    map_params = requested.map
    if map_params.noise_std is None and map_params.noise_model in ("auto", used.map.noise_model):
        changes |= {name: getattr(used.map, name) for name in ("noise_growth", "noise_factor")}
        map_params = replace(map_params, noise_model=used.map.noise_model)
    registration = requested.registration
    if registration.inlier_radius is None:
        registration = replace(registration, inlier_radius=used.registration.inlier_radius)
    return replace(requested, map=replace(map_params, **changes).guessed, registration=registration)


def numbers_stay(before: PipelineParams, after: PipelineParams) -> bool:
    """Whether the automatic ones of ``after`` have the numbers fitted for ``before``."""
    grid = MapParams().resolution
    same_fit = replace(before.map, resolution=grid, scale=None) == replace(
        after.map, resolution=grid, scale=None
    )
    scales = before.map.scale, after.map.scale
    radii = before.registration.inlier_radius, after.registration.inlier_radius
    # The radius follows from the scale, and nothing from the radius.
    scale_stays = scales[0] is None or scales[1] is not None
    radius_stays = radii[1] is not None or (radii[0] is None and scales[0] == scales[1])
    return same_fit and scale_stays and radius_stays


def fit_submap(
    submap: Submap,
    start: TerrainParams,
    fixed: tuple[Hyperparameter, ...] = (),
    seed: int = 0,
    progress: Progress = silent,
) -> FitResult:
    """Fit the hyperparameters to a single submap, as the paper does for each (Sec. VI-B)."""
    result = fit_parameters(
        [submap],
        start,
        fixed=fixed,
        seed=seed,
        options=FitOptions(SUBMAP_PATCH_POINTS, trend=False, tolerance=SUBMAP_TOLERANCE),
        progress=progress,
    )
    fitted = result.params
    signal_std = signal_std_of(kept_points(submap, fitted.max_points), fitted)
    fitted, bounds = replace(fitted, signal_std=signal_std), bounds_of(TerrainParams)
    rounded = {name: _rounded(getattr(fitted, name), bounds[name]) for name in fitted_names(fitted)}
    return replace(result, params=replace(fitted, **rounded))


def describe_choice(requested: PipelineParams, used: PipelineParams) -> str:
    """Describe the chosen parameters in one line; the line is empty if none was chosen."""
    named = (
        ("length-scale", "length_scale", " m"),
        ("noise", "noise_std", " m"),
        ("noise growth", "noise_growth", " / m"),
        ("noise factor", "noise_factor", ""),
        ("signal", "signal_std", " m"),
        ("scale of comparison", "scale", " m"),
    )
    chosen = [
        f"{name} {getattr(used.map, field):.3g}{unit}"
        for name, field, unit in named
        if getattr(used.map, field) != getattr(requested.map, field)
    ]
    if used.registration.inlier_radius != requested.registration.inlier_radius:
        chosen.append(f"inlier radius {used.registration.inlier_radius:.3g} m")
    return f"fitted: {', '.join(chosen)}" if chosen else ""


def fixed_hyperparameters(requested: MapParams) -> tuple[Hyperparameter, ...]:
    """List the hyperparameters that a fit must not change."""
    fixed: list[Hyperparameter] = []
    if requested.length_scale is not None:
        fixed.append("length_scale")
    if requested.signal_std is not None:
        fixed.append("signal_std")
    if requested.noise_std is not None:
        fixed.append("noise")
    return tuple(fixed)


def _fitted(
    submaps: tuple[Submap, ...],
    start: TerrainParams,
    fixed: tuple[Hyperparameter, ...],
    choose: bool,
    progress: Progress = silent,
) -> TerrainParams:
    return fit_parameters(submaps, start, fixed=fixed, choose=choose, progress=progress).params


def _with(
    map_params: MapParams, fitted: TerrainParams, fixed: tuple[Hyperparameter, ...]
) -> MapParams:
    changes: dict[str, float] = {}
    for name in ("length_scale", "signal_std"):
        value = getattr(fitted, name)
        if name not in fixed and value is not None:
            changes[name] = _of_map(value, name)
    if "noise" not in fixed:
        for name in ("noise_std", "noise_growth", "noise_factor"):
            changes[name] = _of_map(getattr(fitted, name), name)
        return replace(map_params, noise_model=fitted.noise_model, **changes)
    return replace(map_params, **changes)


def _of_map(value: float, name: str) -> float:
    return _rounded(value, bounds_of(MapParams)[name])


def _rounded(value: float, bounds: Bounds) -> float:
    return min(max(float(f"{value:.{DIGITS}g}"), bounds.low), bounds.high)


def _scale(submaps: Sequence[Submap], fitted: TerrainParams) -> float:
    """Compute the scale of comparison [m] from a fit of all parameters: the submaps' median."""
    scales: list[float] = []
    for submap in (submaps[k] for k in representative(len(submaps))):
        some, total = subsample(submap, MOST_POINTS), len(submap.points)
        area, noise = float(extent_of(submap.points).prod()), fitted.noise.ordinary(some)
        count = total if fitted.max_points is None else min(total, fitted.max_points)
        density = float(np.mean(noise**2)) * area / count
        signal_std, length_scale = fitted.signal_std or 0.0, fitted.length_scale
        resolved = resolved_scale(density, signal_std / length_scale, area)
        finest = finest_of_kernel(density, signal_std, length_scale)
        scales.append(min(max(resolved, finest), float(np.sqrt(area)) / FEWEST_ACROSS))
    return float(np.median(scales))
