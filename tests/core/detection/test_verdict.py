"""The verdict and its reason."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.detection.verdict import ClosureParams, classify, heights_in_words, why_of
from gpgrad_core.errors import score_in_words, told_apart
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Agreement, Registration


def registration(num_inliers: int, score: float, found: bool = True) -> Registration:
    inliers = np.zeros(num_inliers + 3, bool)
    inliers[:num_inliers] = True
    return Registration(SE2() if found else None, inliers, 1.0, 10.0, 0.8, score)


ASKED = ClosureParams(min_inliers=8, min_score=7.0)
NO_SCORE, NO_INLIERS = ClosureParams(9, 0.0), ClosureParams(0, 2.5)


@pytest.mark.parametrize(
    ("made", "params", "accepted", "reason"),
    [
        (registration(12, 9.5), ASKED, True, "12 inliers >= 8, score 9.5 >= 7"),
        (registration(8, 7.0), ASKED, True, "8 inliers >= 8, score 7 >= 7"),
        (registration(9, 3.0), NO_SCORE, True, "9 inliers >= 9"),
        (registration(9, 3.0), NO_INLIERS, True, "score 3 >= 2.5"),
        (registration(9, 3.0), ClosureParams(0, 0.0), True, "no threshold is set"),
        (registration(7, 1.0), ASKED, False, "7 inliers < 8: too few keypoints agree"),
        (
            registration(20, 6.996),
            ASKED,
            False,
            "score 6.996 < 7: they share too little ground to compare; 20 keypoints agree; "
            "they share 10 m²",
        ),
        (
            replace(registration(20, 6.0), overlap_area=0.0),
            ASKED,
            False,
            "score 6 < 7: no ground of both was compared; 20 keypoints agree",
        ),
        (
            registration(5, 100.0, found=False),
            ClosureParams(2, 0.0),
            False,
            "no motion was found: the maps have too little in common",
        ),
        (
            replace(registration(0, 0.0, found=False), nothing_trusted=True),
            ClosureParams(0, 0.0),
            False,
            "cannot judge: the variance mask hides all ground of one submap: raise it to see more",
        ),
    ],
)
def test_the_reason_says_what_decided(
    made: Registration, params: ClosureParams, accepted: bool, reason: str
) -> None:
    closure = classify(made, params)
    assert closure.accepted is accepted
    assert closure.reason == reason
    assert closure.registration is made


@given(st.integers(0, 60), st.floats(0, 100), st.integers(2, 50), st.floats(0, 50))
def test_what_meets_both_thresholds_is_accepted(
    num: int, score: float, min_inliers: int, min_score: float
) -> None:
    closure = classify(registration(num, score), ClosureParams(min_inliers, min_score))
    assert closure.accepted == (num >= min_inliers and score >= min_score)


@pytest.mark.parametrize(
    ("agreement", "area", "undecided", "said"),
    [
        (
            Agreement(0.09, 0.03, 0.4),
            40.0,
            False,
            "the heights do not fit; heights differ by 9 cm; noise explains 3 cm: inconsistent "
            "(3.0 times, limit 1.5); 4 keypoints agree; they share 40 m²",
        ),
        (
            Agreement(0.03, 0.03, 0.4),
            3.0,
            True,
            "they share too little ground to tell; heights differ by 3 cm; noise explains 3 cm: "
            "consistent (1.0 times, limit 1.5); 4 keypoints agree; they share 3 m²",
        ),
        (
            Agreement(0.005, 0.005, 0.01),
            40.0,
            True,
            "the ground is too smooth to tell: its relief is 1 cm, and noise explains 5 mm",
        ),
        (
            Agreement(0.01, 0.03, 0.4),
            40.0,
            False,
            "the maps agree, but unrelated ground can agree as well",
        ),
        (None, 40.0, True, "they share too little ground to compare; 4 keypoints agree"),
    ],
)
def test_the_reason_of_a_refusal_names_what_spoke_against_it(
    agreement: Agreement | None, area: float, undecided: bool, said: str
) -> None:
    made = replace(registration(4, 1.0), agreement=agreement, overlap_area=area, scale=0.3)
    closure = classify(made)
    assert not closure.accepted
    assert closure.undecided is undecided
    assert closure.headline == ("Undecided" if undecided else "No loop closure")
    assert closure.refusal is not None
    assert said.startswith(why_of(closure.refusal))
    assert closure.reason.startswith(f"score 1 < 3: {said}")


@given(st.floats(0, 1e12), st.floats(0, 1e12), st.booleans())
def test_two_numbers_are_told_apart(value: float, limit: float, near: bool) -> None:
    limit = float(np.nextafter(value, limit)) if near else limit
    has, needs = (float(text.replace(",", "")) for text in told_apart(value, limit, ",.1f"))
    assert (has < needs) == (value < limit)


@pytest.mark.parametrize("least", [3.0, 3.05, 7.2, 12.0])
def test_a_refused_score_reads_as_below_the_threshold(least: float) -> None:
    made = registration(4, least - 4e-4)
    closure = classify(made, ClosureParams(min_score=least))
    assert not closure.accepted
    for said in (dict(made.in_words)["score"], score_in_words(made.score, least)):
        assert float(said) < least


@pytest.mark.parametrize(
    ("made", "params", "reason"),
    [
        (
            {"dissimilarity": 1.0001e6},
            ClosureParams(0, 0.0, 1e6),
            "dissimilarity 1.0001e+06 > 1e+06",
        ),
        (
            {"covariance": np.diag([0.01, 0.20001, 0.01]) ** 2},
            ClosureParams(),
            "position is 0.20001 m (at most 0.2 m)",
        ),
        ({"score": 6.99999996}, ASKED, "score 6.99999996 < 7"),
    ],
)
def test_a_number_just_beyond_its_limit_is_seen_to_be(
    made: dict[str, Any], params: ClosureParams, reason: str
) -> None:
    closure = classify(replace(registration(20, 9.0), **made), params)
    assert not closure.accepted
    assert reason in closure.reason


@given(st.floats(1e-5, 10.0), st.floats(1e-5, 10.0))
def test_the_number_of_times_never_lies_on_the_other_side_of_its_limit(
    difference: float, possible: float
) -> None:
    words = heights_in_words(Agreement(difference, possible, 1.0))
    times = float(words.partition("(")[2].partition(" times")[0].replace(",", ""))
    if difference <= 1.5 * possible:
        assert ": consistent" in words
        assert times <= 1.5
    else:
        assert ": inconsistent" in words
        assert times >= 1.5


def test_ground_that_lets_a_submap_slide_is_refused() -> None:
    covariance = np.diag([0.01**2, 0.8**2, 0.001**2])
    closure = classify(replace(registration(20, 9.0), covariance=covariance))
    assert not closure.accepted
    assert "standard deviation of the position is 0.8 m (at most 0.2 m)" in closure.reason
    assert closure.undecided
    firm = replace(registration(20, 9.0), covariance=covariance / 16)
    assert classify(firm).accepted


def test_dissimilarity_above_a_threshold_refuses_and_says_so() -> None:
    found = replace(registration(9, 5.0), dissimilarity=2e6, mean_dissimilarity=300.0)
    free = ClosureParams(min_score=0.0)
    assert classify(found, free).accepted
    assert classify(
        found, replace(free, max_dissimilarity=2e6, max_mean_dissimilarity=300)
    ).accepted
    for limit, reason in (
        ({"max_dissimilarity": 1e6}, "dissimilarity 2e+06 > 1e+06: {} (h)"),
        ({"max_mean_dissimilarity": 299.0}, "dissimilarity of a cell 300 > 299: {} (h of a cell)"),
    ):
        closure = classify(found, replace(free, **limit))
        why = reason.format("the gradients of the two maps differ too much")
        assert (closure.accepted, closure.reason) == (False, why)
    nothing = replace(found, dissimilarity=np.inf, mean_dissimilarity=np.inf)
    assert not classify(nothing, replace(free, max_dissimilarity=1e20)).accepted
