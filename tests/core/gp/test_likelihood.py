"""The likelihood against scikit-learn's, its gradient against finite differences, its patches."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.gp.likelihood import (
    JITTER,
    PATCH_POINTS,
    Hyperparameters,
    Patch,
    draw_patches,
    log_marginal_likelihood,
)
from gpgrad_core.se2 import SE2
from tests.support.ground import cloud
from tests.support.laws import examples

seeds = st.integers(0, 2**32 - 1)
hyperparameters = st.builds(
    Hyperparameters, st.floats(0.05, 5), st.floats(0.02, 2), st.floats(0.3, 3)
)


def patch(seed: int, num: int = 60, *, has_trend: bool = False) -> Patch:
    """A patch of which each point has its own noise, about 3 cm."""
    points = cloud(seed, num, (2.0, 2.0))
    noise = 0.03 * np.random.default_rng(seed).uniform(0.5, 2, num)
    heights = points[:, 2] - points[:, 2].mean()
    return Patch(points[:, :2], heights, noise, has_trend=has_trend)


@examples(25)
@given(seed=seeds, at=hyperparameters, has_trend=st.booleans())
def test_it_is_scikit_learns(seed: int, at: Hyperparameters, *, has_trend: bool) -> None:
    # It takes a second to load, and all test processes import this module.
    from sklearn.gaussian_process import GaussianProcessRegressor  # noqa: PLC0415
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct  # noqa: PLC0415

    ours = patch(seed, has_trend=has_trend)
    kernel = ConstantKernel(at.signal_std**2) * RBF(at.length_scale)
    if has_trend:  # a height of 3 m and slopes of 1, about the middle
        kernel += DotProduct(sigma_0=3.0)
    noise = (at.noise_std * ours.point_noise_std) ** 2 + JITTER * at.signal_std**2
    theirs = GaussianProcessRegressor(kernel, alpha=noise, optimizer=None)
    theirs.fit(ours.xy - ours.xy.mean(axis=0), ours.heights)
    found = log_marginal_likelihood(ours, at)
    value = theirs.log_marginal_likelihood(kernel.theta)
    assert found.value == pytest.approx(value, rel=1e-8, abs=1e-6)
    assert log_marginal_likelihood(ours, at, gradient=False).value == found.value


@examples(25)
@given(seed=seeds, at=hyperparameters, has_trend=st.booleans())
def test_its_gradient_is_its_slope(seed: int, at: Hyperparameters, *, has_trend: bool) -> None:
    one = patch(seed, has_trend=has_trend)
    gradient = log_marginal_likelihood(one, at).gradient
    for k, step in enumerate(1e-5 * np.eye(3)):
        ahead, behind = (
            log_marginal_likelihood(one, Hyperparameters.from_logs(at.logs + s)).value
            for s in (step, -step)
        )
        assert gradient[k] == pytest.approx((ahead - behind) / 2e-5, rel=1e-4, abs=1e-3)


def test_points_upon_each_other_without_noise_can_be_judged() -> None:
    one = patch(0)
    doubled = Patch(np.tile(one.xy, (2, 1)), np.tile(one.heights, 2), np.full(120, 1e-9))
    found = log_marginal_likelihood(doubled, Hyperparameters(0.3, 0.2, 1.0))
    assert np.isfinite(found.value)
    assert np.isfinite(found.gradient).all()
    assert np.isfinite(found.information).all()


SIZE = 10.0


@pytest.fixture(scope="module")
def xy() -> np.ndarray:
    return np.random.default_rng(0).uniform(0, SIZE, (20_000, 2))


def draw(xy: np.ndarray, radius: float = 0.0, seed: int = 0) -> list[np.ndarray]:
    return draw_patches(xy, 16, radius, np.random.default_rng(seed))


def test_dense_ones_leave_no_point_out(xy: np.ndarray) -> None:
    patches = draw(xy)
    assert len(patches) == 16
    assert len({tuple(xy[rows].mean(axis=0) > SIZE / 2) for rows in patches}) == 4
    for rows in patches:
        assert len(set(rows)) == PATCH_POINTS
        centre = xy[rows[0]]  # nearest first
        distances = np.hypot(*(xy - centre).T)
        assert np.sum(distances <= distances[rows].max()) == PATCH_POINTS


def test_wide_ones_reach_as_far_as_asked(xy: np.ndarray) -> None:
    for rows in draw(xy, 2.0):
        assert len(set(rows)) == PATCH_POINTS
        sides = np.ptp(xy[rows], axis=0)
        assert sides.max() > 1.9  # at a corner of the cloud it is a quarter of a disc
        assert sides.max() <= 4.0


def test_a_cloud_of_few_points_is_not_used_over_and_over(xy: np.ndarray) -> None:
    assert len(draw(xy[:1000])) == 4
    (rows,) = draw(xy[:300])
    assert sorted(rows) == list(range(300))


def test_same_seed_same_patches(xy: np.ndarray) -> None:
    for a, b in zip(draw(xy, 1.5, 3), draw(xy, 1.5, 3), strict=True):
        np.testing.assert_array_equal(a, b)
    assert any((a != b).any() for a, b in zip(draw(xy, 1.5, 3), draw(xy, 1.5, 4), strict=True))


def test_patches_depend_neither_on_the_frame_nor_on_rounding(xy: np.ndarray) -> None:
    turned = SE2(60.0, -300.0, 1.34).apply(xy)
    rounded = turned.astype(np.float32).astype(float)
    for there, most in ((turned, 0), (rounded, 2)):
        for one, other in zip(draw(xy), draw(there), strict=True):
            assert len(set(one) - set(other)) <= most  # at the edge of a patch
