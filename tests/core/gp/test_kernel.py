"""The kernel of Eq. (6) and its derivative."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.gp.kernel import SquaredExponential

seeds = st.integers(0, 2**32 - 1)
kernels = st.builds(SquaredExponential, st.floats(0.01, 10), st.floats(0.05, 5))


def test_it_falls_as_the_paper_has_it() -> None:
    kernel = SquaredExponential(signal_std=2.0, length_scale=0.5)
    origin = np.zeros((1, 2))
    at = np.array([[0.0, 0.0], [0.5, 0.0], [0.3, 0.4], [0.0, 1.0]])
    np.testing.assert_allclose(kernel(origin, at)[0], 4 * np.exp([0.0, -0.5, -0.5, -2.0]))


@given(kernels, seeds)
def test_it_is_a_covariance(kernel: SquaredExponential, seed: int) -> None:
    xy = np.random.default_rng(seed).uniform(-3, 3, (15, 2))
    covariance = kernel(xy, xy)
    np.testing.assert_allclose(covariance, covariance.T)
    np.testing.assert_allclose(np.diag(covariance), kernel.signal_std**2)
    assert np.linalg.eigvalsh(covariance).min() > -1e-9 * kernel.signal_std**2 * len(xy)


@given(kernels, seeds)
def test_its_derivative_is_its_finite_difference(kernel: SquaredExponential, seed: int) -> None:
    a, b = np.random.default_rng(seed).uniform(-1, 1, (2, 6, 2)) * 2 * kernel.length_scale
    step = 1e-4 * kernel.length_scale
    for axis, shift in enumerate(step * np.eye(2)):
        difference = (kernel(a + shift, b) - kernel(a - shift, b)) / (2 * step)
        steepest = kernel.signal_std**2 / kernel.length_scale
        assert kernel.gradient(a, b)[axis] == pytest.approx(difference, abs=1e-6 * steepest)
