"""The paper's figures: which pair is shown, what captions say, and maps of odd shapes."""

from dataclasses import replace

import numpy as np
import pytest

from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import Evaluation, EvaluationParams, PrecisionRecall, evaluate
from gpgrad_core.evaluation.experiment import (
    TITLES,
    FigureData,
    ShownPair,
    ShownSubmap,
    check_method,
    choose,
    study,
)
from gpgrad_core.evaluation.plots.paper import (
    draw_figure_8,
    draw_figure_9,
    list_figures,
    mean_precision,
)
from gpgrad_core.evaluation.plots.style import COLUMN, PAGE, in_print, letter
from gpgrad_core.evaluation.plots.submaps import (
    aligning_poses,
    draw_figure_1,
    draw_figure_3,
    draw_figure_4,
    draw_figure_6,
    draw_figure_10,
)
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods import METHODS
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset, GradientMap, Grid, Matches
from tests.core.evaluation.squares import DATASET, RESULT, RIGHT, closure
from tests.core.slam.simulated import with_odometry

EVERY = frozenset(TITLES)
JUDGING = EvaluationParams(num_resamples=0)
EVALUATION = evaluate(DATASET, {"paper": RESULT}, JUDGING)


def a_map(width: float, height: float, step: float = 0.05) -> GradientMap:
    """Waves on a rectangle, known in its middle and unknown at its rim."""
    grid = Grid((0.0, 0.0), step, (int(height / step), int(width / step)))
    x, y = np.meshgrid(grid.x, grid.y)
    rim = np.maximum(np.abs(2 * x / width - 1), np.abs(2 * y / height - 1)) > 0.9
    slope = 0.3 * np.dstack([np.cos(x), np.sin(y)])
    return GradientMap(grid, 0.3 * np.sin(x), np.where(rim, 0.04, 1e-5), slope, 0.2, 0.3)


def shown(width: float, height: float, *, inliers: int = 2) -> ShownPair:
    at = np.array([[0.5, 0.5], [0.8, 0.4]])[:inliers]
    matches = Matches(np.tile(np.arange(inliers)[:, None], 2), np.zeros(inliers), at, at + 0.1)
    accepted = closure("003", "000", 9.0, RIGHT, inliers, accepted=True)
    query = ShownSubmap(DATASET.submap("003"), a_map(width, height), 0.3)
    database = ShownSubmap(DATASET.submap("000"), a_map(height, width), 0.3)
    return ShownPair(query, database, matches, accepted, RIGHT, right=True)


def subject_of(evaluation: Evaluation | None = None) -> FigureData:
    pair = shown(3.0, 4.0)
    return FigureData(DATASET, METHODS["paper"], pair.query, pair, evaluation)


def test_the_pair_that_is_shown_is_right_if_that_is_known() -> None:
    pairs = (
        closure("001", "000", 99.0, SE2(), 99, accepted=True),  # neighbours, and wrong
        closure("002", "000", 50.0, SE2(), 50, accepted=True),  # wrong
        closure("003", "000", 9.0, RIGHT, 20, accepted=True),
        closure("004", "003", 999.0, None, 0),
    )
    assert choose(DATASET, pairs, EVALUATION).pair == ("003", "000")
    assert choose(DATASET, pairs, None).pair == ("002", "000")
    refused = (pairs[3], closure("004", "000", 1.0, SE2(), 3), closure("004", "001", 9.0, SE2(), 2))
    assert choose(DATASET, refused, None).pair == ("004", "000")
    assert choose(DATASET, pairs[3:], EVALUATION) is None


def test_the_mean_precision_is_over_the_sets_of_which_a_pair_passes() -> None:
    at = np.array([1.0, 2.0, 3.0])
    first = PrecisionRecall(at, np.array([0.5, 1.0, np.nan]), np.array([1.0, 0.5, 0.0]))
    second = PrecisionRecall(at, np.array([0.7, np.nan, np.nan]), np.array([1.0, 0.0, 0.0]))
    assert mean_precision([first, second]) == pytest.approx([0.6, 1.0, np.nan], nan_ok=True)


def test_captions_say_what_was_found() -> None:
    figures, notes = list_figures([subject_of(EVALUATION)], EVERY)
    assert notes == []
    assert [figure.number for figure in figures] == sorted(EVERY)
    captions = {figure.number: figure.caption for figure in figures}
    for number in (1, 4, 10):
        said = "accepts the pair 003, 000: because. By the true poses this is right"
        assert said in captions[number]
    # By hand: of the false pairs, 003 and 001 have the most inliers, which are 6.
    assert "From n = 7 on, all pairs that pass are true." in captions[9]
    assert "A pair is true if the boxes' intersection over union" in captions[8]


def test_datasets_of_one_name_get_files_of_their_own() -> None:
    figures, notes = list_figures([subject_of()] * 2, frozenset({3, 8}))
    assert [figure.name for figure in figures] == ["figure_3_squares", "figure_3_squares_2"]
    assert len(notes) == 2
    assert "not in Fig. 8" in notes[0]


@pytest.mark.parametrize(
    ("width", "height", "inliers"),
    [
        (3.0, 4.0, 2),
        *(
            pytest.param(*shape, marks=pytest.mark.slow)
            for shape in ((3.0, 4.0, 0), (8.0, 0.6, 0), (8.0, 0.6, 2), (0.6, 8.0, 0), (0.6, 8.0, 2))
        ),
    ],
)
def test_maps_of_any_shape_are_drawn(width: float, height: float, inliers: int) -> None:
    pair = shown(width, height, inliers=inliers)
    with in_print():
        for figure, wide in (
            (draw_figure_1(DATASET, pair), PAGE),
            (draw_figure_3(pair.query), PAGE),
            (draw_figure_4(pair), COLUMN),
            (draw_figure_10(DATASET, pair), COLUMN),
        ):
            figure.set_dpi(30)
            figure.draw_without_rendering()
            assert figure.get_figwidth() == wide
            assert 1.0 < figure.get_figheight() < 9.5  # a page of a paper has no more


@pytest.mark.parametrize(
    "count", [1, *(pytest.param(many, marks=pytest.mark.slow) for many in (2, 5))]
)
def test_any_number_of_datasets_is_drawn(count: int) -> None:
    with in_print():
        for figure in (
            draw_figure_6([DATASET] * count),
            draw_figure_8([EVALUATION] * count),
            draw_figure_9([EVALUATION] * count),
        ):
            figure.draw_without_rendering()
            titles = [panel.get_title("left") for panel in figure.axes if panel.get_title("left")]
            assert titles in ([], ["squares"], [f"{letter(k)} squares" for k in range(count)])


def test_a_rule_that_calls_no_pair_true_is_told() -> None:
    params = EvaluationParams(num_resamples=0, min_overlap=0.99)
    subject = FigureData(
        DATASET, METHODS["paper"], evaluation=evaluate(DATASET, {"paper": RESULT}, params)
    )
    figures, notes = list_figures([subject], frozenset({8, 9}))
    assert [figure.number for figure in figures] == [8]
    assert notes == ["Fig. 9 left out: no pair of any dataset is true"]
    with in_print():
        (panel,) = figures[0].draw().axes
    assert [text.get_text() for text in panel.texts] == ["no pair is true"]


def without_true_poses(count: int) -> Dataset:
    submaps = [replace(submap, pose_true=None) for submap in DATASET.submaps[:count]]
    return Dataset("unknown", tuple(submaps))


COARSE = PipelineParams(MapParams(resolution=0.2, length_scale=1.0, signal_std=0.3, noise_std=0.05))


@pytest.mark.parametrize(
    ("method", "count", "numbers", "made", "said"),
    [
        ("chance", 2, {6}, [], "not in Fig. 6: fewer than two submaps have a pose"),
        ("chance", 2, {8}, [], "not in Fig. 8: fewer than two submaps have a true pose"),
        ("gradient", 1, {3}, [3], ""),
        ("gradient", 1, {1, 3}, [3], "Fig. 1 left out: one submap makes no pair"),
    ],
)
def test_what_a_dataset_without_poses_or_pairs_cannot_show_is_told(
    method: str, count: int, numbers: set[int], made: list[int], said: str
) -> None:
    dataset, fractions = without_true_poses(count), list[float]()
    which, hook = frozenset(numbers), fractions.append
    subject = study(dataset, [METHODS[method]], COARSE, JUDGING, which, progress=hook)
    assert fractions[-1] == 1.0
    assert subject.evaluation is None
    assert subject.pair is None
    assert (subject.shown is None) == (not made)
    figures, notes = list_figures([subject], which)
    assert [figure.number for figure in figures] == made
    assert [note.split(" (")[0] for note in notes] == ([f"unknown: {said}"] if said else [])


def test_curves_alone_need_no_submap_to_show() -> None:
    numbers = frozenset({8, 9})
    subject = study(DATASET, [METHODS["chance"]], COARSE, JUDGING, numbers)
    assert subject.shown is None
    assert subject.evaluation is not None
    figures, notes = list_figures([subject], numbers)
    assert [figure.number for figure in figures] == [8, 9]
    assert notes == []


def test_a_pair_without_poses_is_aligned_by_its_motion() -> None:
    pair = replace(shown(3.0, 4.0), right=None)
    driven = with_odometry(without_true_poses(5), lambda _: None)
    subject = FigureData(driven, METHODS["paper"], pair.query, pair)
    figures, notes = list_figures([subject, subject_of(EVALUATION)], EVERY)
    names = [figure.name for figure in figures if figure.name.endswith("unknown")]
    assert names == ["figure_1_unknown", "figure_3_unknown", "figure_4_unknown"]
    assert "both clouds aligned by the motion found" in figures[0].caption
    assert [note.split(": ")[1] for note in notes] == [
        "Fig. 10 left out",
        "not in Fig. 6",
        "not in Figs. 8 and 9",
    ]
    poses, _ = aligning_poses(driven, pair)
    moved = poses["000"].inverse() @ poses["003"]
    np.testing.assert_allclose(moved.planar.apply(np.ones((1, 2))), RIGHT.apply(np.ones((1, 2))))


def test_the_first_method_must_have_maps() -> None:
    for name in ("paper", "gradient", "elevation", "smoothed"):
        check_method(METHODS[name])
    with pytest.raises(InputError, match="--method chance: has no gradient maps"):
        check_method(METHODS["chance"])
