import html
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from app.viewer.features.pairs.matrix import (
    MOST_GROUPS,
    MatrixLook,
    cell_pixels,
    gather,
    gather_all,
    gather_block,
    matrix_html,
    score_shares,
    words_of,
)
from app.viewer.features.pairs.model import RULES, JudgedPairs, PairsRun, judge
from app.viewer.features.pairs.scores import (
    count_scores,
    disagreements_html,
    scores_html,
    threshold_html,
)
from app.viewer.scene.colors import lookup_table
from app.viewer.session.state import ViewState
from gpgrad_core.detection import Pairs
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.evaluation.rules import Rule
from gpgrad_core.types import Dataset, Registration
from tests.support.synthetic import NUMBERS, PAIR_SCORES, make_compared

BOX = next(iter(RULES.values()))
COMPARED = make_compared()


def judged_at(min_score: float) -> JudgedPairs:
    return judge(COMPARED, ClosureParams(0, min_score), BOX)


def data_of(picture: str, name: str) -> object:
    (data,) = re.findall(f'data-{name}="([^"]*)"', picture)
    return json.loads(html.unescape(data))


def run_of(dataset: Dataset, registered: dict[tuple[str, str], Registration]) -> PairsRun:
    """Make a run that has ended without a truth."""
    table = Pairs.of(dataset.submaps, registered, NUMBERS)
    state = ViewState(dataset, dataset.submaps[-1].id, dataset.submaps[0].id)
    return PairsRun(state, "all", registered, None, table, has_ended=True)


def many(count: int, num_earlier: int) -> JudgedPairs:
    """Make the verdicts on a long traverse, each submap compared with the ones just before it."""
    submap, registration = COMPARED.dataset.submaps[0], COMPARED.registered["001", "000"]
    submaps = tuple(replace(submap, id=f"{k:04d}") for k in range(count))
    registered = {
        (f"{query:04d}", f"{database:04d}"): replace(registration, score=float(query - database))
        for query in range(count)
        for database in range(max(0, query - num_earlier), query)
    }
    return judge(run_of(Dataset("long", submaps), registered), ClosureParams(0, 3.0), BOX)


def test_each_pair_has_the_colour_of_its_score_and_overlap() -> None:
    judged = judge(COMPARED, ClosureParams(), BOX)
    cells = gather_all(judged)
    assert cells.cells[3, 0].score == PAIR_SCORES["003", "000"]
    assert cells.overlaps[0, 3] > BOX.threshold
    pixels = cell_pixels(cells, judged.top_score)
    viridis, greys = lookup_table("viridis"), lookup_table("grey")
    assert tuple(pixels[3, 0, :3]) == tuple(viridis[255])  # the highest score
    place = int(255 * 2.0 / judged.top_score)
    assert tuple(pixels[2, 0, :3]) == tuple(viridis[place])
    assert tuple(pixels[0, 2, :3]) == tuple(greys[0])  # far apart
    assert pixels[0, 3, 0] > pixels[0, 2, 0]  # the revisit overlaps
    assert (pixels[range(4), range(4), 3] == 0).all()
    assert (pixels[..., 3] == 255).sum() == 12


def test_marks_follow_the_verdicts() -> None:
    def marks(min_score: float) -> list[str]:
        cells = gather_all(judged_at(min_score))
        picture = matrix_html("all", cells, 5.0)
        marked = re.findall(r'data-outcome="([\w ]+)" data-count="(\d+)"', picture)
        outcomes = [outcome for outcome, count in marked for _ in range(int(count))]
        of_cells = [
            f"{cell.query} → {cell.database}: {cell.outcome}"
            for cell in cells.cells.values()
            if cell.outcome != "refused"
        ]
        assert sorted(outcomes) == sorted(text.partition(": ")[2] for text in of_cells)
        return of_cells

    assert marks(4.5) == ["003 → 000: right"]
    assert marks(5.5) == ["003 → 000: missed"]
    assert "002 → 000: no overlap" in marks(1.5)
    assert len(marks(0.0)) == 6


def test_a_cell_says_what_it_holds() -> None:
    picture = matrix_html("all", gather_all(judged_at(4.5)), 5.0)
    texts = data_of(picture, "cells")
    assert isinstance(texts, dict)
    assert len(texts) == 6
    assert 'data-mirrored="1"' in picture  # the page takes the same text above the diagonal
    assert str(texts["3,0"]).startswith("003 → 000 · score 5.00 · right · true overlap 0.")
    assert texts["2,1"] == "002 → 001 · score 3.00 · refused · true overlap 0.01"
    for name in ("000", "001", "002", "003"):
        assert picture.count(f">{name}</text>") == 2  # beside the rows and below the columns


def test_the_colours_have_a_step_at_the_threshold_and_rise_on_both_sides() -> None:
    shares = score_shares(np.array([0.0, 2.9, 3.0, 12.0, 40.0]), 12.0, 3.0)
    assert (np.diff(shares) >= 0).all()
    assert shares[2] - shares[1] > 0.2
    assert shares[[0, 3, 4]].tolist() == [0.0, 1.0, 1.0]
    for threshold in (0.0, 12.0, 50.0):  # there is none among the colours
        np.testing.assert_allclose(score_shares(np.array([6.0]), 12.0, threshold), 0.5)


def test_what_a_person_decided_and_what_was_not_compared_is_seen_without_colours() -> None:
    cells = gather_all(judged_at(4.5))
    look = MatrixLook(3.0, {("003", "000"): True, ("002", "001"): False}, asks=True)
    picture = matrix_html("board", cells, 5.0, None, look)
    (corners,) = re.findall(r'data-by-hand="2" d="([^"]*)"', picture)
    assert corners.count("z") == 2
    assert 'fill="url(#hatch-board)"' in picture
    assert data_of(picture, "cells") == {}  # the server says what a cell holds
    assert words_of(cells, 0, 3) == words_of(cells, 3, 0) != words_of(cells, 3, 3) == ""


def test_names_in_the_matrix_are_escaped_and_cut() -> None:
    submaps = tuple(
        replace(submap, id=f"<b>&{submap.id}-of-a-very-long-traverse")
        for submap in COMPARED.dataset.submaps
    )
    registered = {
        (
            f"<b>&{query}-of-a-very-long-traverse",
            f"<b>&{database}-of-a-very-long-traverse",
        ): registration
        for (query, database), registration in COMPARED.registered.items()
    }
    run = run_of(replace(COMPARED.dataset, submaps=submaps), registered)
    judged = judge(run, ClosureParams(), BOX)
    picture = matrix_html("all", gather_all(judged), 5.0)
    assert "<b>" not in picture
    assert ">&lt;b&gt;&amp;000-o…</text>" in picture


def test_the_pair_shown_is_pointed_at_whichever_way_round() -> None:
    cells = gather_all(judge(COMPARED, ClosureParams(), BOX))
    for pair in (("003", "001"), ("001", "003")):
        picture = matrix_html("all", cells, 5.0, pair)
        assert 'data-testid="shown-pair" data-row="3" data-column="1"' in picture
    assert "shown-pair" not in matrix_html("all", cells, 5.0, ("003", "of another dataset"))


def test_many_submaps_are_shown_in_blocks_and_one_block_pair_by_pair() -> None:
    judged = many(150, 12)
    whole = gather_all(judged)
    assert (len(whole.rows), len(whole.rows[0])) == (50, 3)
    cell = whole.cells[7, 6]  # 021 to 023 with 018 to 020
    assert (cell.query, cell.database, cell.score) == ("0023", "0018", 5.0)
    assert (cell.num_pairs, cell.outcome) == (9, "accepted")  # the worst that an unknown truth has
    assert whole.cells[7, 7].num_pairs == 3  # half of a block on the diagonal
    assert (20, 5) not in whole.cells  # the shortlist left it out
    block = gather_block(judged, whole, ("0022", "0019"))
    assert block is not None
    assert block.rows == tuple((f"{k:04d}",) for k in range(21, 24))
    assert block.columns == tuple((f"{k:04d}",) for k in range(18, 21))
    assert block.cells[1, 1].score == 3.0
    assert len(block.cells) == 9
    picture = matrix_html("block", block, 30.0, ("0022", "0019"))
    assert 'data-testid="shown-pair" data-row="1" data-column="1"' in picture
    assert gather_block(judged, whole, ("0022", "of another dataset")) is None
    assert gather_block(judged_at(3.0), gather_all(judged_at(3.0)), ("003", "000")) is None


def test_the_worst_outcome_of_a_block_is_told() -> None:
    judged = judged_at(1.5)
    ids = tuple(submap.id for submap in COMPARED.dataset.submaps)
    (cell,) = gather(judged, (ids,), (ids,)).cells.values()
    assert (cell.query, cell.database, cell.outcome) == ("003", "000", "no overlap")
    assert cell.num_pairs == 6


@pytest.mark.slow
def test_the_size_of_the_pictures_does_not_grow_with_the_number_of_submaps() -> None:
    for count in (120, 900):
        judged = many(count, 30)
        whole = gather_all(judged)
        assert max(len(whole.rows), len(whole.columns)) <= MOST_GROUPS
        histogram = count_scores(judged)
        assert len(matrix_html("all", whole, 30.0)) < 250_000
        assert len(scores_html(judged, histogram)) < 40_000


def test_scores_are_counted_by_what_the_truth_says() -> None:
    histogram = count_scores(judged_at(3.0))
    assert {truth: int(counts.sum()) for truth, counts in histogram.counts.items()} == {
        "true": 1,
        "apart": 1,
        "unknown": 4,  # neighbours on the way and what barely touches: the rule leaves them out
    }
    html = scores_html(judged_at(3.0), histogram)  # beside them stands what the motions say
    assert "By the rule box IoU &gt; 0.3, whatever motion was found" in html
    assert "left out 4" in html
    assert histogram.high >= 6.0
    (place,) = np.flatnonzero(histogram.counts["true"])
    assert place == int(5.0 / histogram.high * len(histogram.counts["true"]))
    unknown = count_scores(many(50, 5))
    assert unknown.counts["unknown"].sum() == len(many(50, 5).closures)


def test_scores_are_drawn_without_the_threshold_so_that_a_drag_does_not_replace_them() -> None:
    low, high = judged_at(0.0), judged_at(4.5)
    assert scores_html(low, count_scores(low)) == scores_html(high, count_scores(high))
    assert "(4.5)" in threshold_html(4.5)


def test_wrong_and_missed_pairs_are_marked_by_name() -> None:
    def marks(min_score: float) -> list[list[str]]:
        judged = judged_at(min_score)
        marked = data_of(disagreements_html(judged, count_scores(judged)), "marks")
        assert isinstance(marked, list)
        return marked

    ((x, query, database, said),) = marks(5.5)
    assert (query, database) == ("003", "000")
    assert said.endswith("score 5.00 · missed")
    assert 30 < float(x) < 300
    assert marks(4.5) == []
    assert [mark[1:3] for mark in marks(1.5)][-1] == ["002", "000"]
    alone = many(10, 3)
    assert disagreements_html(alone, count_scores(alone)) == ""


def test_the_curve_has_a_point_where_the_thresholds_stand() -> None:
    def point(min_score: float) -> tuple[float, float]:
        judged = judged_at(min_score)
        points = data_of(scores_html(judged, count_scores(judged)), "points")
        assert isinstance(points, list)
        score, x, y = [point for point in points if point[0] >= min_score][-1]
        assert score >= min_score
        return x, y

    high, low = point(4.5), point(0.0)
    assert high[0] == low[0]  # the same recall
    assert high[1] < low[1]  # less precise is lower down


def test_there_is_no_point_where_nothing_is_accepted_and_no_curve_without_a_true_pair() -> None:
    none = judged_at(1000.0)
    assert none.check is not None
    assert np.isnan(none.check.precision)
    assert none.check.recall == 0.0
    picture = scores_html(none, count_scores(none))
    points = data_of(picture, "points")
    assert isinstance(points, list)
    assert all(point[0] < 1000.0 for point in points)
    assert "polyline" in picture
    impossible = judge(COMPARED, ClosureParams(), Rule("box", 0.98))
    picture = scores_html(impossible, count_scores(impossible))
    assert "polyline" not in picture
    assert "operating-point" not in picture


@pytest.mark.parametrize("count", [2, 4])
def test_a_matrix_of_no_pairs_is_no_error(count: int) -> None:
    judged = judge(COMPARED, ClosureParams(), BOX)
    assert np.isfinite(judged.top_score)
    none = many(count, 0)
    assert np.isfinite(none.top_score)
    assert "affinity-all" in matrix_html("all", gather_all(none), none.top_score)
    assert scores_html(none, count_scores(none)) == ""
