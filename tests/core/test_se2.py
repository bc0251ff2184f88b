"""The group of plane motions, and the fit that finds one again."""

import inspect
import os

import jaxtyping
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from gpgrad_core.params import Bounds
from gpgrad_core.se2 import SE2, fit_se2, move_covariance

offsets = st.floats(-100, 100, allow_subnormal=False)
motions = st.builds(SE2, offsets, offsets, st.floats(-np.pi, np.pi))
seeds = st.integers(0, 2**32 - 1)
PROBES = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 3.0], [-7.0, 2.0]])


def assert_same_motion(a: SE2, b: SE2) -> None:
    np.testing.assert_allclose(a.apply(PROBES), b.apply(PROBES), atol=1e-9)


@given(motions, motions)
def test_motions_are_a_group(a: SE2, b: SE2) -> None:
    assert_same_motion(a @ SE2(), a)
    assert_same_motion(SE2() @ a, a)
    assert_same_motion(a @ a.inverse(), SE2())
    assert_same_motion(a.inverse() @ a, SE2())
    np.testing.assert_allclose((a @ b).apply(PROBES), a.apply(b.apply(PROBES)), atol=1e-9)


@given(motions, motions)
def test_yaw_comes_out_within_one_turn(a: SE2, b: SE2) -> None:
    yaw = (a @ b).yaw
    assert -np.pi <= yaw <= np.pi
    np.testing.assert_allclose(np.exp(1j * yaw), np.exp(1j * (a.yaw + b.yaw)), atol=1e-12)


@given(motions)
def test_distances_and_handedness_stay(a: SE2) -> None:
    moved = a.apply(PROBES)
    np.testing.assert_allclose(
        np.linalg.norm(moved[1:] - moved[0], axis=1), np.linalg.norm(PROBES[1:], axis=1), atol=1e-9
    )
    assert np.linalg.det(a.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(a.rotate(PROBES), moved - a.translation, atol=1e-9)


def test_a_quarter_turn_takes_x_to_y() -> None:
    turned = SE2(1.0, 2.0, np.pi / 2).apply(np.array([[1.0, 0.0]]))
    np.testing.assert_allclose(turned, [[1.0, 3.0]], atol=1e-12)


@given(motions, seeds, st.integers(2, 30))
def test_any_motion_is_found_from_exact_pairs(T_target_source: SE2, seed: int, num: int) -> None:
    source = np.random.default_rng(seed).uniform(-5, 5, (num, 2))
    # Two points that all but coincide say nothing about the turn.
    assume(np.ptp(source, axis=0).max() > 1e-3)
    found = fit_se2(source, T_target_source.apply(source))
    # From all points, so also from two: a mirrored fit would put the probes elsewhere.
    expected = T_target_source.apply(PROBES)
    np.testing.assert_allclose(found.apply(PROBES), expected, atol=1e-7 / np.ptp(source))


@given(motions, seeds, st.integers(3, 20))
def test_no_other_motion_fits_better(start: SE2, seed: int, num: int) -> None:
    rng = np.random.default_rng(seed)
    source = rng.uniform(-5, 5, (num, 2))
    target = start.apply(source) + rng.normal(0, 0.5, (num, 2))
    found = fit_se2(source, target)
    mirrored = fit_se2(source, target * [1.0, -1.0])
    assert np.linalg.det(mirrored.rotation) == pytest.approx(1.0)

    def error(motion: SE2) -> float:
        return float(np.sum((motion.apply(source) - target) ** 2))

    for dx, dy, turn in 0.02 * np.vstack([np.eye(3), -np.eye(3)]):
        assert error(found) <= error(SE2(found.x + dx, found.y + dy, found.yaw + turn)) + 1e-9


@pytest.mark.parametrize("nums", [(0, 0), (1, 1), (5, 4)])
def test_too_few_or_unpaired_points_are_refused(nums: tuple[int, int]) -> None:
    # The shape checks of the tests would refuse first; users run without them.
    with pytest.raises(ValueError, match="got {} and {}".format(*nums)):
        inspect.unwrap(fit_se2)(*(np.zeros((num, 2)) for num in nums))


def test_a_covariance_at_another_point_is_that_of_its_errors() -> None:
    shape = np.array([[1.0, 0.0, 0.0], [0.4, 0.8, 0.0], [0.3, -0.5, 0.6]])
    errors = 1e-5 * np.random.default_rng(0).standard_normal((200, 3)) @ shape.T
    arm = np.array([3.0, -7.0])
    swung = np.array([SE2(*error).apply(arm[None])[0] - arm for error in errors.tolist()])
    there = np.column_stack([swung, errors[:, 2]])
    moved = move_covariance(np.cov(errors.T), arm)
    np.testing.assert_allclose(moved, np.cov(there.T), rtol=1e-3, atol=1e-14)


@pytest.mark.skipif(
    os.environ.get("GPGRAD_THOROUGH") != "1", reason="shapes are checked with GPGRAD_THOROUGH=1"
)
def test_wrong_shapes_and_types_are_noticed() -> None:
    for wrong in (np.zeros((5, 3)), np.zeros((5, 2), dtype=np.int64)):
        with pytest.raises(jaxtyping.TypeCheckError, match="points"):
            SE2().apply(wrong)
    assert Bounds(0, 1, 1).round(0) == 0.0  # a whole number is a float
