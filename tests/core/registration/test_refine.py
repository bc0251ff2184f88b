"""Registration from a motion set by hand."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gpgrad_core.registration import refine
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Matches
from tests.core.registration.synthetic import DATABASE, map_of

NONE = Matches(np.zeros((0, 2), np.intp), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)))
near = st.floats(-0.25, 0.25)


@settings(max_examples=6)
@given(x=near, y=near, yaw=st.floats(-0.08, 0.08), turn=st.floats(-math.pi, math.pi))
def test_a_slip_of_the_hand_is_undone(x: float, y: float, yaw: float, turn: float) -> None:
    true = SE2(0.8, -0.5, turn)
    found = refine(map_of(true), DATABASE, NONE, SE2(x, y, yaw) @ true)
    assert found.T_database_query is not None
    error = found.T_database_query.inverse() @ true
    assert np.hypot(error.x, error.y) < 0.02
    assert abs(error.yaw) < 0.01
    assert found.correlation > 0.97
    assert found.covariance is not None


def test_without_common_ground_the_motion_stays() -> None:
    far = SE2(50.0, 0.0, 0.3)
    found = refine(map_of(SE2()), DATABASE, NONE, far)
    assert found.T_database_query == far
    assert found.score < 1.0
    assert found.overlap_area == 0.0
