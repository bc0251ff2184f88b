"""Block elimination against NumPy on random matrices."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.arrays import Array
from gpgrad_core.gp.weight_space import Factor, NotPositiveDefiniteError, invert_pivot

seeds = st.integers(0, 2**32 - 1)
sizes = st.lists(st.integers(1, 6), min_size=1, max_size=7)


def random_spd(seed: int, size: int) -> Array:
    root = np.random.default_rng(seed).normal(size=(size, size))
    return root @ root.T + 0.1 * np.eye(size)


def random_block_tridiagonal(seed: int, sizes: list[int]) -> tuple[Array, list[slice]]:
    rng = np.random.default_rng(seed)
    edges = np.concatenate([[0], np.cumsum(sizes)])
    blocks = [slice(int(a), int(b)) for a, b in pairwise(edges)]
    matrix = np.zeros((edges[-1], edges[-1]))
    for first, second in zip(blocks, [*blocks[1:], slice(0, 0)], strict=True):
        rows = np.r_[first, second]
        root = rng.normal(size=(len(rows), len(rows) + 2))
        matrix[np.ix_(rows, rows)] += root @ root.T  # each adds a positive part of two blocks
    return matrix, blocks


def factorise(matrix: Array, blocks: list[slice]) -> Factor:
    factor = Factor([], [])
    pivot = matrix[blocks[0], blocks[0]].copy()
    for i, block in enumerate(blocks):
        factor.inverses.append(invert_pivot(pivot))
        if i + 1 < len(blocks):
            below = matrix[blocks[i + 1], block]
            factor.gains.append(below @ factor.inverses[i])
            pivot = matrix[blocks[i + 1], blocks[i + 1]] - factor.gains[i] @ below.T
    return factor


@given(seeds, st.integers(1, 40))
def test_a_pivot_is_inverted(seed: int, size: int) -> None:
    matrix = random_spd(seed, size)
    inverse = invert_pivot(matrix.copy())
    np.testing.assert_allclose(inverse @ matrix, np.eye(size), atol=1e-8)
    np.testing.assert_array_equal(inverse, inverse.T)


@given(seeds, st.integers(1, 20))
def test_what_is_not_positive_definite_is_refused(seed: int, size: int) -> None:
    matrix = random_spd(seed, size)
    shift = (np.linalg.eigvalsh(matrix)[0] + 0.01) * np.eye(size)
    with pytest.raises(NotPositiveDefiniteError, match="not positive"):
        invert_pivot(matrix - shift)


@given(seeds, sizes)
def test_solutions_and_blocks_of_the_inverse_are_numpys(seed: int, sizes: list[int]) -> None:
    matrix, blocks = random_block_tridiagonal(seed, sizes)
    factor, inverse = factorise(matrix, blocks), np.linalg.inv(matrix)
    right = np.random.default_rng(seed + 1).normal(size=len(matrix))
    solution = np.concatenate(factor.solve([right[block] for block in blocks]))
    np.testing.assert_allclose(solution, np.linalg.solve(matrix, right), rtol=1e-6, atol=1e-8)
    found = list(factor.inverse_blocks())
    assert [i for i, _, _ in found] == list(reversed(range(len(blocks))))
    for i, diagonal, below in found:
        np.testing.assert_allclose(diagonal, inverse[blocks[i], blocks[i]], rtol=1e-6, atol=1e-8)
        assert (below is None) == (i + 1 == len(blocks))
        if below is not None:
            expected = inverse[blocks[i + 1], blocks[i]]
            np.testing.assert_allclose(below, expected, rtol=1e-6, atol=1e-8)
