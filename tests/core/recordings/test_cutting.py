"""Where submaps end: at the first of the limits, and nothing is left over."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.trajectory import Poses, cut
from tests.support.laws import examples
from tests.support.refusal import assert_refused


def drive(xy: np.ndarray, yaw: np.ndarray | float = 0.0) -> Poses:
    turn = Rotation.from_rotvec(np.outer(np.broadcast_to(yaw, len(xy)), [0.0, 0.0, 1.0]))
    return Poses(np.column_stack([xy, np.zeros(len(xy))]), turn)


def straight(length: float, step: float) -> Poses:
    along = np.arange(0.0, length, step)
    return drive(np.column_stack([along, np.zeros(len(along))]))


@examples(20)
@given(
    seed=st.integers(0, 2**32 - 1),
    max_length=st.floats(0.3, 10.0),
    max_time=st.one_of(st.none(), st.floats(0.5, 20.0)),
)
def test_every_scan_is_in_one_submap(seed: int, max_length: float, max_time: float | None) -> None:
    rng = np.random.default_rng(seed)
    poses = drive(np.cumsum(rng.normal(0, 0.2, (80, 2)), axis=0))
    stamps = np.cumsum(rng.uniform(0.01, 0.5, 80))
    params = BuildParams(max_length=max_length, max_time=max_time)
    pieces = cut(stamps, poses, params)
    assert [k for piece in pieces for k in piece] == list(range(80))
    assert all(len(piece) for piece in pieces)
    steps = np.linalg.norm(np.diff(poses.translation, axis=0), axis=1)
    for piece in pieces:
        # Up to its last scan nothing was reached.
        assert steps[piece.start : piece.stop - 1].sum() < max_length + 80 * 0.05
        if max_time is not None:
            assert stamps[piece.stop - 1] - stamps[piece.start] < max_time


@pytest.mark.parametrize(
    ("params", "stamps", "poses", "starts"),
    [
        (BuildParams(max_length=2.5), np.arange(100.0), straight(10.0, 0.1), [0, 25, 50, 75]),
        (
            BuildParams(max_length=None, max_turn=0.8),
            np.arange(25.0),
            drive(np.zeros((25, 2)), np.linspace(3.0, 3.0 + 2.4, 25)),  # passes through pi
            [0, 8, 16, 24],
        ),
        (
            BuildParams(max_length=None, max_time=2.0),
            np.arange(0.0, 5.0, 0.5),
            straight(5.0, 0.5),
            [0, 4, 8],
        ),
    ],
    ids=["length", "turn", "time"],
)
def test_each_limit_ends_a_submap(
    params: BuildParams, stamps: np.ndarray, poses: Poses, starts: list[int]
) -> None:
    assert [piece.start for piece in cut(stamps, poses, params)] == starts


def test_a_robot_that_stands_still_drives_nowhere() -> None:
    """Poses tremble by a centimetre at 10 Hz: in an hour that adds up to hundreds of metres."""
    rng = np.random.default_rng(0)
    poses = drive(rng.normal(0, 0.005, (3000, 2)))
    assert len(cut(np.arange(3000.0), poses, BuildParams(max_length=1.0))) == 1


def test_cut_by_uncertainty() -> None:
    """Variance grows by 1 cm² a scan: its root by 5 cm every 25."""
    variance = 1e-4 * np.arange(100.0)
    covariance = variance[:, None, None] * np.diag([0.3, 1.0, 0.2])
    params = BuildParams(max_length=None, max_uncertainty=0.05)
    pieces = cut(np.arange(100.0), straight(10.0, 0.1), params, covariance)
    assert [piece.start for piece in pieces] == [0, 25, 50, 75]
    assert_refused(
        lambda: cut(np.arange(100.0), straight(10.0, 0.1), params), "needs poses with covariances"
    )


def test_something_has_to_end_a_submap() -> None:
    assert_refused(lambda: BuildParams(max_length=None), "something has to end a submap")
    assert_refused(lambda: BuildParams(min_range=3.0, max_range=2.0), "above min_range, 3 m")
    with pytest.raises(ValueError, match="max_turn must be from"):
        BuildParams(max_turn=9.0)
