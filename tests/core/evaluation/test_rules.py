"""Which pairs are true, false, grey or neighbours, and which motions are right."""

from math import radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import EvaluationParams, PoseErrors, Rule, pose_errors
from gpgrad_core.evaluation.rules import break_down, summarise_errors
from gpgrad_core.se2 import SE2
from tests.core.evaluation.squares import PAIRS


def named(mask: np.ndarray) -> set[str]:
    return {f"{PAIRS.database[k]}{PAIRS.query[k]}" for k in np.flatnonzero(mask)}


@pytest.mark.parametrize(
    ("rule", "true", "grey", "false"),
    [
        # A quarter common is an IoU of 0.13.
        (Rule("box", 0.3), {"03"}, {"04"}, {"02", "13", "14", "24"}),
        (Rule("box", 0.3, count_grey=True), {"03"}, set(), {"02", "04", "13", "14", "24"}),
        (Rule("surface", 0.2), {"03", "04"}, set(), {"02", "13", "14", "24"}),
    ],
)
def test_what_rules_call_true(rule: Rule, true: set[str], grey: set[str], false: set[str]) -> None:
    labels = rule.label(PAIRS)
    for mask, expected in ((labels.positive, true), (labels.grey, grey), (labels.negative, false)):
        assert named(mask) == expected


@pytest.mark.parametrize(("neighbours", "judged"), [(0, 10), (1, 6), (2, 3), (9, 0)])
def test_neighbours_are_left_out(neighbours: int, judged: int) -> None:
    labels = Rule("box", 0.0, neighbours).label(PAIRS)
    assert labels.judged.sum() == judged
    assert not (labels.positive & ~labels.judged).any()


def test_a_threshold_is_exceeded_not_met() -> None:
    exactly = float(PAIRS.box_iou.max())
    assert not Rule("box", exactly, 0).label(PAIRS).positive.any()
    assert Rule("box", exactly - 1e-12, 0).label(PAIRS).positive.sum() == 1


def test_a_rule_says_what_it_does() -> None:
    box, surface = EvaluationParams(min_overlap=0.1, neighbours=3).rules
    assert box.name == "box IoU > 0.1"
    assert "above 0.1" in box.statement
    assert "|i - j| <= 3 are left out" in box.statement
    assert "10 cm cells" in surface.statement
    assert "neighbours are counted" in EvaluationParams(neighbours=0).rules[0].statement
    assert "every other pair is false" in EvaluationParams(count_grey=True).rules[0].statement


def test_bounds_are_checked() -> None:
    with pytest.raises(InputError, match=r"min_overlap must be from 0 to 0\.99, got 1\.5"):
        EvaluationParams(min_overlap=1.5)


motions = st.builds(SE2, st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1))


@given(truth=motions, offset=st.floats(0, 3), toward=st.floats(-3, 3), turn=st.floats(-3, 3))
def test_the_error_is_the_motion_that_is_left(
    truth: SE2, offset: float, toward: float, turn: float
) -> None:
    wrong = truth @ SE2(offset * np.cos(toward), offset * np.sin(toward), turn)
    errors = pose_errors((wrong,), (truth,))
    assert errors.offset[0] == pytest.approx(offset, abs=1e-9)
    assert errors.turn[0] == pytest.approx(abs(turn), abs=1e-9)


def test_a_pair_without_a_motion_is_infinitely_off() -> None:
    errors = pose_errors((None, SE2()), (SE2(), SE2()))
    assert errors.offset.tolist() == [np.inf, 0]
    assert errors.near.tolist() == [False, True]


def test_near_is_within_half_a_metre_and_five_degrees() -> None:
    offset, turn = np.array([0.5, 0.51, 0.1, 0.1]), np.radians([4.9, 1.0, 5.1, 1.0])
    assert PoseErrors(offset, turn).near.tolist() == [True, False, False, True]


def test_a_summary_of_chosen_pairs() -> None:
    errors = PoseErrors(np.array([0.1, 0.2, 0.3, 9.0, np.inf]), np.full(5, radians(1)))
    some = summarise_errors(errors, np.array([True, True, True, True, False]))
    assert some.count == 4
    assert some.median_offset == pytest.approx(0.25)
    assert some.high_offset == pytest.approx(np.quantile([0.1, 0.2, 0.3, 9.0], 0.95))
    assert some.median_turn == pytest.approx(radians(1))
    assert some.near == 0.75
    # One that was accepted without a motion makes the tail infinite, and not a NaN.
    everything = summarise_errors(errors, np.ones(5, dtype=bool))
    assert (everything.median_offset, everything.high_offset) == (0.3, np.inf)
    nothing = summarise_errors(errors, np.zeros(5, dtype=bool))
    assert (nothing.count, nothing.median_offset, nothing.near) == (0, None, None)


def test_every_chosen_pair_is_in_one_bin() -> None:
    values = np.array([0.0, 0.1, 0.10001, 0.5, 0.7, 1.0])
    errors = PoseErrors(np.array([0.0, 0.0, 9.0, 0.0, 9.0, 0.0]), np.zeros(6))
    accepted = np.array([True, False, True, True, True, False])
    chosen = np.array([True, True, True, True, True, True])
    bins = break_down(values, (0.0, 0.1, 0.5, 1.0), chosen, accepted, errors)
    assert [one.pairs for one in bins] == [2, 2, 2]
    assert [one.accepted for one in bins] == [1, 2, 1]
    assert [one.near for one in bins] == [2, 1, 1]
    assert [one.accepted_near for one in bins] == [1, 1, 0]
    (only, *_) = break_down(values, (0.0, 0.1, 0.5, 1.0), ~chosen | (values == 0), accepted, errors)
    assert only.pairs == 1
