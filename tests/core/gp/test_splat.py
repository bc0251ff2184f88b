"""Sums of Gaussians between points and nodes, against the sums written out."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.arrays import Array
from gpgrad_core.gp.splat import POINTS_PER_CHUNK, LatticeAxis, Splat
from tests.support.laws import examples

seeds = st.integers(0, 2**32 - 1)


def points_of(seed: int, num: int) -> Array:
    """In any order: how they are sorted is only a matter of speed."""
    return np.random.default_rng(seed).uniform([-3, 10], [2, 30], (num, 2))


def written_out(xy: Array, x: LatticeAxis, y: LatticeAxis, width: float) -> Array:
    """Every Gaussian between every point and node, (n, rows, columns)."""
    dx = xy[:, 0, None, None] - x.nodes
    dy = xy[:, 1, None, None] - y.nodes[:, None]
    return np.exp(-(dx**2 + dy**2) / width**2)


@examples(25)
@given(seeds, st.integers(1, 2 * POINTS_PER_CHUNK + 5), st.floats(0.2, 3.0), st.floats(0.4, 1.0))
def test_both_ways_are_the_sums_written_out(
    seed: int, num: int, width: float, ratio: float
) -> None:
    xy = points_of(seed, num)
    low, high = xy.min(axis=0), xy.max(axis=0)
    x, y = (LatticeAxis.covering(low[k], high[k], ratio * width, 2 * width) for k in (0, 1))
    splat, bumps = Splat(xy, x, y, width, 5.5), written_out(xy, x, y, width)
    rng = np.random.default_rng(seed)
    values, weights = rng.normal(size=num), rng.normal(size=(y.count, x.count))
    np.testing.assert_allclose(
        splat.to_nodes(values), np.einsum("n,nrc->rc", values, bumps), atol=1e-12 * num
    )
    np.testing.assert_allclose(
        splat.to_points(weights), np.einsum("nrc,rc->n", bumps, weights), atol=1e-12 * num
    )


def test_points_far_from_all_nodes_give_nothing() -> None:
    splat = Splat(
        np.array([[500.0, -500.0]]), LatticeAxis(0.0, 1.0, 3), LatticeAxis(0.0, 1.0, 4), 1.0, 5.5
    )
    np.testing.assert_array_equal(splat.to_nodes(np.ones(1)), np.zeros((4, 3)))
    np.testing.assert_array_equal(splat.to_points(np.ones((4, 3))), [0.0])


@given(st.floats(-100, 100), st.floats(0, 50), st.floats(0.05, 5), st.floats(0, 3))
def test_an_axis_reaches_over_its_stretch_and_margins(
    low: float, width: float, spacing: float, margin: float
) -> None:
    axis = LatticeAxis.covering(low, low + width, spacing, margin)
    assert axis.nodes[0] == low - margin
    assert low + width + margin - 1e-9 <= axis.nodes[-1]
    assert axis.nodes[-1] < low + width + margin + 2 * spacing
    np.testing.assert_allclose(np.diff(axis.nodes), spacing, rtol=1e-9)
