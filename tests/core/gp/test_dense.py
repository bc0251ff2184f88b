"""The oracle itself, against scikit-learn and against finite differences."""

import warnings

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.gp.kernel import SquaredExponential
from tests.support.dense import fit_dense, infer_elevation, infer_slope, infer_variance
from tests.support.ground import cloud
from tests.support.laws import examples

seeds = st.integers(0, 2**32 - 1)
kernels = st.builds(SquaredExponential, st.floats(0.05, 1), st.floats(0.1, 1))


@examples(12)
@given(seeds, kernels, st.floats(0.01, 0.1), st.booleans())
def test_mean_and_std_are_scikit_learns(
    seed: int, kernel: SquaredExponential, noise: float, each_its_own: bool
) -> None:
    # It takes a second to load, and all test processes import this module.
    from sklearn.exceptions import ConvergenceWarning  # noqa: PLC0415
    from sklearn.gaussian_process import GaussianProcessRegressor  # noqa: PLC0415
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel  # noqa: PLC0415

    points = cloud(seed, 120, (3.0, 3.0), noise=noise)
    rng = np.random.default_rng(seed)
    noise_std = noise * rng.uniform(0.5, 3, len(points)) if each_its_own else noise
    queries = rng.uniform(-0.5, 3.5, (60, 2))
    theirs = GaussianProcessRegressor(
        ConstantKernel(kernel.signal_std**2, "fixed") * RBF(kernel.length_scale, "fixed"),
        alpha=noise_std**2,
        optimizer=None,
    )
    mean = points[:, 2].mean()
    with warnings.catch_warnings():
        warnings.simplefilter("error", ConvergenceWarning)
        theirs.fit(points[:, :2], points[:, 2] - mean)
        elevation, std = theirs.predict(queries, return_std=True)
    ours = fit_dense(points, kernel, noise_std)
    np.testing.assert_allclose(infer_elevation(ours, queries), elevation + mean, atol=1e-8)
    np.testing.assert_allclose(
        infer_variance(ours, queries), std**2, rtol=1e-6, atol=1e-9 * kernel.signal_std**2
    )


@examples(12)
@given(seeds, kernels, st.floats(0.02, 0.1))
def test_slope_is_the_derivative_of_elevation(
    seed: int, kernel: SquaredExponential, noise: float
) -> None:
    posterior = fit_dense(cloud(seed, 150, (3.0, 3.0), noise=noise), kernel, noise)
    queries = np.random.default_rng(seed).uniform(-0.5, 3.5, (40, 2))
    step = 1e-4 * kernel.length_scale
    slope = infer_slope(posterior, queries)
    for axis, shift in enumerate(step * np.eye(2)):
        ahead, behind = (infer_elevation(posterior, queries + s) for s in (shift, -shift))
        np.testing.assert_allclose(slope[:, axis], (ahead - behind) / (2 * step), atol=1e-5)
