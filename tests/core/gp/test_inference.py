"""The fast GP, by either solver, against the dense oracle and its own promises."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

from gpgrad_core.errors import InputError
from gpgrad_core.gp.inference import SolverName as Name
from gpgrad_core.gp.inference import fit_gp
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.lattice import LatticePosterior
from gpgrad_core.gp.tiles import TilePosterior
from gpgrad_core.run.progress import Cancelled
from gpgrad_core.types import Grid
from tests.core.gp.oracle import Fields, compare, grid_beyond, rms
from tests.support.ground import cloud
from tests.support.laws import examples

seeds = st.integers(0, 2**32 - 1)
SOLVERS: list[Name] = ["lattice", "tiles"]
either_solver = st.sampled_from(SOLVERS)
WIDE = (24.0, 2.0)


@pytest.mark.parametrize("noise", [0.02, 0.05])
@pytest.mark.parametrize("length_scale", [0.1, 0.2, 0.3, 0.5, 1.0])
def test_it_is_the_oracle_on_usual_ground(length_scale: float, noise: float) -> None:
    points = cloud(3, 800, (3.6, 3.6), noise=noise, holes=2)
    kernel = SquaredExponential(float(points[:, 2].std()), length_scale)
    grid = grid_beyond(points, 0.5, 0.15)
    exact = Fields.dense(points, kernel, noise, grid)  # once: it is what takes long
    for solver in SOLVERS:
        errors = compare(points, kernel, noise, grid, solver, exact=exact)
        # What is asked for is 1 %, 0.5 %, 2 % where trusted and 5 % anywhere.
        assert errors.elevation <= 0.01, solver
        assert errors.slope <= 0.005, solver
        assert errors.std <= 0.02, solver
        assert errors.std_anywhere <= 0.05, solver
        assert errors.slope_std <= 0.05, solver
        assert errors.num_trusted > 50


@pytest.mark.nightly
@pytest.mark.parametrize("solver", SOLVERS)
@examples(15)
@given(
    seed=seeds,
    num=st.integers(20, 900),
    length_scale=st.floats(0.1, 1.0),
    noise=st.floats(0.02, 0.1),
    signal_std=st.floats(0.05, 0.4),
    holes=st.integers(0, 6),
    resolution=st.floats(0.1, 0.3),
    beyond=st.floats(0.0, 2.0),
)
def test_it_is_the_oracle_at_any_parameters(
    solver: Name,
    seed: int,
    num: int,
    length_scale: float,
    noise: float,
    signal_std: float,
    holes: int,
    resolution: float,
    beyond: float,
) -> None:
    points = cloud(seed, num, (4.0, 3.0), noise=noise, holes=holes)
    kernel = SquaredExponential(signal_std, length_scale)
    errors = compare(points, kernel, noise, grid_beyond(points, beyond, resolution), solver)
    assert errors.elevation <= 0.02
    assert errors.slope <= 0.02
    assert errors.std <= 0.05


@pytest.mark.nightly
@pytest.mark.parametrize("solver", SOLVERS)
@examples(6)
@given(seed=seeds, length_scale=st.floats(0.15, 0.8), spread=st.floats(1.0, 5.0))
@example(seed=0, length_scale=0.75, spread=2.0)  # 1.6 % off, once: the solver stopped too early
@example(seed=59, length_scale=0.15, spread=5.0)
def test_each_point_may_have_its_own_noise(
    solver: Name, seed: int, length_scale: float, spread: float
) -> None:
    rng = np.random.default_rng(seed)
    noise = 0.02 * spread ** rng.random(600)
    points = cloud(seed, 600, (4.0, 3.0), noise=noise)
    errors = compare(
        points, SquaredExponential(0.2, length_scale), noise, grid_beyond(points, 0.3, 0.2), solver
    )
    assert errors.elevation <= 0.01
    assert errors.slope <= 0.01
    assert errors.std <= 0.04


@pytest.mark.parametrize("solver", SOLVERS)
def test_far_beyond_the_points_the_prior_holds_exactly(solver: Name) -> None:
    points = cloud(0, 300, (2.0, 2.0)) + np.array([0.0, 0.0, 50.0])
    posterior = fit_gp(points, SquaredExponential(0.2, 0.3), 0.05, solver=solver)
    grid = Grid((20.0, -30.0), 0.5, (4, 5))
    elevation, variance, slope = posterior.sample(grid)
    np.testing.assert_array_equal(elevation, points[:, 2].mean())
    np.testing.assert_array_equal(variance, 0.2**2)
    np.testing.assert_array_equal(slope, 0.0)
    np.testing.assert_array_equal(posterior.sample_slope_variance(grid), (0.2 / 0.3) ** 2)


@pytest.mark.parametrize("solver", SOLVERS)
def test_two_clusters_far_apart_are_the_oracle_and_the_prior_lies_between(solver: Name) -> None:
    near = cloud(6, 250, (2.0, 2.0))
    points = np.vstack([near, near + np.array([300.0, 20.0, 0.3])])
    kernel = SquaredExponential(0.3, 0.4)
    posterior = fit_gp(points, kernel, 0.03, solver=solver)
    assert posterior.sample(Grid((150.0, 0.0), 1.0, (2, 2)))[1] == pytest.approx(0.09)
    for x, y in ((-0.3, -0.3), (299.7, 19.7)):
        errors = compare(points, kernel, 0.03, Grid((x, y), 0.1, (27, 27)), solver)
        assert errors.elevation <= 0.01
        assert errors.slope <= 0.01
        assert errors.std <= 0.04


# --- laws ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
@examples(10)
@given(seed=seeds, length_scale=st.floats(0.15, 1.0), noise=st.floats(0.02, 0.1))
def test_slope_is_the_derivative_of_elevation(
    solver: Name, seed: int, length_scale: float, noise: float
) -> None:
    points = cloud(seed, 400, (3.0, 3.0), noise=noise)
    posterior = fit_gp(points, SquaredExponential(0.2, length_scale), noise, solver=solver)
    step = 1e-3 * length_scale
    grid = Grid((-0.5, -0.5), 0.2, (20, 20))
    slope = posterior.sample(grid)[2]
    for axis, (dx, dy) in enumerate(step * np.eye(2)):
        ahead, behind = (
            posterior.sample(Grid((-0.5 + k * dx, -0.5 + k * dy), 0.2, (20, 20)))[0]
            for k in (1, -1)
        )
        difference = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(slope[..., axis], difference, atol=1e-4 * rms(slope))


@pytest.mark.parametrize("solver", SOLVERS)
@examples(10)
@given(seed=seeds)
def test_permuting_the_points_changes_nothing_beyond_rounding(solver: Name, seed: int) -> None:
    points = cloud(seed, 500, (3.0, 3.0))
    shuffled = np.random.default_rng(seed).permutation(points)
    kernel, grid = SquaredExponential(0.2, 0.3), Grid((0.0, 0.0), 0.2, (16, 16))
    a, b = (fit_gp(p, kernel, 0.05, solver=solver).sample(grid) for p in (points, shuffled))
    # What the solver leaves of the heights, 1 % of their noise, is itself rounded differently.
    rounding = 1e-3 * 0.05
    np.testing.assert_allclose(a[0], b[0], atol=rounding)
    np.testing.assert_allclose(a[1], b[1], rtol=1e-5)
    np.testing.assert_allclose(a[2], b[2], atol=rounding / kernel.length_scale)


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
@examples(10)
@given(seed=seeds, offset=st.tuples(*[st.floats(-1000, 1000)] * 3))
def test_moving_the_points_moves_the_map(
    solver: Name, seed: int, offset: tuple[float, float, float]
) -> None:
    points = cloud(seed, 300, (3.0, 3.0))
    kernel = SquaredExponential(0.2, 0.3)
    here = fit_gp(points, kernel, 0.05, solver=solver).sample(Grid((0.0, 0.0), 0.2, (16, 16)))
    there = fit_gp(points + np.array(offset), kernel, 0.05, solver=solver).sample(
        Grid(offset[:2], 0.2, (16, 16))
    )
    # What the solver leaves of the heights, 1 % of their noise, is itself rounded differently.
    rounding = 1e-3 * 0.05
    np.testing.assert_allclose(there[0] - offset[2], here[0], atol=rounding)
    # Coordinates of 1 km cost digits, and variances are worked out with half of them.
    np.testing.assert_allclose(there[1], here[1], rtol=1e-3)
    np.testing.assert_allclose(there[2], here[2], atol=rounding)


@pytest.mark.parametrize("solver", SOLVERS)
def test_one_and_two_threads_give_the_same_bits(
    solver: Name, monkeypatch: pytest.MonkeyPatch
) -> None:
    points, kernel = cloud(7, 900, WIDE), SquaredExponential(0.2, 0.3)
    grid = grid_beyond(points, 0.2, 0.1)
    results = []
    for threads in ("1", "2"):
        monkeypatch.setenv("GPGRAD_THREADS", threads)
        results.append(fit_gp(points, kernel, 0.05, solver=solver).sample(grid))
    for one, two in zip(*results, strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("solver", SOLVERS)
def test_flat_ground_is_flat(solver: Name) -> None:
    points = cloud(8, 200, (2.0, 2.0))
    points[:, 2] = 3.5
    elevation, variance, slope = fit_gp(
        points, SquaredExponential(0.1, 0.3), 0.05, solver=solver
    ).sample(Grid((0.0, 0.0), 0.1, (20, 20)))
    np.testing.assert_array_equal(elevation, 3.5)
    np.testing.assert_array_equal(slope, 0.0)
    assert variance.max() < 0.1**2


# --- progress and refusals ----------------------------------------------------------------


@pytest.mark.parametrize("solver", SOLVERS)
def test_progress_rises_to_one(solver: Name) -> None:
    heard: list[float] = []
    fit_gp(
        cloud(7, 900, WIDE),
        SquaredExponential(0.2, 0.3),
        0.05,
        progress=heard.append,
        solver=solver,
    )
    assert len(heard) > 1
    assert heard == sorted(heard)
    assert heard[0] > 0
    assert heard[-1] == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("after", [0, 4])
def test_cancelling_stops_the_work_and_leaves_blas_as_it_was(solver: Name, after: int) -> None:
    calls: list[float] = []

    def stop(fraction: float) -> None:
        calls.append(fraction)
        if len(calls) > after:
            raise Cancelled

    def blas_threads() -> list[int]:
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    points, kernel = cloud(7, 900, WIDE), SquaredExponential(0.2, 0.1)
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        assert 2 in before  # some wheels bring a further BLAS, built for one thread
        with pytest.raises(Cancelled):
            fit_gp(points, kernel, 0.05, progress=stop, solver=solver)
        assert blas_threads() == before
    assert len(calls) == after + 1  # nothing goes on to ask after it was told to stop
    fit_gp(points, kernel, 0.05, solver=solver)  # and the next fit is none the worse


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
@examples(40)
@given(
    seed=seeds,
    num=st.integers(3, 120),
    kind=st.sampled_from(["even", "doubled", "two clusters", "a line but for a millimetre"]),
    log_side=st.floats(-1, 1.3),
    length_in_sides=st.floats(-1.3, 2),
    log_noise=st.floats(np.log10(0.0005), 1),
    log_signal=st.floats(-3, 3),
)
def test_no_parameters_within_bounds_crash_it_or_give_nonsense(
    solver: Name,
    seed: int,
    num: int,
    kind: str,
    log_side: float,
    length_in_sides: float,
    log_noise: float,
    log_signal: float,
) -> None:
    rng = np.random.default_rng(seed)
    side = 10**log_side
    length_scale = float(np.clip(side * 10**length_in_sides, 0.01, 100))
    points = rng.uniform(0, side, (num, 3))
    if kind == "doubled":
        points = np.repeat(points, 3, axis=0)
    elif kind == "two clusters":
        points[num // 2 :, :2] += 20 * side
    elif kind == "a line but for a millimetre":
        points[:, int(rng.integers(2))] *= 1e-3 / side
    kernel = SquaredExponential(10**log_signal, length_scale)
    try:
        posterior = fit_gp(points, kernel, 10**log_noise, solver=solver)
    except InputError as error:
        assert "\n" not in str(error)  # noqa: PT017 - either outcome is right
        return
    grid = grid_beyond(points, side / 5, side / 10)
    fields = posterior.sample(grid)
    slope_variance = posterior.sample_slope_variance(grid)
    for field in (*fields, slope_variance):
        assert np.isfinite(field).all()
    assert fields.variance.min() > 0
    assert fields.variance.max() <= kernel.signal_std**2
    assert slope_variance.min() > 0
    assert slope_variance.max() <= kernel.slope_std**2


@pytest.mark.parametrize(
    ("num", "length_scale", "kind"),
    [(300, 0.1, TilePosterior), (5000, 0.3, LatticePosterior), (1000, 0.1, TilePosterior)],
)
def test_sparse_clouds_go_to_the_tiles(num: int, length_scale: float, kind: type) -> None:
    points = cloud(0, num, (4.0, 4.0))
    assert isinstance(fit_gp(points, SquaredExponential(0.2, length_scale), 0.05), kind)
