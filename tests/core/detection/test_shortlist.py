"""The best earlier submaps are found, one by one, by votes; how many a word means."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.arrays import NDArray
from gpgrad_core.detection.choosing import SharedShortlist
from gpgrad_core.detection.shortlist import (
    ALL_UP_TO,
    BY_CHANCE,
    DEFAULT_CANDIDATES,
    FEWEST_PROMISING,
    MOST_VOTERS,
    WORTH_VOTES,
    Candidate,
    Shortlist,
    num_candidates,
    read_candidates,
)
from gpgrad_core.detection.signatures import NUM_AXES, NUM_WORDS, Voters, count_votes
from gpgrad_core.errors import InputError
from gpgrad_core.run import silent
from tests.core.detection.places import LEARN_FROM, MANY, features, learning_early, nothing
from tests.support.laws import examples


@pytest.fixture(scope="module", autouse=True)
def _early() -> Iterator[None]:
    with learning_early():
        yield


def filled(count: int, seed: int = 0) -> Shortlist:
    shortlist = Shortlist(seed)
    for k in range(count):
        shortlist.add(f"{k:03}", features(k, 100))
    return shortlist


@pytest.fixture(scope="module")
def many() -> Shortlist:
    shortlist = filled(MANY)
    assert shortlist.state.vocabulary is not None
    return shortlist


@pytest.mark.parametrize("count", [1, 2, LEARN_FROM - 1, LEARN_FROM, MANY])
def test_a_place_seen_again_comes_first(count: int) -> None:
    shortlist = filled(count)
    again = features(count - 1, 100, noise=0.1, turned=2.0, shifted=30.0)
    best = shortlist.candidates(again, 5)
    assert shortlist.has_learned == (count >= LEARN_FROM)
    assert shortlist.candidates(again, 3) == best[:3]
    assert len(best) == min(5, count)
    assert best[0].id == f"{count - 1:03}"
    assert best[0].votes > 30
    assert all(other.votes < 20 for other in best[1:])


def test_more_candidates_than_submaps(many: Shortlist) -> None:
    best = many.candidates(features(7, 100), 10 * MANY)
    assert sorted(candidate.id for candidate in best) == sorted(many.ids)
    likeness = [one.votes + WORTH_VOTES * one.similarity for one in best]
    assert likeness == pytest.approx(sorted(likeness, reverse=True), abs=1e-4)
    assert best[0].id == "007"


def test_those_that_promise_no_more_than_chance_are_left_out(many: Shortlist) -> None:
    for query in (features(7, 100, noise=0.1), features(5000, 100), nothing()):
        every = many.candidates(query, MANY)
        promising = many.candidates(query, MANY, promising=True)
        assert promising == every[: len(promising)]
        assert len(promising) >= FEWEST_PROMISING
        likeness = [one.votes + WORTH_VOTES * one.similarity for one in every]
        least = BY_CHANCE * np.quantile(likeness, 0.25)
        beyond = likeness[len(promising) :]
        assert all(one < least + 1e-4 for one in beyond)
        assert all(one >= least - 1e-4 for one in likeness[FEWEST_PROMISING : len(promising)])
    assert len(many.candidates(features(7, 100, noise=0.1), MANY, promising=True)) < MANY
    assert many.candidates(features(7, 100), 2, promising=True) == many.candidates(
        features(7, 100), 2
    )
    assert many.candidates(features(7, 100), 9, [], promising=True) == ()


def test_only_those_that_are_asked_for(many: Shortlist) -> None:
    query = features(7, 100, noise=0.1)
    among = ["030", "007", "011"]
    assert many.candidates(query, 2, among)[0].id == "007"
    assert {one.id for one in many.candidates(query, 9, among)} == set(among)
    assert many.candidates(query, 9, []) == ()
    with pytest.raises(InputError, match="submap x is not on the shortlist"):
        many.candidates(query, 9, ["x"])


def test_a_candidate_depends_on_no_later_submap() -> None:
    """One by one is all at once: what is added later changes no earlier answer."""
    growing = Shortlist()
    online: list[tuple[Candidate, ...]] = []
    for k in range(40):
        online.append(growing.candidates(features(k // 2, 100, noise=0.1 * (k % 2)), 4))
        growing.add(f"{k:03}", features(k // 2, 100, noise=0.1 * (k % 2)))
    for k in (10, 30):
        before = Shortlist()
        for j in range(k):
            before.add(f"{j:03}", features(j // 2, 100, noise=0.1 * (j % 2)))
        assert before.candidates(features(k // 2, 100, noise=0.1 * (k % 2)), 4) == online[k]
    assert all(online[k][0].id == f"{k - 1:03}" for k in range(1, 40, 2))


def test_all_may_be_added_before_the_first_is_asked_for(tmp_path: Path) -> None:
    growing = Shortlist()
    online: dict[str, tuple[Candidate, ...]] = {}
    for k in range(MANY):
        seen = features(k // 2, 100, noise=0.1 * (k % 2))
        if growing.has_learned:
            online[f"{k:03}"] = growing.candidates(seen, 4)
        growing.add(f"{k:03}", seen)
    assert len(online) == MANY - LEARN_FROM
    assert {id: growing.candidates_before(id, 4) for id in online} == online
    shared = SharedShortlist.of(growing, tmp_path, 4, promising=False)
    assert {id: shared(id, silent) for id in online} == online
    promising = {id: growing.candidates_before(id, 9, promising=True) for id in online}
    shared = SharedShortlist.of(growing, tmp_path, 9, promising=True)
    assert {id: shared(id, silent) for id in online} == promising
    with pytest.raises(InputError, match="submap x is not on the shortlist"):
        growing.candidates_before("x", 4)


@examples(15)
@given(order=st.permutations(range(60)), turned=st.floats(-3.2, 3.2), shifted=st.floats(-100, 100))
def test_votes_depend_on_no_order_and_no_motion(
    order: list[int], turned: float, shifted: float
) -> None:
    shortlist = Shortlist()
    for k in range(3):
        shortlist.add(str(k), features(k))
    plain = features(1, noise=0.1)
    moved = features(1, noise=0.1, turned=turned, shifted=shifted).select(np.array(order))
    votes, again = (
        {one.id: one.votes for one in shortlist.candidates(query, 3)} for query in (plain, moved)
    )
    # A distance at the tolerance may fall to either side when it is computed anew.
    assert all(abs(votes[name] - again[name]) <= 2 for name in votes)
    assert max(again, key=lambda name: again[name]) == "1"


def test_submaps_without_keypoints() -> None:
    shortlist = Shortlist()
    for k in range(LEARN_FROM + 20):
        shortlist.add(str(k), nothing() if k % 3 == 0 else features(k, 100))
    assert shortlist.state.vocabulary is not None
    best = shortlist.candidates(nothing(), 3)
    assert [one.id for one in best] == ["0", "1", "2"]
    assert all((one.votes, one.similarity) == (0, 0.0) for one in best)
    assert shortlist.candidates(features(4, 100), 1)[0].id == "4"
    assert "3" not in {one.id for one in shortlist.candidates(features(4, 100), 3)}
    assert len(Shortlist().candidates(features(4), 3)) == 0


def test_what_does_not_belong_together_is_refused(many: Shortlist) -> None:
    with pytest.raises(InputError, match="submap 003 is on the shortlist already"):
        many.add("003", features(3))
    other = replace(features(3), descriptors=features(3).descriptors[:, :5].copy())
    for query in (many.candidates, lambda f, _: many.add("new", f)):
        with pytest.raises(InputError, match="descriptors of 5 numbers cannot be compared with"):
            query(other, 3)
    assert "new" not in many.ids


def test_bytes_of_a_submap_are_bounded() -> None:
    shortlist = Shortlist()
    for k in range(LEARN_FROM + 4):
        shortlist.add(str(k), features(k, 1500))
    state = shortlist.state
    assert state.vocabulary is not None
    width = state.vocabulary.words.shape[1]
    # Half precision for descriptors, single for positions and global vectors.
    assert state.num_voters.tolist() == len(shortlist) * [MOST_VOTERS]
    assert state.descriptors.nbytes + state.positions.nbytes == len(shortlist) * MOST_VOTERS * (
        2 * width + 2 * 4
    )
    assert state.global_vectors.nbytes == len(shortlist) * 4 * 32 * width
    assert MOST_VOTERS * (2 * NUM_AXES + 2 * 4) + 4 * NUM_WORDS * NUM_AXES < 53_000


def test_words_that_are_read_and_refused() -> None:
    for word in ("all", "automatic", "1", "30", "1000000"):
        assert str(read_candidates(word)) == word
    for word in ("", "none", "-3", "3.5", "1e3", "٣", "0", "1000001", "All"):
        with pytest.raises(InputError, match="candidates must be"):
            read_candidates(word)


def test_automatic_is_all_of_few_and_some_of_many() -> None:
    assert num_candidates("automatic", ALL_UP_TO) == ALL_UP_TO
    assert num_candidates("automatic", ALL_UP_TO + 1) == DEFAULT_CANDIDATES
    assert num_candidates("all", 10_000) == 10_000
    assert num_candidates(7, 3) == 3
    assert num_candidates(7, 0) == 0


def voters(positions: list[tuple[float, float]], names: list[int] | None = None) -> Voters:
    """Keypoints, the descriptor of each of which is its own direction."""
    names = names if names is not None else list(range(len(positions)))
    described: NDArray[np.float32] = np.eye(12, dtype=np.float32)[names]
    return Voters(described, np.array(positions, np.float32).reshape(-1, 2), 0.1)


SQUARE = [(0.0, 0.0), (3.0, 0.0), (3.0, 4.0), (0.0, 4.0)]


def test_votes_by_hand() -> None:
    turned = [(-y + 7.0, x - 2.0) for x, y in SQUARE]
    scattered = [(0.0, 0.0), (1.0, 0.0), (5.0, 5.0), (9.0, 1.0)]
    votes = [
        (voters(SQUARE), 4),
        (voters(turned), 4),
        (voters([*turned[:3], (0.0, 0.0)]), 3),  # one has moved
        (voters(scattered), 0),
        (voters([]), 0),
        # Two keypoints look alike: only one of them can be associated.
        (voters([*SQUARE, (9.0, 9.0)], [0, 1, 2, 3, 7]), 4),
        # A distance may differ by the tolerance.
        (voters([(1.01 * x, 1.01 * y) for x, y in SQUARE]), 4),
        (voters([(1.1 * x, 1.1 * y) for x, y in SQUARE]), 0),
    ]
    others = [other for other, _ in votes]
    assert count_votes(voters(SQUARE), others) == [count for _, count in votes]
    assert count_votes(voters([]), others) == [0] * len(others)
    assert count_votes(voters(SQUARE), [voters(SQUARE, [4, 5, 6, 7])])[0] <= 4
    # Associations at one place do not vote for each other.
    heap = [(0.0, 0.01 * k) for k in range(10)]
    assert count_votes(voters(heap), [voters(heap)]) == [0]
