"""Overlaps that can be told by hand, and laws of the rest."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import measure_pairs
from gpgrad_core.evaluation.overlap import box_iou
from gpgrad_core.types import Dataset, Submap
from tests.core.evaluation.squares import DATASET, PAIRS, SIDE, pose, square
from tests.support.laws import examples


def test_overlaps_of_squares_are_those_of_geometry() -> None:
    # The boxes span from the first point to the last: a cell less than the square.
    side = SIDE - 0.1
    for query, database, shift, share in (("003", "000", 1.0, 0.75), ("004", "003", 2.0, 0.5)):
        k = PAIRS.rows[frozenset((query, database))]
        common = (side - shift) * side
        assert PAIRS.box_iou[k] == pytest.approx(common / (2 * side**2 - common))
        assert PAIRS.surface_overlap[k] == pytest.approx(share)
    apart = PAIRS.rows[frozenset(("002", "000"))]
    assert PAIRS.box_iou[apart] == PAIRS.surface_overlap[apart] == 0
    assert np.isnan(PAIRS.height_difference[apart])


def test_every_unordered_pair_is_there_once_the_later_as_query() -> None:
    assert len(PAIRS) == 10
    assert (PAIRS.database < PAIRS.query).all()
    assert len({*zip(PAIRS.query, PAIRS.database, strict=True)}) == 10
    assert PAIRS.steps.tolist() == (PAIRS.query - PAIRS.database).tolist()


def test_motion_turn_and_heights_of_a_pair() -> None:
    k = PAIRS.rows[frozenset(("003", "000"))]
    motion = PAIRS.T_database_query[k]
    assert (motion.x, motion.y, abs(motion.yaw)) == pytest.approx((1.0, 0.0, np.pi))
    assert abs(PAIRS.relative_yaw[k]) == pytest.approx(np.pi)
    # Slopes of 0.1 and -0.1: between x = -1 and 2 the heights are 0.1 x and 0.1 - 0.1 x.
    x = np.arange(-0.95, 2, 0.1)
    assert PAIRS.height_difference[k] == pytest.approx(np.median(np.abs(0.2 * x - 0.1)))


def test_the_turn_is_from_the_query_to_the_database() -> None:
    first = Submap.from_points(square(), "000", pose_true=pose(0, 0, 0.4))
    second = Submap.from_points(square(), "001", pose_true=pose(0, 0, 0.1))
    pairs = measure_pairs(Dataset("two", (first, second)))
    assert pairs.relative_yaw.tolist() == pytest.approx([0.3])


def test_numbers_in_the_names_say_who_is_a_neighbour() -> None:
    gaps = tuple(replace(s, id=f"{2 * k}") for k, s in enumerate(DATASET.submaps))
    assert set(measure_pairs(replace(DATASET, submaps=gaps)).steps) == {2, 4, 6, 8}
    names = tuple(replace(s, id="abcde"[k]) for k, s in enumerate(DATASET.submaps))
    assert set(measure_pairs(replace(DATASET, submaps=names)).steps) == {1, 2, 3, 4}


def test_submaps_without_truth_are_told_of() -> None:
    first, second, *others = DATASET.submaps
    partly = replace(DATASET, submaps=(first, replace(second, pose_true=None), *others))
    pairs = measure_pairs(partly)
    assert pairs.ids == ("000", "002", "003", "004")
    assert pairs.notes == ("1 of 5 submaps have no true pose (001): their pairs are not judged",)
    (note,) = measure_pairs(replace(DATASET, positions_only=True)).notes
    assert note.startswith("only the positions of the true poses were measured")
    blind = replace(DATASET, submaps=tuple(replace(s, pose_true=None) for s in DATASET.submaps))
    with pytest.raises(InputError, match=r"squares: 0 of 5 submaps .* add poses_gt\.txt"):
        measure_pairs(blind)


corners = st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(0.1, 5), st.floats(0.1, 5))


@examples(40)
@given(first=corners, second=corners, shift=st.tuples(st.floats(-9, 9), st.floats(-9, 9)))
def test_box_overlap_is_a_share_that_no_shift_or_order_changes(
    first: tuple[float, ...], second: tuple[float, ...], shift: tuple[float, float]
) -> None:
    a, b = ((np.array(c[:2]), np.array(c[:2]) + c[2:]) for c in (first, second))
    iou = box_iou(a, b)
    assert 0 <= iou <= 1 + 1e-12
    assert box_iou(b, a) == pytest.approx(iou)
    assert box_iou(a, a) == pytest.approx(1)
    moved = [(low + shift, high + shift) for low, high in (a, b)]
    assert box_iou(*moved) == pytest.approx(iou, abs=1e-9)
    # Against a count over a fine raster.
    low, high = np.minimum(a[0], b[0]), np.maximum(a[1], b[1])
    x, y = np.meshgrid(*(np.linspace(low[i], high[i], 200) for i in (0, 1)))
    inside = [
        (x >= l[0]) & (x <= h[0]) & (y >= l[1]) & (y <= h[1])
        for l, h in (a, b)  # noqa: E741
    ]
    counted = np.sum(inside[0] & inside[1]) / np.sum(inside[0] | inside[1])
    assert iou == pytest.approx(counted, abs=0.06)
