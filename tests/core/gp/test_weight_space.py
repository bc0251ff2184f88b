"""A pivot is inverted, or refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.gp.weight_space import NotPositiveDefiniteError, invert_pivot


@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
def test_what_is_positive_definite_is_inverted_and_the_rest_refused(seed: int, size: int) -> None:
    root = np.random.default_rng(seed).normal(size=(size, size))
    matrix = root @ root.T + 0.1 * np.eye(size)
    inverse = invert_pivot(matrix.copy())
    np.testing.assert_allclose(inverse @ matrix, np.eye(size), atol=1e-8)
    np.testing.assert_array_equal(inverse, inverse.T)
    shift = (np.linalg.eigvalsh(matrix)[0] + 0.01) * np.eye(size)
    with pytest.raises(NotPositiveDefiniteError, match="not positive"):
        invert_pivot(matrix - shift)
