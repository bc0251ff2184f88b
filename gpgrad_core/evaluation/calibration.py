"""Measures whether the maps' uncertainty is right, with points that the maps have not seen.

Each held-out height is compared with the prediction of a map of the others: a Gaussian about the
elevation, with the sum of the map's variance and of a single point's noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates

from gpgrad_core.arrays import Array
from gpgrad_core.detection import PipelineParams, infer_gradient_map
from gpgrad_core.evaluation.report import TEMPLATES, Section, render
from gpgrad_core.ground import submap_of_cloud
from gpgrad_core.mapping.fitting import fit_parameters
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods.smoothed import smooth
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.types import Dataset, GradientMap, Submap

HELD_OUT = 0.1
"""Share of a submap's points that is held out."""
MOST_SUBMAPS = 6
"""Largest number of submaps that are judged; of more, this many are taken, evenly spaced."""
LEAST_STD = 1e-4
"""Smallest standard deviation of a prediction; a smaller one is raised to this [m]."""
WITHIN_68, WITHIN_95 = 1.0, 1.959964
"""Numbers of standard deviations within which a Gaussian has 68.27 % and 95 % of its mass."""


@dataclass(frozen=True)
class Calibration:
    """How well the uncertainty of one kind of map agrees with its errors."""

    name: str  # name of the kind of map
    num_points: int  # number of held-out points of all submaps
    density: float  # mean negative log predictive density of a height in metres; less is better
    within_68: float  # share of the points within the interval that should hold 68.27 %
    within_95: float  # share of the points within the interval that should hold 95 %
    # root mean square error of the elevation [m], including the noise of the held-out points
    error_rms: float
    params: MapParams | None  # parameters of the map, if it has any


def calibrate(
    dataset: Dataset,
    params: PipelineParams | None = None,
    *,
    seed: int = 0,
    progress: Progress = silent,
) -> tuple[Calibration, ...]:
    """Judge maps with constant noise, measured noise, both after a fit, and the smoothed grid."""
    params = params or PipelineParams()
    params = replace(params, map=params.map.guessed)  # what the fits below begin with
    count = min(len(dataset.submaps), MOST_SUBMAPS)
    chosen = [
        dataset.submaps[k] for k in np.linspace(0, len(dataset.submaps) - 1, count).astype(int)
    ]
    split = [_split(submap, seed) for submap in chosen]
    training = [submap for submap, _ in split]
    constant = replace(params.map, noise_model="constant")
    measured = replace(params.map, noise_model="measured")
    kinds: dict[str, MapParams | None] = {"constant noise": constant, "measured noise": measured}
    for k, (name, start) in enumerate((("constant", constant), ("measured", measured))):
        fit = fit_parameters(
            training, start.terrain, progress=part(progress, 0.2 * k, 0.2 * k + 0.2)
        )
        fitted = {field.name: getattr(fit.params, field.name) for field in fields(fit.params)}
        kinds[f"{name} noise, fitted"] = replace(start, **fitted)
    kinds["smoothed grid"] = None
    calibrations: list[Calibration] = []
    for k, (name, map_params) in enumerate(kinds.items()):
        predicted = [_predict(*pair, map_params, params) for pair in split]
        error, std = (np.concatenate(values) for values in zip(*predicted, strict=True))
        calibrations.append(judge_errors(name, error, std, map_params))
        progress(0.4 + 0.6 * (k + 1) / len(kinds))
    return tuple(calibrations)


def _split(submap: Submap, seed: int) -> tuple[Submap, Submap]:
    held_out = np.random.default_rng(seed).random(len(submap.points)) < HELD_OUT
    noise, ranges = submap.noise_std, submap.ranges
    training, unseen = (
        submap_of_cloud(
            submap.points[rows],
            submap.id,
            noise_std=None if noise is None else noise[rows],
            ranges=None if ranges is None else ranges[rows],
            ground="all",
        )
        for rows in (~held_out, held_out)
    )
    return training, unseen


def _predict(
    training: Submap, held_out: Submap, map_params: MapParams | None, params: PipelineParams
) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
    """Compute the errors at unseen points, and the standard deviations predicted for them [m]."""
    if map_params is None:
        gradient_map, scatter = smooth(training, params)
        point_variance = _at(gradient_map, scatter, held_out)
    else:
        gradient_map = infer_gradient_map(training, map_params)
        point_variance = map_params.terrain.noise.ordinary(held_out, training) ** 2
    error = held_out.points[:, 2] - _at(gradient_map, gradient_map.elevation, held_out)
    variance = _at(gradient_map, gradient_map.variance, held_out) + point_variance
    return error, np.sqrt(np.maximum(variance, LEAST_STD**2))


def _at(
    gradient_map: GradientMap, image: Float[Array, "rows columns"], submap: Submap
) -> Float[Array, "n"]:
    """Interpolate an image of the map at a submap's points; cells are much smaller than detail."""
    column, row = gradient_map.grid.to_pixel(submap.points[:, :2]).T
    return map_coordinates(image, [row, column], order=1, mode="nearest")


def judge_errors(
    name: str, error: Float[Array, "n"], std: Float[Array, "n"], params: MapParams | None
) -> Calibration:
    """Compare errors (n,) [m] with the standard deviations that were predicted for them [m]."""
    off = np.abs(error) / std
    density = 0.5 * np.log(2 * np.pi * std**2) + 0.5 * off**2
    return Calibration(
        name,
        len(error),
        float(density.mean()),
        float(np.mean(off <= WITHIN_68)),
        float(np.mean(off <= WITHIN_95)),
        float(np.sqrt(np.mean(error**2))),
        params,
    )


def describe_calibration(judged: Sequence[Calibration]) -> Section:
    """Describe the calibration as a section of the report."""
    text = render(TEMPLATES / "calibration.md", judged=judged, held_out=HELD_OUT)
    content = {
        kind.name: {
            "num_points": kind.num_points,
            "negative_log_predictive_density": kind.density,
            "within_68": kind.within_68,
            "within_95": kind.within_95,
            "error_rms": kind.error_rms,
        }
        for kind in judged
    }
    return Section("calibration", content, text)
