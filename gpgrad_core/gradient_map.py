"""Submap -> gradient map: the paper's Sec. IV."""

from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int
from typing_extensions import Doc

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.gp.accuracy import EXACT, Accuracy
from gpgrad_core.gp.binning import thin_dense
from gpgrad_core.gp.inference import Posterior, fit_gp
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.noise import find_outliers, measure_noise
from gpgrad_core.gp.solution import TerrainFields
from gpgrad_core.params.bounds import Bounds
from gpgrad_core.params.fields import check_bounds
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.scale import noise_density, resolved_scale, rounded_scale
from gpgrad_core.types import Array, GradientMap, Grid, Submap

NoiseModel = Literal["constant", "range", "measured", "file"]

MEASURED_CELLS = 10_000
"""Cells of a map that its scale is measured on."""
SEEN_BELOW = 0.5
"""Share of the signal's variance below which a cell counts as seen, when a scale is measured."""
BINNED_FROM = 10_000
"""Points of a cloud from which on binning can save more than it costs."""


LENGTH_SCALE = Bounds(0.01, 100.0, 0.01, "m", slider=(0.05, 2.0))
NOISE_STD = Bounds(0.0005, 10.0, 0.005, "m", slider=(0.005, 0.3))
UNFITTED_LENGTH_SCALE, UNFITTED_NOISE_STD = 0.3, 0.05
"""What is taken where nothing was given and nothing was fitted [m]."""

NoiseModelParam: TypeAlias = Annotated[
    NoiseModel,
    Doc(
        "Noise of a point: constant (noise_std), range (noise_std + noise_growth r², where r is "
        "the range from the sensor if the cloud gives it, or else from the submap's origin), "
        "measured (by the scatter of the point's neighbours), or file (as the cloud gives it)."
    ),
]
NoiseGrowthParam: TypeAlias = Annotated[
    float,
    Bounds(0.0, 1.0, 0.0005, "1/m", slider=(0.0, 0.02)),
    Doc("What noise model 'range' adds at a range of 1 m; it adds four times that at 2 m."),
]
NoiseFactorParam: TypeAlias = Annotated[
    float,
    Bounds(0.1, 10.0, 0.05, slider=(0.5, 3.0)),
    Doc("The noise of the models 'measured' and 'file' is multiplied by this."),
]
MaxPointsParam: TypeAlias = Annotated[
    int | None,
    Bounds(3, 10_000_000, 1, "points", slider=(500, 30_000)),
    Doc("Thin the cloud at random to this many points; None: use all (the paper: 5000)."),
]
SIGNAL_STD = Bounds(0.001, 1000.0, 0.01, "m", slider=(0.05, 2.0))


@dataclass(frozen=True)
class TerrainParams:
    """The GP over a submap's elevation, Eqs. (1) and (6), with all its numbers.

    The paper prints Eq. (6) with an unsquared length-scale; its 0.1 would be sqrt(0.1) = 0.316 m
    in the kernel used here, ``signal_std² exp(-d² / (2 length_scale²))``.
    """

    length_scale: Annotated[
        float,
        LENGTH_SCALE,
        Doc("Distance over which the terrain's height stays alike; larger is smoother."),
    ] = UNFITTED_LENGTH_SCALE
    noise_std: Annotated[
        float,
        NOISE_STD,
        Doc("Standard deviation of one point's height; larger trusts single points less."),
    ] = UNFITTED_NOISE_STD
    noise_model: NoiseModelParam = "constant"
    noise_growth: NoiseGrowthParam = 0.0
    noise_factor: NoiseFactorParam = 1.0
    signal_std: Annotated[
        float | None,
        SIGNAL_STD,
        Doc("Standard deviation of the terrain's height; None: that of the submap's points."),
    ] = None
    max_points: MaxPointsParam = None

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)


@dataclass(frozen=True)
class MapParams:
    """How a submap becomes a gradient map: its GP, and the grid that it is sampled on.

    None means automatic: `pipeline.resolve_parameters` fits it to the dataset. A number is taken
    as it is. Where one submap stands alone and nothing is fitted, None means 0.3 m for the
    length-scale, 0.05 m for the noise, and the points' own standard deviation for the signal.
    """

    length_scale: Annotated[
        float | None,
        LENGTH_SCALE,
        Doc(
            "Distance over which the terrain's height stays alike; larger is smoother. "
            "None: fitted to the dataset."
        ),
    ] = None
    noise_std: Annotated[
        float | None,
        NOISE_STD,
        Doc(
            "Standard deviation of one point's height; larger trusts single points less. "
            "None: fitted to the dataset."
        ),
    ] = None
    noise_model: NoiseModelParam = "constant"
    noise_growth: NoiseGrowthParam = 0.0
    noise_factor: NoiseFactorParam = 1.0
    signal_std: Annotated[
        float | None,
        SIGNAL_STD,
        Doc(
            "Standard deviation of the terrain's height. None: fitted to the dataset, or that "
            "of the submap's points where nothing is fitted."
        ),
    ] = None
    max_points: MaxPointsParam = None
    resolution: Annotated[
        float,
        Bounds(0.005, 10.0, 0.005, "m", slider=(0.02, 0.2)),
        Doc("Side of a map cell."),
    ] = 0.03
    scale: Annotated[
        float | None,
        Bounds(0.01, 100.0, 0.01, "m", slider=(0.05, 2.0)),
        Doc(
            "Scale of comparison: the finest detail that keypoints, mask and registration look "
            "at. None: as fine as the points resolve."
        ),
    ] = None

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)

    @property
    def terrain(self) -> TerrainParams:
        """The part that the GP depends on: a new grid needs no new fit."""
        return TerrainParams(
            length_scale=UNFITTED_LENGTH_SCALE if self.length_scale is None else self.length_scale,
            noise_std=UNFITTED_NOISE_STD if self.noise_std is None else self.noise_std,
            noise_model=self.noise_model,
            noise_growth=self.noise_growth,
            noise_factor=self.noise_factor,
            signal_std=self.signal_std,
            max_points=self.max_points,
        )


def infer_gradient_map(
    submap: Submap, params: MapParams = MapParams(), progress: Progress = silent
) -> GradientMap:
    """Infer elevation, variance and slopes over the submap's bounding box, Eqs. (2)-(5).

    Args:
        submap: Gravity-aligned points [m].
        params: Of the GP and the grid.
        progress: Called once a block of rows; may raise Cancelled.

    Raises:
        InputError: If the grid or the GP would be too large, or the GP cannot be solved.
    """
    map_grid(submap, params.resolution)  # refuse a cloud that is too wide before the long work
    posterior = fit_terrain(submap, params.terrain, progress=progress)
    return sample_map(submap, posterior, params.resolution, params.scale)


def map_grid(submap: Submap, resolution: float) -> Grid:
    """Lay the grid over the submap's bounding box, as Sec. VI-B."""
    return Grid.covering(submap.points[:, :2], resolution, name=f"submap {submap.id}")


@dataclass(frozen=True, eq=False)
class PointNoise:
    """How far each point of a submap is believed."""

    std: Float[Array, "n"]  # of its height [m]
    outlying: Bool[NDArray[np.bool_], "n"]  # too far off its neighbours: noise as large as that


def point_noise(submap: Submap, params: TerrainParams) -> PointNoise:
    """Tell the noise of each point by the chosen model; outliers get as much as they are off.

    Raises:
        InputError: If the model is ``file`` and the cloud gives no noise.
    """
    points = submap.points
    if params.noise_model == "measured":
        measured = measure_noise(points, params.length_scale, params.noise_std)
        return PointNoise(params.noise_factor * measured.point_std, measured.outlying)
    std = ordinary_noise(submap, submap, params)
    return PointNoise(*find_outliers(points, params.length_scale, std))


def ordinary_noise(points_of: Submap, known_by: Submap, params: TerrainParams) -> Float[Array, "n"]:
    """Tell the noise of a submap's points as if none were an outlier [m].

    Args:
        points_of: Whose points are asked about.
        known_by: The submap that model ``measured`` measures.
        params: Chooses the model.

    Raises:
        InputError: If the model is ``file`` and the cloud gives no noise.
    """
    xy = points_of.points[:, :2]
    match params.noise_model:
        case "constant":
            return np.full(len(xy), params.noise_std)
        case "range":
            known = points_of.ranges
            squared = np.sum(xy**2, axis=1) if known is None else known**2
            return params.noise_std + params.noise_growth * squared
        case "measured":
            measured = measure_noise(known_by.points, params.length_scale, params.noise_std)
            return params.noise_factor * measured.std_at(xy)
        case "file":
            if points_of.noise_std is None:
                raise InputError(
                    f"submap {points_of.id} gives no noise_std for its points; choose another "
                    "noise_model: constant, range or measured"
                )
            return params.noise_factor * points_of.noise_std


def fit_terrain(
    submap: Submap,
    params: TerrainParams,
    progress: Progress = silent,
    accuracy: Accuracy = EXACT,
) -> Posterior:
    """Fit the GP of Eq. (1) to a submap's points.

    Large clouds, where it at least halves them, are binned to an eighth of a length-scale or
    less: means stand for their points with the noise of a mean.

    Args:
        submap: Gravity-aligned points [m].
        params: Of the GP.
        progress: Called now and then; may raise Cancelled.
        accuracy: How exact it is to be.

    Raises:
        InputError: If the GP would be too large or cannot be solved.
    """
    kept = kept_rows(submap, params.max_points)
    points, noise_std = submap.points[kept], point_noise(submap, params).std[kept]
    mean = float(points[:, 2].mean())
    signal_std = signal_std_of(points, params)
    if len(points) >= BINNED_FROM:
        points, noise_std = thin_dense(points, noise_std, params.length_scale, signal_std)
    kernel = SquaredExponential(signal_std, params.length_scale)
    return fit_gp(points, kernel, noise_std, mean=mean, accuracy=accuracy, progress=progress)


def kept_rows(submap: Submap, max_points: int | None) -> Int[NDArray[np.intp], "n"]:
    """Thin a submap's points at random to so many; the same ones each time."""
    num = len(submap.points)
    if max_points is None or num <= max_points:
        return np.arange(num)
    chosen = np.random.default_rng(0).choice(num, max_points, replace=False)
    return np.sort(chosen)


def kept_points(submap: Submap, max_points: int | None) -> Float[Array, "n 3"]:
    """Give the points that `kept_rows` keeps [m]."""
    return submap.points[kept_rows(submap, max_points)]


def signal_std_of(points: Float[Array, "n 3"], params: TerrainParams) -> float:
    """Give the standard deviation of the terrain's height: as set, or else the points' own [m]."""
    if params.signal_std is not None:
        return params.signal_std
    # A perfectly flat cloud has none; then the noise is all there is.
    return max(float(points[:, 2].std()), 0.01 * params.noise_std)


def infer_slope_variance(
    submap: Submap, params: MapParams = MapParams(), progress: Progress = silent
) -> Float[Array, "rows columns 2"]:
    """Infer how far the slopes of `infer_gradient_map` are to be believed.

    The paper leaves it out; differentiating Eq. (3) as Eqs. (4) and (5) do Eq. (2) gives

        var(∂z/∂x) = ∂²k/∂x∂x' - ∂K(x, X)/∂x [K(X, X) + D]⁻¹ ∂K(X, x')/∂x'

    Args:
        submap: Gravity-aligned points [m].
        params: Of the GP and the grid.
        progress: Called once a block of rows; may raise Cancelled.

    Returns:
        Posterior variance of the slope along x and along y [m²/m²].

    Raises:
        InputError: If the grid or the GP would be too large, or the GP cannot be solved.
    """
    grid = map_grid(submap, params.resolution)
    return fit_terrain(submap, params.terrain, progress=progress).sample_slope_variance(grid)


def sample_map(
    submap: Submap, posterior: Posterior, resolution: float, scale: float | None = None
) -> GradientMap:
    """Sample a fitted GP over its submap's bounding box.

    Args:
        submap: Its points give the box.
        posterior: The GP, fitted to these.
        resolution: Side of a cell [m].
        scale: The scale of comparison [m]; None: as fine as the map itself tells that the points
            resolve, rounded.
    """
    grid = map_grid(submap, resolution)
    kernel, fields = posterior.kernel, posterior.sample(grid)
    if scale is None:
        scale = _scale_of(fields, kernel, grid)
    return GradientMap(grid, *fields, kernel.signal_std, kernel.length_scale, scale)


def _scale_of(fields: TerrainFields, kernel: SquaredExponential, grid: Grid) -> float:
    """Tell what the points of a map resolve by the variance that they leave, and by the slopes."""
    stride = max(1, round(np.sqrt(grid.num_cells / MEASURED_CELLS)))
    thin = (slice(None, None, stride), slice(None, None, stride))
    variance, slope = fields.variance[thin], fields.slope[thin]
    seen = variance <= SEEN_BELOW * kernel.signal_std**2
    if not seen.any():
        return kernel.length_scale
    density = noise_density(variance[seen], kernel.signal_std, kernel.length_scale)
    slope_std = float(np.sqrt(np.mean(np.square(slope[seen]))))
    area = grid.num_cells * grid.resolution**2
    return rounded_scale(resolved_scale(float(np.median(density)), slope_std, area))
