import re

import numpy as np

from app.viewer.all_pairs.curve import curve_svg
from app.viewer.all_pairs.judging import RULES, judge
from app.viewer.all_pairs.matrix import affinity_svg, highest_color, matrix_pixels
from app.viewer.draw.colors import lookup_table
from gpgrad_core.evaluation.rules import Rule
from gpgrad_core.loop_closure import ClosureParams
from tests.app.synthetic import make_compared

BOX = next(iter(RULES.values()))
COMPARED = make_compared()


def test_each_pair_has_the_colour_of_its_score_and_overlap() -> None:
    judged = judge(COMPARED, ClosureParams(), BOX)
    pixels = matrix_pixels(judged)
    viridis, greys = lookup_table("viridis"), lookup_table("grey")
    assert tuple(pixels[3, 0, :3]) == tuple(viridis[255])  # the highest score
    place = int(255 * 2.0 / highest_color(judged))
    assert tuple(pixels[2, 0, :3]) == tuple(viridis[place])
    assert tuple(pixels[0, 2, :3]) == tuple(greys[0])  # far apart
    assert pixels[0, 3, 0] > pixels[0, 2, 0]  # the revisit overlaps
    assert (pixels[range(4), range(4), 3] == 0).all()
    assert (pixels[..., 3] == 255).sum() == 12


def test_marks_follow_the_verdicts() -> None:
    def marks(min_score: float) -> list[str]:
        judged = judge(COMPARED, ClosureParams(0, min_score), BOX)
        return re.findall(r"<title>(\d+ → \d+: [\w ]+), score", affinity_svg(judged))

    assert marks(4.5) == ["003 → 000: right"]
    assert marks(5.5) == ["003 → 000: missed"]
    assert "002 → 000: no overlap" in marks(1.5)
    assert len(marks(0.0)) == 6


def test_the_pair_shown_is_pointed_at_whichever_way_round() -> None:
    judged = judge(COMPARED, ClosureParams(), BOX)
    for pair in (("003", "001"), ("001", "003")):
        assert 'data-testid="shown-pair" x="1" y="3"' in affinity_svg(judged, pair)
    assert "shown-pair" not in affinity_svg(judged, ("003", "of another dataset"))


def test_the_curve_has_a_point_where_the_thresholds_stand() -> None:
    def point(min_score: float) -> tuple[float, float]:
        check = judge(COMPARED, ClosureParams(0, min_score), BOX).check
        assert check is not None
        (found,) = re.findall(r'operating-point" cx="([\d.]+)" cy="([\d.]+)"', curve_svg(check))
        return float(found[0]), float(found[1])

    high, low = point(4.5), point(0.0)
    assert high[0] == low[0]  # the same recall
    assert high[1] < low[1]  # less precise is lower down


def test_there_is_no_point_where_nothing_is_accepted_and_no_curve_without_a_true_pair() -> None:
    none = judge(COMPARED, ClosureParams(0, 1000.0), BOX).check
    assert none is not None
    assert "operating-point" not in curve_svg(none)
    assert "polyline" in curve_svg(none)
    impossible = judge(COMPARED, ClosureParams(), Rule("box", 0.98)).check
    assert impossible is not None
    assert curve_svg(impossible) == ""


def test_a_matrix_of_no_pairs_is_no_error() -> None:
    judged = judge(COMPARED, ClosureParams(), BOX)
    assert np.isfinite(highest_color(judged))
