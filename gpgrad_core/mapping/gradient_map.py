"""Turns a submap into a gradient map (the paper's Sec. IV)."""

from dataclasses import dataclass, fields, replace
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Int
from typing_extensions import Doc, override

from gpgrad_core.arrays import Array, Indices
from gpgrad_core.errors import InputError
from gpgrad_core.gp.cloud import thin_dense
from gpgrad_core.gp.inference import fit_gp
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.noise import MeasuredNoise, PointNoise, find_outliers, measure_noise
from gpgrad_core.gp.solution import EXACT, Accuracy, Posterior, TerrainFields
from gpgrad_core.params import Bounds, check_bounds
from gpgrad_core.run import Progress, silent
from gpgrad_core.scale import noise_density, resolved_scale, rounded_scale
from gpgrad_core.types import GradientMap, Grid, Submap

NoiseModel = Literal["constant", "range", "measured", "file"]
AskedNoiseModel = Literal["auto", "constant", "range", "measured", "file"]

MEASURED_CELLS = 10_000
"""Number of cells on which the scale of comparison of a map is measured."""
MAX_VARIANCE_SHARE = 0.5
"""A cell counts as seen if its variance is at most this share of the signal's variance."""
MOST_CELLS = 12_000_000
"""Largest number of cells of a submap's map."""
MOST_POINTS = 7_000_000
"""Largest number of points of a submap's map; measuring their noise takes 270 bytes a point."""
BINNED_FROM = 10_000
"""Smallest number of points for which binning saves more time than it costs."""


LENGTH_SCALE = Bounds(0.01, 100.0, 0.01, "m", slider=(0.05, 2.0))
NOISE_STD = Bounds(0.0005, 10.0, 0.005, "m", slider=(0.005, 0.3))
GUESSED_LENGTH_SCALE, GUESSED_NOISE_STD = 0.3, 0.05
"""Length-scale and noise [m] where a fit begins, if none are given."""

_SOURCE_OF_NOISE = "Where the noise of a point comes from:"
_NOISE_MODELS = (
    "constant (noise_std); range (noise_std + noise_growth r², where r is the range from the "
    "sensor, which the cloud must give); measured (from the scatter of the point's neighbours); or "
    "file (the cloud gives it)."
)
NoiseModelParam: TypeAlias = Annotated[NoiseModel, Doc(f"{_SOURCE_OF_NOISE} {_NOISE_MODELS}")]
AskedNoiseModelParam: TypeAlias = Annotated[
    AskedNoiseModel,
    Doc(
        f"{_SOURCE_OF_NOISE} auto (constant with a given noise_std; otherwise the dataset's points "
        "choose between constant, range and measured, and give the numbers); "
        f"{_NOISE_MODELS}"
    ),
]
NoiseGrowthParam: TypeAlias = Annotated[
    float,
    Bounds(0.0, 1.0, 0.0005, "1/m", slider=(0.0, 0.02)),
    Doc(
        "Noise that the noise model 'range' adds at a range of 1 m; at 2 m it adds four times that."
    ),
]
NoiseFactorParam: TypeAlias = Annotated[
    float,
    Bounds(0.1, 10.0, 0.05, slider=(0.5, 3.0)),
    Doc("Factor on the noise of the noise models 'measured' and 'file'."),
]
MaxPointsParam: TypeAlias = Annotated[
    int | None,
    Bounds(3, 10_000_000, 1, "points", slider=(500, 30_000)),
    Doc(
        "Largest number of points; a larger cloud is thinned at random. Automatic: all "
        "(the paper takes 5000)."
    ),
]
SIGNAL_STD = Bounds(0.001, 1000.0, 0.01, "m", slider=(0.05, 2.0))


@dataclass(frozen=True)
class TerrainParams:
    """Parameters of the GP over a submap's elevation, Eqs. (1) and (6).

    The kernel is ``signal_std² exp(-d² / (2 length_scale²))``. The paper prints Eq. (6) with an
    unsquared length-scale; its 0.1 is a length-scale of sqrt(0.1) m = 0.316 m here.
    """

    length_scale: Annotated[
        float,
        LENGTH_SCALE,
        Doc("Distance over which the terrain's height changes little; larger is smoother."),
    ] = GUESSED_LENGTH_SCALE
    noise_std: Annotated[
        float,
        NOISE_STD,
        Doc("Standard deviation of one point's height; larger follows single points less."),
    ] = GUESSED_NOISE_STD
    noise_model: NoiseModelParam = "constant"
    noise_growth: NoiseGrowthParam = 0.0
    noise_factor: NoiseFactorParam = 1.0
    signal_std: Annotated[
        float | None,
        SIGNAL_STD,
        Doc("Standard deviation of the terrain's height; automatic: that of the submap's points."),
    ] = None
    max_points: MaxPointsParam = None

    def __post_init__(self) -> None:
        check_bounds(self)

    @property
    def noise(self) -> "Noise":
        """The noise model."""
        return NOISES[self.noise_model](self)


@dataclass(frozen=True)
class MapParams:
    """Parameters of a gradient map: those of its GP, and the grid on which it is sampled.

    A number is used as it is. None means automatic, everywhere: the points decide. Length-scale,
    noise, signal and scale are fitted to the points of the dataset, or to those of the submaps at
    hand where a function gets no dataset (`resolve_parameters`); what needs numbers for the first
    two refuses params without (`terrain`). If these two are given, nothing is fitted, and the
    signal is that of each submap's points. All points are used.
    """

    length_scale: Annotated[
        float | None,
        LENGTH_SCALE,
        Doc(
            "Distance over which the terrain's height changes little; larger is smoother. "
            "Automatic: fitted to the dataset."
        ),
    ] = None
    noise_std: Annotated[
        float | None,
        NOISE_STD,
        Doc(
            "Standard deviation of one point's height; larger follows single points less. "
            "Automatic: fitted to the dataset."
        ),
    ] = None
    noise_model: AskedNoiseModelParam = "auto"
    noise_growth: NoiseGrowthParam = 0.0
    noise_factor: NoiseFactorParam = 1.0
    signal_std: Annotated[
        float | None,
        SIGNAL_STD,
        Doc(
            "Standard deviation of the terrain's height. Automatic: fitted to the dataset, or that "
            "of the submap's points if nothing is fitted."
        ),
    ] = None
    max_points: MaxPointsParam = None
    resolution: Annotated[
        float,
        Bounds(0.005, 10.0, 0.005, "m", slider=(0.02, 0.2)),
        Doc("Side of a cell of the map."),
    ] = 0.03
    scale: Annotated[
        float | None,
        Bounds(0.01, 100.0, 0.01, "m", slider=(0.05, 2.0)),
        Doc(
            "Scale of comparison: the finest detail that keypoints, variance mask and registration "
            "use. Automatic: the finest detail that the points resolve."
        ),
    ] = None

    def __post_init__(self) -> None:
        check_bounds(self)

    @property
    def has_numbers(self) -> bool:
        """Whether length-scale and noise have numbers, so that a GP can be made with them."""
        return self.length_scale is not None and self.noise_std is not None

    @property
    def terrain(self) -> TerrainParams:
        """The parameters of the GP alone; a new grid needs no new fit.

        Raises:
            InputError: If length-scale or noise are automatic, and so have no numbers yet.
        """
        if not self.has_numbers:
            name = "length_scale" if self.length_scale is None else "noise_std"
            raise InputError(
                f"map.{name} is automatic, so it has no number yet: fit it with "
                "resolve_parameters, or give one"
            )
        own = {field.name: getattr(self, field.name) for field in fields(TerrainParams)}
        if self.noise_model == "auto":
            own["noise_model"] = "constant"
        return TerrainParams(**own)

    @property
    def chooses_noise(self) -> bool:
        """Whether the points choose the noise model too."""
        return self.noise_model == "auto" and self.noise_std is None

    @property
    def guessed(self) -> "MapParams":
        """A copy with numbers for length-scale and noise: where they are automatic, a first guess.

        A fit begins there. The methods that fit nothing use it as it is.
        """
        return self.starting_at(GUESSED_LENGTH_SCALE, GUESSED_NOISE_STD)

    def starting_at(self, length_scale: float, noise_std: float) -> "MapParams":
        """Copy them with these numbers [m] where length-scale and noise are automatic."""
        return replace(
            self,
            length_scale=length_scale if self.length_scale is None else self.length_scale,
            noise_std=noise_std if self.noise_std is None else self.noise_std,
        )


def map_grid(submap: Submap, resolution: float) -> Grid:
    """Make the grid over the submap's box, of cells of a side [m] (the paper's Sec. VI-B)."""
    name = f"submap {submap.id}"
    return Grid.covering(submap.corners, resolution, name=name, max_cells=MOST_CELLS)


@dataclass(frozen=True)
class Noise:
    """A noise model with its numbers: here the constant one."""

    scales: ClassVar[tuple[str, ...]] = ("noise_std",)
    """The parameters that multiply the noise of every point."""
    params: TerrainParams

    def ordinary(self, submap: Submap, reference: Submap | None = None) -> Float[Array, "n"]:
        """Determine the noise of a submap's points (n,) [m] as if none were an outlier."""
        del reference
        return np.full(len(submap.points), self.params.noise_std)

    def of_points(self, submap: Submap) -> PointNoise:
        """Determine the noise of each point, and find the outliers."""
        std = self.ordinary(submap)
        return find_outliers(submap.points, self.params.length_scale, std)

    @staticmethod
    def terms(ranges: Float[Array, "n"], measured: Float[Array, "n"]) -> Float[Array, "k n"]:
        """The terms that the scales multiply at points of some range [m] and measured noise [m]."""
        del measured
        return np.ones((1, len(ranges)))


class RangeNoise(Noise):
    """Noise that grows with the square of the range."""

    scales = ("noise_std", "noise_growth")

    @override
    def ordinary(self, submap: Submap, reference: Submap | None = None) -> Float[Array, "n"]:
        if submap.ranges is None:
            raise InputError(
                f"submap {submap.id} gives no range for its points, so nothing says where "
                "the sensor was; choose another noise_model: constant or measured"
            )
        return self.params.noise_std + self.params.noise_growth * submap.ranges**2

    @override
    @staticmethod
    def terms(ranges: Float[Array, "n"], measured: Float[Array, "n"]) -> Float[Array, "k n"]:
        return np.stack([np.ones(len(ranges)), ranges**2])


class ScatterNoise(Noise):
    """Noise that is measured from the scatter of the points."""

    scales = ("noise_factor",)

    @override
    def ordinary(self, submap: Submap, reference: Submap | None = None) -> Float[Array, "n"]:
        measured = self._measured(submap if reference is None else reference)
        return self.params.noise_factor * measured.std_at(submap.points[:, :2])

    @override
    def of_points(self, submap: Submap) -> PointNoise:
        measured = self._measured(submap)
        return PointNoise(self.params.noise_factor * measured.std, measured.outlying)

    @override
    @staticmethod
    def terms(ranges: Float[Array, "n"], measured: Float[Array, "n"]) -> Float[Array, "k n"]:
        return measured[None]

    def _measured(self, submap: Submap) -> MeasuredNoise:
        return measure_noise(submap.points, self.params.length_scale, self.params.noise_std)


class FileNoise(Noise):
    """Noise that the cloud gives."""

    scales = ("noise_factor",)

    @override
    def ordinary(self, submap: Submap, reference: Submap | None = None) -> Float[Array, "n"]:
        if submap.noise_std is None:
            raise InputError(
                f"submap {submap.id} gives no noise_std for its points; choose another "
                "noise_model: constant, range or measured"
            )
        return self.params.noise_factor * submap.noise_std


NOISES: dict[NoiseModel, type[Noise]] = {
    "constant": Noise,
    "range": RangeNoise,
    "measured": ScatterNoise,
    "file": FileNoise,
}


def fit_terrain(
    submap: Submap, params: TerrainParams, progress: Progress = silent, accuracy: Accuracy = EXACT
) -> Posterior:
    """Fit the GP of Eq. (1) to a submap's points.

    If it at least halves a large cloud, the cloud is binned to cells of an eighth of a length-scale
    or less: a weighted mean replaces the points of a cell, with the noise of a mean.
    """
    check_num_points(submap, params.max_points)
    submap = subsample(submap, MOST_POINTS)
    rows = sample_rows(submap, params.max_points)
    points, noise_std = submap.points[rows], params.noise.of_points(submap).std[rows]
    mean = float(points[:, 2].mean())
    signal_std = signal_std_of(points, params)
    if len(points) >= BINNED_FROM:
        points, noise_std = thin_dense(points, noise_std, params.length_scale, signal_std)
    kernel = SquaredExponential(signal_std, params.length_scale)
    return fit_gp(points, kernel, noise_std, mean=mean, accuracy=accuracy, progress=progress)


def check_num_points(submap: Submap, max_points: int | None) -> None:
    """Refuse a submap of too many points for a map, unless few of them are asked for."""
    if len(submap.points) > MOST_POINTS and (max_points is None or max_points > MOST_POINTS):
        raise InputError(
            f"submap {submap.id} has {len(submap.points):,} points, more than the {MOST_POINTS:,} "
            "allowed; set max_points (--map.max-points) to that or fewer"
        )


def sample_rows(submap: Submap, max_points: int | None) -> Int[Indices, "n"]:
    """Choose at most so many points at random, the same ones each time; gives ascending indices."""
    num = len(submap.points)
    if max_points is None or num <= max_points:
        return np.arange(num)
    chosen = np.random.default_rng(0).choice(num, max_points, replace=False)
    return np.sort(chosen)


def subsample(submap: Submap, most: int) -> Submap:
    """Thin a submap to the points that `sample_rows` keeps; a smaller one is returned as it is."""
    if len(submap.points) <= most:
        return submap
    rows = sample_rows(submap, most)

    def some(values: Float[Array, "n"] | None) -> Float[Array, "k"] | None:
        return None if values is None else values[rows]

    return replace(
        submap,
        points=submap.points[rows],
        fingerprint=f"{submap.fingerprint}-{most}",
        colors=None,
        noise_std=some(submap.noise_std),
        ranges=some(submap.ranges),
    )


def kept_points(submap: Submap, max_points: int | None) -> Float[Array, "n 3"]:
    """Return the points that `sample_rows` keeps (n, 3) [m]."""
    return submap.points[sample_rows(submap, max_points)]


def signal_std_of(points: Float[Array, "n 3"], params: TerrainParams) -> float:
    """Return ``params.signal_std``, or else the standard deviation of the points' heights [m]."""
    if params.signal_std is not None:
        return params.signal_std
    # A perfectly flat cloud has none; then the noise is all the variation there is.
    return max(float(points[:, 2].std()), 0.01 * params.noise_std)


def sample_map(
    submap: Submap, posterior: Posterior, resolution: float, scale: float | None = None
) -> GradientMap:
    """Sample a fitted GP over its submap's bounding box, in cells of a side [m]."""
    grid = map_grid(submap, resolution)
    kernel, fields = posterior.kernel, posterior.sample(grid)
    if scale is None:
        scale = _scale_of(fields, kernel, grid)
    return GradientMap(grid, *fields, kernel.signal_std, kernel.length_scale, scale)


def _scale_of(fields: TerrainFields, kernel: SquaredExponential, grid: Grid) -> float:
    """Measure the finest detail that the points resolve [m], from the variance and the slopes."""
    stride = max(1, round(np.sqrt(grid.num_cells / MEASURED_CELLS)))
    thin = (slice(None, None, stride), slice(None, None, stride))
    variance, slope = fields.variance[thin], fields.slope[thin]
    observed = variance <= MAX_VARIANCE_SHARE * kernel.signal_std**2
    if not observed.any():
        return kernel.length_scale
    density = noise_density(variance[observed], kernel.signal_std, kernel.length_scale)
    slope_std = float(np.sqrt(np.mean(np.square(slope[observed]))))
    area = grid.num_cells * grid.resolution**2
    return rounded_scale(resolved_scale(float(np.median(density)), slope_std, area))
