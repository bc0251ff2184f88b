"""What the other pairs of a dataset say about one, on a drive around a block."""

from dataclasses import replace

import numpy as np
import pytest

from gpgrad_core.detection.consistency import (
    GAPS_TOLD,
    MOST_SUPPORT,
    USUAL_GAP,
    Consistency,
    own_registration,
)
from gpgrad_core.detection.verdict import ClosureParams, classify
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Agreement, Registration


def circle(count: int, radius: float) -> list[SE2]:
    turns = 2 * np.pi * np.arange(count) / count
    return [SE2(radius * np.cos(turn), radius * np.sin(turn), turn) for turn in turns]


AROUND = circle(8, 8.0)
"""Poses of submaps around a block; the drive ends beside its start."""
USUAL = Agreement(0.008, 0.01, 0.15)
ELSEWHERE = SE2(8.0, 0.0, 0.0)
"""One spacing of the repeated ground."""


def true_motion(query: int, database: int, poses: list[SE2] = AROUND) -> SE2:
    return poses[database].inverse() @ poses[query]


def registration(motion: SE2, score: float, agreement: Agreement | None = USUAL) -> Registration:
    covariance = np.diag([0.02**2, 0.02**2, 0.003**2])
    return Registration(
        motion, np.zeros(0, bool), 0.0, 50.0, 0.9, score,
        covariance=covariance, scale=0.3, agreement=agreement,
    )  # fmt: skip


def drive(
    poses: list[SE2] = AROUND, agreement: Agreement = USUAL
) -> dict[tuple[int, int], Registration]:
    """Every submap on the one before it, with high scores."""
    return {
        (k, k - 1): registration(true_motion(k, k - 1, poses), 6.0, agreement)
        for k in range(1, len(poses))
    }


def test_a_wrong_place_is_contradicted_by_better_closures() -> None:
    wrong = registration(ELSEWHERE @ true_motion(7, 0), 4.0)
    context = Consistency().weigh(drive() | {(7, 0): wrong})[7, 0]
    assert context.own_score == 4.0
    assert context.support < -2
    assert context.score < 3
    assert context.places == 2
    closure = classify(wrong, ClosureParams(), context=context)
    assert not closure.accepted
    assert "this ground repeats: 2 places fit" in closure.reason
    assert own_registration(closure).score == 4.0


def test_a_weak_closure_is_supported_but_only_so_far() -> None:
    right, hopeless = registration(true_motion(7, 0), 2.2), registration(true_motion(6, 1), 0.5)
    contexts = Consistency().weigh(drive() | {(7, 0): right, (6, 1): hopeless})
    assert contexts[7, 0].score == pytest.approx(2.2 + MOST_SUPPORT)
    assert contexts[6, 1].score == pytest.approx(0.5)
    closure = classify(right, ClosureParams(), context=contexts[7, 0])
    assert closure.accepted
    assert "2.2 alone, and other closures lead to the same motion" in closure.reason
    assert not classify(right, ClosureParams()).accepted


def test_a_score_that_wrong_motions_often_reach_is_worth_less() -> None:
    alone = registration(SE2(1.0, 0.0, 0.0), 3.5)  # of a submap that nothing else reaches
    pairs = drive() | {(8, 3): alone}
    assert Consistency().weigh(pairs)[8, 3].score == pytest.approx(3.5)
    pairs |= {
        (query, database): registration(ELSEWHERE @ true_motion(query, database), 3.6)
        for query, database in ((5, 0), (6, 1), (7, 1))
    }
    context = Consistency().weigh(pairs)[8, 3]
    assert context.own_score == 3.5
    # Worth log10(11 / 2); half of what it was is left to rank it.
    assert context.score == pytest.approx(3.5 / 2)
    verdict = classify(alone, ClosureParams(), context=context)
    assert "alone the score is 3.5, and in this dataset wrong motions" in verdict.reason


def test_a_wrong_link_of_the_chain_is_found_by_the_cycle_that_it_breaks() -> None:
    pairs = drive() | {(7, 0): registration(true_motion(7, 0), 5.0)}
    pairs |= {(6, 0): registration(true_motion(6, 0), 5.0)}
    pairs[4, 3] = registration(ELSEWHERE @ true_motion(4, 3), 3.5)
    contexts = Consistency().weigh(pairs)
    assert contexts[4, 3].score < 3
    assert min(contexts[pair].score for pair in pairs if pair != (4, 3)) >= 3


def test_after_a_long_drive_a_closure_stands_and_another_place_does_not() -> None:
    around = circle(200, 200.0)
    true = true_motion(199, 0, around)
    # So many motions in a row are known to some metres at best.
    for motion, stands in ((true, True), (SE2(100.0, 0.0, 0.0) @ true, False)):
        pairs = drive(around) | {(199, 0): registration(motion, 5.0)}
        context = Consistency().weigh(pairs)[199, 0]
        assert (context.score >= 3) == stands
        assert (context.support < -1) != stands


@pytest.mark.parametrize("level", [0.5, 1.0, 1.4])
def test_heights_that_differ_more_than_is_usual_lower_the_score(level: float) -> None:
    usual, unusual = (Agreement(times * level * 0.01, 0.01, 0.15) for times in (1.0, 3.0))
    pairs = drive(agreement=usual)
    as_usual, differing = (registration(true_motion(5, 1), 4.0, some) for some in (usual, unusual))
    assert Consistency().weigh(pairs | {(5, 1): as_usual})[5, 1].score >= 4
    context = Consistency().weigh(pairs | {(5, 1): differing})[5, 1]
    assert context.score < 3.5
    context = replace(context, support=0.0, score=min(context.score, 2.9))
    verdict = classify(differing, ClosureParams(), context=context)
    assert verdict.registration.score == context.score
    assert "times as much as is usual" in verdict.reason


def test_the_order_of_the_pairs_changes_nothing() -> None:
    pairs = drive() | {
        (7, 0): registration(true_motion(7, 0), 2.5),
        (6, 0): registration(ELSEWHERE @ true_motion(6, 0), 3.5),
    }
    backwards = dict(reversed(pairs.items()))
    assert Consistency().weigh(pairs) == Consistency().weigh(backwards)


@pytest.mark.parametrize("speaks", [False, True])
def test_one_by_one_pairs_are_weighed_as_all_at_once(speaks: bool) -> None:
    rng = np.random.default_rng(3)
    poses = [SE2(*rng.uniform(-9, 9, 2).tolist(), float(rng.uniform(-3, 3))) for _ in range(40)]
    pairs, others, scores = dict[tuple[int, int], Registration](), Consistency(), list[float]()
    for query in range(1, len(poses)):
        for database in {query - 1, *rng.integers(0, query, 6).tolist()}:
            motion = poses[database].inverse() @ poses[query]
            if rng.random() < 0.2:
                motion = ELSEWHERE @ motion
            x, y, yaw = (0.02 * rng.standard_normal(3)).tolist()
            agreement = Agreement(float(rng.uniform(0.006, 0.012)), 0.01, 0.15)
            off, score = SE2(motion.x + x, motion.y + y, motion.yaw + yaw), rng.uniform(0.5, 7.0)
            pairs[query, database] = registration(off, float(score), agreement)
        odometry = poses[: query + 1] if speaks else ()
        contexts = others.weigh(pairs, odometry)
        assert contexts == Consistency().weigh(pairs, odometry)
        scores.append(contexts[1, 0].support)
    assert len(set(scores)) > 5  # the cycles that say of it have changed
    assert {context.places for context in contexts.values()} > {1, 2}


def test_odometry_speaks_where_no_closures_do() -> None:
    wrong = {(7, 0): registration(ELSEWHERE @ true_motion(7, 0), 4.0)}
    assert Consistency().weigh(wrong)[7, 0].support == 0
    assert Consistency().weigh(wrong, AROUND)[7, 0].score < 3


def test_what_is_said_of_odometry_is_not_said_of_the_pair() -> None:
    pairs = drive() | {(7, 0): registration(true_motion(7, 0), 5.0)}
    pairs[4, 3] = registration(ELSEWHERE @ true_motion(4, 3), 3.2)
    pairs[2, 1] = registration(ELSEWHERE @ true_motion(2, 1), 0.4)
    contexts = Consistency().weigh(pairs, AROUND)
    assert contexts[4, 3].support < 0  # its own motion's, and not that of the right odometry
    assert contexts[2, 1].support == 0
    assert contexts[2, 1].score == pytest.approx(0.4)


def test_pairs_whose_terrain_was_not_compared_are_left_out() -> None:
    bare = registration(true_motion(7, 0), 4.0, None)
    assert Consistency().weigh({}) == {}
    assert (7, 0) not in Consistency().weigh(drive() | {(7, 0): bare})


def overlapping(times: float) -> dict[tuple[int, int], Registration]:
    """Submaps on the four before them, with errors so many times what the registrations say."""
    rng, poses, pairs = np.random.default_rng(5), circle(24, 8.0), {}
    for query in range(1, len(poses)):
        for database in range(max(query - 4, 0), query):
            x, y, yaw = (times * rng.normal(0.0, [0.02, 0.02, 0.003])).tolist()
            motion = true_motion(query, database, poses)
            off = SE2(motion.x + x, motion.y + y, motion.yaw + yaw)
            pairs[query, database] = registration(off, 6.0)
    return pairs


@pytest.mark.parametrize("times", [0.2, 0.5, 1.0, 2.0])
def test_triangles_show_how_large_the_errors_of_a_dataset_are(times: float) -> None:
    pairs = overlapping(times)
    (factor,) = {context.variance_factor for context in Consistency().weigh(pairs).values()}
    assert factor == pytest.approx(max((times**2 / USUAL_GAP) ** GAPS_TOLD, 1.0), rel=0.25)
    assert factor >= 1.0


def test_errors_of_no_size_and_of_no_known_size_do_no_harm() -> None:
    pairs = overlapping(0.0)
    assert Consistency().weigh(pairs)[9, 6].variance_factor == 1.0
    unknown = replace(pairs[9, 6], covariance=np.full((3, 3), np.nan))
    assert (
        Consistency()
        .weigh({(9, 6): unknown, (9, 5): unknown, (6, 5): unknown})[9, 6]
        .variance_factor
        == 1.0
    )


def test_a_wrong_motion_says_nothing_of_the_errors_of_the_others() -> None:
    pairs = overlapping(1.0)
    before = Consistency().weigh(pairs)[9, 6]
    pairs[9, 6] = registration(ELSEWHERE @ pairs[9, 6].T_database_query, 4.0)
    after = Consistency().weigh(pairs)[9, 6]
    assert after.score < 3
    assert after.variance_factor == before.variance_factor


def test_a_position_is_as_uncertain_as_the_errors_of_the_dataset_are() -> None:
    pairs = overlapping(2.0)
    context, alone = Consistency().weigh(pairs)[9, 6], pairs[9, 6]
    closure = classify(alone, ClosureParams(), context=context)
    larger = np.sqrt(context.variance_factor)
    assert larger > 1.5
    assert closure.registration.position_std == pytest.approx(larger * alone.position_std)
    assert not classify(alone, ClosureParams(max_std=0.03), context=context).accepted
    assert classify(alone, ClosureParams(max_std=0.03)).accepted
    np.testing.assert_allclose(own_registration(closure).covariance, alone.covariance)
