"""One function a peer: each answers the same task in its own library's best way.

Hyperparameters are given, never fitted; heights go in with their mean taken off. Every adapter
imports its own library, so that a process pays for no other one. Variances are those of the
terrain, not of a new noisy measurement of it.
"""

# ruff: noqa: PLC0415 - a process is to load the library that it measures, and no other

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from tests.long.benchmarks.peers.cases import NOISE, Answer, Array, Task

DENSE_TILE = 2000
"""Cells at once where each costs a kernel row: 80 MB a matrix for 5,000 points."""


def ours(task: Task) -> Answer:
    """Infer a gradient map as the pipeline does, binning of large clouds included."""
    from gpgrad_core.detection import infer_gradient_map
    from gpgrad_core.mapping.gradient_map import MapParams
    from gpgrad_core.types import Submap

    params = MapParams(
        length_scale=task.length_scale,
        noise_std=NOISE,
        signal_std=task.signal_std,
        resolution=task.case.resolution,
    )
    made = infer_gradient_map(Submap.from_points(task.points), params)
    return Answer(made.elevation, made.std, made.slope)


def dense(task: Task) -> Answer:
    """The paper's equations as printed: what all others are compared with."""
    from gpgrad_core.gp.kernel import SquaredExponential
    from tests.support.dense import fit_dense, infer_elevation, infer_slope, infer_variance

    posterior = fit_dense(
        task.points, SquaredExponential(task.signal_std, task.length_scale), NOISE
    )
    tiles = task.tiles(DENSE_TILE)
    return Answer.of_cells(
        task,
        np.concatenate([infer_elevation(posterior, tile) for tile in tiles]) - task.mean,
        np.concatenate([infer_variance(posterior, tile) for tile in tiles]),
        np.concatenate([infer_slope(posterior, tile) for tile in tiles]),
    )


def scikit_learn(task: Task) -> Answer:
    """GaussianProcessRegressor at fixed hyperparameters; it has no slopes."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel

    kernel = ConstantKernel(task.signal_std**2) * RBF(task.length_scale)
    model = GaussianProcessRegressor(kernel, alpha=NOISE**2, optimizer=None)
    model.fit(task.xy, task.heights)
    parts = [model.predict(tile, return_std=True) for tile in task.tiles(DENSE_TILE)]
    elevation, std = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Answer.of_cells(task, elevation, std**2)


def gpytorch_exact(task: Task) -> Answer:
    """ExactGP in float64 with its Cholesky path, which is exact; slopes by differentiation.

    Its default above 800 points, conjugate gradients and low-rank variances, is what SKI below
    uses; here the low-rank variances would be wrong several times over.
    """
    import gpytorch
    import torch
    from gpytorch import settings

    limits = (settings.max_cholesky_size(10**9), settings.fast_computations(False, False, False))
    return _ask_gpytorch(task, gpytorch.kernels.RBFKernel(), limits, DENSE_TILE, torch.float64)


@dataclass(frozen=True)
class SkiSettings:
    """What decides over SKI's time and error.

    Attributes:
        spacing: Of its grid of inducing points, in length-scales.
        rank: Of the variances (`max_root_decomposition_size`); the library's default is 100.
        tolerance: Of the conjugate gradients (`eval_cg_tolerance`); the default is 0.01.
    """

    spacing: float = 0.25
    rank: int = 100
    tolerance: float = 0.01

    @property
    def name(self) -> str:
        """For tables and the command line."""
        return f"GPyTorch SKI, grid {self.spacing:g} l, rank {self.rank}, cg {self.tolerance:g}"


def gpytorch_ski(task: Task, chosen: SkiSettings) -> Answer:
    """KISS-GP with its fast predictive variances (LOVE); slopes by differentiation.

    In float32, the library's default: a third faster than in float64, with the same errors.
    """
    import gpytorch
    import torch
    from gpytorch import settings

    step = chosen.spacing * task.length_scale
    margin = 3 * step  # the cubic interpolation needs two nodes beyond the outermost point
    nodes = int(np.ceil((task.case.side + 2 * margin) / step)) + 1
    bounds = (-margin, (nodes - 1) * step - margin)
    kernel = gpytorch.kernels.GridInterpolationKernel(
        gpytorch.kernels.RBFKernel(), grid_size=nodes, num_dims=2, grid_bounds=(bounds, bounds)
    )
    limits = (
        settings.fast_pred_var(),
        settings.max_root_decomposition_size(chosen.rank),
        settings.eval_cg_tolerance(chosen.tolerance),
        settings.max_cg_iterations(2000),
    )
    # Its interpolation holds sixteen rows as long as the rank for every cell: 80 MB at once.
    tile_size = 20_000_000 // (16 * chosen.rank)
    return _ask_gpytorch(task, kernel, limits, tile_size, torch.float32)


def _ask_gpytorch(
    task: Task, base: Any, limits: tuple[Any, ...], tile_size: int, dtype: Any
) -> Answer:
    """Predict tile by tile with an ExactGP over a given kernel."""
    from contextlib import ExitStack

    import gpytorch
    import torch
    from gpytorch import settings

    class Terrain(gpytorch.models.ExactGP):
        def __init__(self, likelihood: Any) -> None:
            xy, heights = (torch.as_tensor(given, dtype=dtype) for given in (task.xy, task.heights))
            super().__init__(xy, heights, likelihood)
            self.mean_module = gpytorch.means.ZeroMean()
            self.covar_module = gpytorch.kernels.ScaleKernel(base)

        def forward(self, xy: Any) -> Any:
            return gpytorch.distributions.MultivariateNormal(
                self.mean_module(xy), self.covar_module(xy)
            )

    model = Terrain(gpytorch.likelihoods.GaussianLikelihood()).to(dtype).eval()
    model.likelihood.noise = NOISE**2
    model.covar_module.outputscale = task.signal_std**2
    smooth = getattr(base, "base_kernel", base)  # the one that a grid of inducing points wraps
    smooth.lengthscale = task.length_scale
    parts = []
    with ExitStack() as stack:
        for limit in limits:
            stack.enter_context(limit)
        for tile in task.tiles(tile_size):
            xy = torch.as_tensor(tile, dtype=dtype)
            with torch.no_grad():
                variance = model(xy).variance
            # A cell's elevation depends on its own position only, so the sum's gradient is all;
            # without variances, or their derivatives would be kept ready too.
            with settings.skip_posterior_variances(), settings.fast_pred_var(False):
                elevation = model(xy.requires_grad_()).mean
            (slope,) = torch.autograd.grad(elevation.sum(), xy)
            parts.append([part.detach().double().numpy() for part in (elevation, variance, slope)])
    return Answer.of_cells(task, *(np.concatenate(column) for column in zip(*parts, strict=True)))


def pykrige(task: Task) -> Answer:
    """Ordinary kriging, all points for every cell; it has no slopes.

    It estimates the constant mean along with the terrain, where all others are told it: a
    difference far below the noise where points are many. It inverts its matrix anew at every
    call, so the tiles are as large as the memory allows: it holds six matrices of them.
    """
    model = _pykrige_model(task)
    cells = max(80_000_000 // len(task.points), DENSE_TILE)
    parts = [model.execute("points", *tile.T, backend="vectorized") for tile in task.tiles(cells)]
    elevation, variance = (
        np.concatenate([np.asarray(part) for part in column]) for column in zip(*parts, strict=True)
    )  # as plain arrays: they come masked, with nothing masked
    return Answer.of_cells(task, elevation, variance - NOISE**2)


def pykrige_window(task: Task, neighbours: int) -> Answer:
    """The same with each cell's nearest points only, its own way to large clouds, compiled."""
    model = _pykrige_model(task)
    nearest = min(neighbours, len(task.points))  # it reads beyond its memory where there are fewer
    elevation, variance = model.execute(
        "points", *task.grid.positions.T, backend="C", n_closest_points=nearest
    )
    return Answer.of_cells(task, np.asarray(elevation), np.asarray(variance) - NOISE**2)


def _pykrige_model(task: Task) -> Any:
    from pykrige.ok import OrdinaryKriging

    # Its Gaussian variogram is 1 - exp(-d² / (4/7 range)²), and a variance that it gives is that
    # of a new measurement, nugget included.
    return OrdinaryKriging(
        *task.xy.T,
        task.heights,
        variogram_model="gaussian",
        variogram_parameters={
            "psill": task.signal_std**2,
            "range": np.sqrt(2) * task.length_scale * 7 / 4,
            "nugget": NOISE**2,
        },
        exact_values=False,
    )


def gstools(task: Task) -> Answer:
    """Simple kriging: the same model as ours; it has no slopes.

    Its own default, a pseudo-inverse by singular values, takes several times as long, and so
    does its optional Rust form of the same loop; the compiled one used here takes as many threads
    as it is told.
    """
    from gstools import Gaussian, config
    from gstools.krige import Simple

    from gpgrad_core.run.threads import num_workers

    # With this rescaling its correlation exp(-(rescale d / len_scale)²) is ours. The noise goes
    # in as an error of the measurements: as a nugget, it would be counted as terrain.
    config.NUM_THREADS = num_workers()
    config.USE_GSTOOLS_CORE = False
    model = Gaussian(
        dim=2, var=task.signal_std**2, len_scale=task.length_scale, rescale=np.sqrt(0.5)
    )
    kriging = Simple(model, task.xy.T, task.heights, mean=0.0, cond_err=NOISE**2, pseudo_inv=False)
    # All cells at once would be a matrix of cells by points; few at once stay in the cache.
    elevation, variance = kriging(task.grid.positions.T, chunk_size=64, store=False)
    return Answer.of_cells(task, elevation, variance)


def smoothed_grid(task: Task) -> Answer:
    """No GP: mean height of each cell, Gaussian normalised convolution, finite differences.

    What one would do without a GP. It has no variance that means anything: the weight under the
    Gaussian says how many points are near, not how far off the height is.
    """
    from scipy.ndimage import gaussian_filter

    grid, width = task.grid, 0.12  # [m]
    columns, rows = np.rint(grid.to_pixel(task.xy)).astype(int).T
    weights, sums = np.zeros(grid.shape), np.zeros(grid.shape)
    np.add.at(weights, (rows, columns), 1.0)
    np.add.at(sums, (rows, columns), task.heights)
    means = np.divide(sums, weights, out=np.zeros(grid.shape), where=weights > 0)
    blur: Callable[[Array], Array] = partial(
        gaussian_filter, sigma=width / grid.resolution, mode="constant"
    )
    elevation = blur(means) / np.maximum(blur((weights > 0).astype(np.float64)), 1e-12)
    slope_y, slope_x = np.gradient(elevation, grid.resolution)
    return Answer.of_cells(task, elevation.ravel(), slope=np.dstack([slope_x, slope_y]))


@dataclass(frozen=True)
class Method:
    """A peer as tables know it.

    Attributes:
        name: For people.
        solve: Answers a task.
        needs: The module without which it cannot.
        exact: Whether it solves the same equations, to the last digits.
    """

    name: str
    solve: Callable[[Task], Answer]
    needs: str = "numpy"
    exact: bool = False

    @property
    def available(self) -> bool:
        """Whether its library is installed."""
        return find_spec(self.needs) is not None


OURS, DENSE = "gpgrad", "dense, as in the paper"
SKI_QUICK = SkiSettings()
SKI_GOOD = SkiSettings(spacing=0.25, rank=1000, tolerance=1e-4)
SKI_TRIED = tuple(
    SkiSettings(spacing, rank, tolerance)
    for spacing in (0.5, 0.25, 0.125)
    for rank, tolerance in ((100, 1e-2), (100, 1e-4), (1000, 1e-4), (2500, 1e-4))
)
"""Settings among which to look for its best."""

_ALL = [
    Method(OURS, ours),
    Method(DENSE, dense, exact=True),
    Method("scikit-learn", scikit_learn, "sklearn", exact=True),
    Method("GPyTorch exact", gpytorch_exact, "gpytorch", exact=True),
    *(
        Method(settings.name, partial(gpytorch_ski, chosen=settings), "gpytorch")
        for settings in dict.fromkeys([SKI_QUICK, SKI_GOOD, *SKI_TRIED])
    ),
    Method("PyKrige", pykrige, "pykrige", exact=True),
    Method("PyKrige, 100 nearest", partial(pykrige_window, neighbours=100), "pykrige"),
    Method("GSTools", gstools, "gstools", exact=True),
    Method("smoothed grid", smoothed_grid, "scipy"),
]
METHODS = {method.name: method for method in _ALL}
"""All that can be measured, by name."""

PEERS = [
    *(OURS, DENSE, "scikit-learn", "GPyTorch exact", SKI_QUICK.name, SKI_GOOD.name),
    *("PyKrige", "PyKrige, 100 nearest", "GSTools", "smoothed grid"),
]
"""The rows of the table, ours first."""
