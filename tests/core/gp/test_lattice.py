"""What is the lattice's own: strips, bins, and what it refuses."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.errors import InputError
from gpgrad_core.gp.cloud import bin_points
from gpgrad_core.gp.inference import fit_gp
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.types import Grid
from tests.core.gp.oracle import Fields, compare, grid_beyond, rms
from tests.support.ground import cloud
from tests.support.laws import examples

seeds = st.integers(0, 2**32 - 1)

WIDE = (24.0, 2.0)


@pytest.mark.slow
def test_a_wide_cloud_is_the_oracle_too_in_every_strip() -> None:
    points = cloud(5, 1600, WIDE, noise=0.03, holes=8)
    kernel = SquaredExponential(0.2, 0.3)
    assert len(fit_gp(points, kernel, 0.03, solver="lattice").strips) >= 4
    errors = compare(points, kernel, 0.03, grid_beyond(points, 0.3, 0.15))
    assert errors.elevation <= 0.01
    assert errors.slope <= 0.01
    assert errors.std <= 0.04


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


# --- bins ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_bins_of_an_eighth_of_a_length_scale_cost_little() -> None:
    length_scale = 0.5
    points = cloud(9, 2500, (2.0, 1.5), noise=0.03)
    kernel = SquaredExponential(float(points[:, 2].std()), length_scale)
    grid = Grid((0.0, 0.0), 0.1, (16, 21))
    assert len(bin_points(points, length_scale / 8)[0]) < 0.7 * len(points)
    errors = compare(points, kernel, 0.03, grid, binned_to=length_scale / 8)
    assert errors.elevation <= 0.03
    assert errors.slope <= 0.03
    assert errors.std <= 0.05


# --- refusals ----


def test_too_many_nodes_are_refused_with_their_number_and_the_cure() -> None:
    points = cloud(0, 200, (400.0, 300.0))
    points[:2, :2] = [[0.0, 0.0], [400.0, 300.0]]
    with pytest.raises(InputError) as caught:
        fit_gp(points, SquaredExponential(0.2, 0.02), 0.05, solver="lattice")
    message = str(caught.value)
    for part in ("0.02 m is too short", "400 m x 300 m", "nodes", "raise", "cut the cloud"):
        assert part in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("length_scale", "signal_std", "noise"), [(2.0, 800.0, 0.001), (100.0, 10.0, 0.0005)]
)
def test_what_rounding_cannot_solve_is_refused_with_the_cure(
    length_scale: float, signal_std: float, noise: float
) -> None:
    points = cloud(0, 600, (8.0, 8.0), noise=0.5)
    with pytest.raises(InputError) as caught:
        fit_gp(points, SquaredExponential(signal_std, length_scale), noise, solver="lattice")
    message = str(caught.value)
    for part in ("noise", "raise", "lower the length-scale"):
        assert part in message
    assert "\n" not in message
