"""The fast GP, by either solver, against the dense oracle and its own promises."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

from gpgrad_core.errors import InputError
from gpgrad_core.gp import solution
from gpgrad_core.gp.inference import SolverName as Name
from gpgrad_core.gp.inference import fit_gp
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.lattice import LatticePosterior
from gpgrad_core.gp.tiles import TilePosterior
from gpgrad_core.run import Cancelled
from gpgrad_core.types import Grid
from tests.core.gp.oracle import Fields, compare, grid_beyond, rms
from tests.support.ground import cloud
from tests.support.laws import examples
from tests.support.refusal import assert_refused

seeds = st.integers(0, 2**32 - 1)
SOLVERS: list[Name] = ["lattice", "tiles"]
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
    points, kernel = cloud(8, 200, (2.0, 2.0)), SquaredExponential(0.1, 0.3)
    points[:, 2] = 3.5
    posterior = fit_gp(points, kernel, 0.05, solver=solver)
    elevation, variance, slope = posterior.sample(Grid((0.0, 0.0), 0.1, (20, 20)))
    np.testing.assert_array_equal(elevation, 3.5)
    np.testing.assert_array_equal(slope, 0.0)
    assert variance.max() < 0.1**2


# --- progress and refusals ----------------------------------------------------------------


@pytest.mark.parametrize("solver", SOLVERS)
def test_progress_rises_to_one(solver: Name) -> None:
    heard: list[float] = []
    points, kernel = cloud(7, 900, WIDE), SquaredExponential(0.2, 0.3)
    fit_gp(points, kernel, 0.05, progress=heard.append, solver=solver)
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
@given(seed=seeds, kind=st.sampled_from(["even", "doubled", "two clusters", "nearly a line"]))
def test_no_parameters_within_bounds_crash_it_or_give_nonsense(
    solver: Name, seed: int, kind: str
) -> None:
    rng = np.random.default_rng(seed)
    num, side = int(rng.integers(3, 121)), 10 ** float(rng.uniform(-1, 1.3))
    length_scale = float(np.clip(side * 10 ** rng.uniform(-1.3, 2), 0.01, 100))
    log_noise, log_signal = rng.uniform([np.log10(0.0005), -3], [1, 3]).tolist()
    points = rng.uniform(0, side, (num, 3))
    if kind == "doubled":
        points = np.repeat(points, 3, axis=0)
    elif kind == "two clusters":
        points[num // 2 :, :2] += 20 * side
    elif kind == "nearly a line":  # but for a millimetre
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


@examples(4)
@given(seed=seeds, length_scale=st.floats(0.25, 0.5))
def test_there_is_no_seam_between_strips(seed: int, length_scale: float) -> None:
    points = cloud(seed, 1600, WIDE, noise=0.03, holes=8)
    kernel = SquaredExponential(0.2, length_scale)
    posterior = fit_gp(points, kernel, 0.03, solver="lattice")
    seams = [strip.high for strip in posterior.strips[:-1]]
    assert seams == [strip.low for strip in posterior.strips[1:]]
    assert (posterior.strips[0].low, posterior.strips[-1].high) == (-np.inf, np.inf)
    steep = rms(posterior.sample(grid_beyond(points, 0.0, 0.1))[2])
    for seam in seams:
        # Two columns a hair apart, one of either strip.
        left, right = (
            Fields.fast(posterior, Grid((seam + off, 0.0), 0.1, (21, 1))) for off in (-1e-7, 1e-7)
        )
        assert rms(right.elevation - left.elevation) <= 0.03 * 0.03
        assert rms(right.slope - left.slope) <= 0.02 * steep
        assert np.abs(right.std / left.std - 1).max() <= 0.04


# --- refusals ----


def test_too_many_nodes_are_refused_with_their_number_and_the_cure() -> None:
    points = cloud(0, 200, (400.0, 300.0))
    points[:2, :2] = [[0.0, 0.0], [400.0, 300.0]]
    assert_refused(
        lambda: fit_gp(points, SquaredExponential(0.2, 0.02), 0.05, solver="lattice"),
        *("0.02 m is too short", "400 m x 300 m", "nodes", "raise", "cut the cloud"),
    )


@pytest.mark.parametrize(
    ("length_scale", "signal_std", "noise"), [(2.0, 800.0, 0.001), (100.0, 10.0, 0.0005)]
)
def test_what_rounding_cannot_solve_is_refused_with_the_cure(
    length_scale: float, signal_std: float, noise: float
) -> None:
    points, kernel = (
        cloud(0, 600, (8.0, 8.0), noise=0.5),
        SquaredExponential(signal_std, length_scale),
    )
    assert_refused(
        lambda: fit_gp(points, kernel, noise, solver="lattice"),
        *("noise", "raise", "lower the length-scale"),
    )


def test_what_costs_too_much_is_refused_and_each_cure_helps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(solution, "MOST_SECONDS", 0.075)
    points = cloud(0, 2000, (10.0, 10.0))
    with pytest.raises(InputError, match=r"2,000 points on .* would take about") as caught:
        fit_gp(points, SquaredExponential(0.2, 0.2), 0.05)
    longer = float(str(caught.value).split("length-scale to ")[1].split(" m")[0])
    fewer = int(str(caught.value).split("max_points to ")[1].split(" ")[0].replace(",", ""))
    fit_gp(points, SquaredExponential(0.2, longer), 0.05)
    fit_gp(points[:fewer], SquaredExponential(0.2, 0.2), 0.05)
