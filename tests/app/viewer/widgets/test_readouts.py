import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import viser

from app.viewer.features.data.folders import Listing
from app.viewer.features.data.tab import place_html
from app.viewer.features.pair.panel import DatasetSummary
from app.viewer.features.pair.status import status_html
from app.viewer.features.pair.verdict import VerdictCard, figures_html, verdict_html
from app.viewer.features.save.tab import command_html
from app.viewer.scene.colors import legend_uri
from app.viewer.scene.layers import Scale
from app.viewer.session.state import NEEDS_TWO, ViewState, open_dataset, with_params
from app.viewer.widgets.html import AMBER_GROUND
from app.viewer.widgets.legend import legend_html
from app.viewer.widgets.status import WorkBar
from gpgrad_core.detection import PairResult, PipelineParams
from gpgrad_core.detection.verdict import ClosureParams, classify
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Agreement, Dataset, Registration, Submap
from tests.support.synthetic import make_dataset, make_result, needing

STATE = open_dataset(make_dataset(), PipelineParams())
LONE = open_dataset(replace(STATE.dataset, submaps=STATE.dataset.submaps[:1]), STATE.params)


def html_of(panel: object) -> str:
    """Join what a panel's HTML widgets say."""
    return "".join(
        handle.content for handle in vars(panel).values() if isinstance(handle, viser.GuiHtmlHandle)
    )


def card_and_figures(state: ViewState, result: PairResult) -> str:
    return verdict_html(state, result) + figures_html(state, result)


def judged(registration: Registration, limits: ClosureParams | None = None) -> PairResult:
    """Make a result of a registration, as the limits judge it."""
    closure = classify(registration, limits or STATE.params.closure)
    return replace(make_result(STATE), registration=registration, closure=closure)


def text_of(html: str) -> str:
    """Leave the tags out."""
    return re.sub(r"<[^>]*>", " ", html)


def test_the_card_is_a_verdict_with_its_score_its_rule_and_three_sentences() -> None:
    text = " ".join(text_of(verdict_html(STATE, with_evidence(7.7))).split())
    assert text == (
        "Loop closure Score 4.2, above the threshold of 3.0 "
        "Both submaps show the same place; what speaks against it weighs less. "
        "▼ Heights differ by 3 cm; noise explains 1 cm: inconsistent (3.0 times, limit 1.5). "
        "▲ 12 keypoints agree. ▼ They share 1 m²."
    )


def test_the_figures_of_an_accepted_pair_have_units() -> None:
    state = open_dataset(make_dataset(), needing(8))
    html = card_and_figures(state, make_result(state))
    for words in (
        ">Loop closure<",
        "12 keypoints agree; at least 8 are needed.",
        "12 of 17 (at least 8)",
        ">Score 4.2, above",
        "+90.0°",
        "+1.00 m, -0.50 m",
        "12.5 m²",
        "0.93",
        "threshold of 3.0",
    ):
        assert words in html


@pytest.mark.parametrize(
    ("decided", "said"), [(True, "Accepted by hand"), (False, "Refused by hand")]
)
def test_what_a_person_decided_leads_the_card(decided: bool, said: str) -> None:
    html = verdict_html(STATE, make_result(STATE), decided=decided)
    assert f">{said}<" in html
    assert ">By the ground alone: Loop closure. Both submaps show the same place.<" in html
    assert "by hand" not in verdict_html(STATE, make_result(STATE))


def with_evidence(*evidence: float) -> PairResult:
    """Make a result whose terrain was compared."""
    result = make_result(STATE)
    registration = replace(
        result.registration,
        evidence=evidence,
        scale=0.2,
        agreement=Agreement(0.03, 0.01, 0.2),
        overlap_area=1.0,
    )
    return replace(result, registration=registration)


def test_card_and_figures_tell_what_spoke_for_and_against() -> None:
    result = with_evidence(7.7, 2.5, -4.25)
    html = figures_html(STATE, result)
    for words in (
        "1.3 to 2.5 m, evidence +2.5",
        "2.5 to 5.0 m, evidence -4.2",
        "12 of 17, evidence +7.7",
    ):
        assert words in html
    assert html.count("▲") == 2  # short waves, inliers
    assert html.count("▼") == 2  # long waves, a small overlap
    assert figures_html(STATE, with_evidence(7.7, 0.1, 0.0)).count("○") == 2
    card = verdict_html(STATE, result)
    # Keypoints; heights and little ground.
    assert (card.count("▲"), card.count("▼")) == (1, 2)


@pytest.mark.parametrize(
    ("difference", "value", "mark"),
    [(0.0072, "7.2 mm", "▲"), (0.0078, "7.8 mm", "▼"), (250.0, "250.0 m", "▼")],
)
def test_the_heights_speak_as_their_figures_do(difference: float, value: str, mark: str) -> None:
    result = with_evidence(7.7)
    agreement = Agreement(difference, 0.005, 0.2)
    registration = replace(result.registration, agreement=agreement)
    html = verdict_html(STATE, replace(result, registration=registration))
    before, after = html.split("Heights differ", 1)
    assert after.startswith(f" by {value}; noise explains 5 mm: ")
    assert ("inconsistent" in after) == (mark == "▼")
    assert before[before.rindex("title=") :].count(mark) == 1


def test_no_figure_is_a_negative_zero() -> None:
    result = with_evidence(-0.01, -0.04)
    registration = replace(
        result.registration, T_database_query=SE2(-0.001, -0.004, -1e-4), correlation=-0.001
    )
    html = card_and_figures(STATE, replace(result, registration=registration))
    assert "+0.00 m, +0.00 m, +0.0°" in html
    assert '>correlation</td><td style="font-variant-numeric:tabular-nums">0.00<' in html
    assert "-0.0" not in html


@pytest.mark.parametrize(
    ("score", "lowest", "words", "fill"),
    [
        (4.2, 1.5, "Score 4.2, far above the threshold of 1.5", "reached"),
        (4.2, 3.9, "Score 4.2, just above the threshold of 3.9", "reached"),
        (4.2, 6.0, "Score 4.2, below the threshold of 6.0", "short"),
        (4.2, 900.0, "Score 4.2, far below the threshold of 900.0", "short"),
        (4.2, 0.0, "Score 4.2; no threshold", "reached"),
        (9.496, 9.5, "Score 9.496, just below the threshold of 9.5", "short"),  # as 9.5 it is none
        (9.54, 9.5, "Score 9.5, just above the threshold of 9.5", "reached"),
    ],
)
def test_the_bar_shows_the_threshold(score: float, lowest: float, words: str, fill: str) -> None:
    state = with_params(STATE, PipelineParams(closure=ClosureParams(min_score=lowest)))
    registration = replace(make_result(state).registration, score=score)
    html = verdict_html(state, judged(registration, state.params.closure))
    assert f'aria-label="{words}"' in html
    assert f">{words}<" in html
    assert f'<i class="{fill}">' in html
    assert f"--score:{min(score / 12, 1):.1%};--needed:{min(lowest / 12, 1):.1%}" in html


def test_a_rule_that_compares_other_numbers_is_named() -> None:
    limits = ClosureParams(max_mean_dissimilarity=0.02)
    state = with_params(STATE, PipelineParams(closure=limits))
    registration = replace(with_evidence(7.7).registration, mean_dissimilarity=0.5)
    html = verdict_html(state, judged(registration, limits))
    assert "Dissimilarity of a cell 0.5 &gt; 0.02. The gradients of the two maps differ" in html


def test_where_all_is_masked_nothing_is_judged() -> None:
    hidden = {"T_database_query": None, "nothing_trusted": True, "score": 0.0}
    html = verdict_html(STATE, judged(replace(make_result(STATE).registration, **hidden)))  # type: ignore[arg-type]
    assert ">Cannot judge<" in html
    assert "Score" not in html
    assert "oop closure<" not in html


def test_a_card_follows_a_hand_and_the_next_result(server: viser.ViserServer) -> None:
    card = VerdictCard(server)
    card.show(STATE, make_result(STATE))
    card.set_moved(True)
    assert "Moved by hand, not judged" in html_of(card)
    assert ">Loop closure<" not in html_of(card)
    card.set_moved(False)
    assert ">Loop closure<" in html_of(card)
    card.outdate("out of date")
    assert "out of date" in html_of(card)
    assert ">Loop closure<" in html_of(card)
    nowhere = replace(make_result(STATE).registration, T_database_query=None)
    card.show(STATE, judged(nowhere))
    assert "out of date" not in html_of(card)
    assert "none found" in html_of(card)
    assert "yaw" not in html_of(card)


@pytest.mark.parametrize(
    ("changes", "headline", "words"),
    [
        ({"agreement": Agreement(0.03, 0.01, 0.2)}, "No loop closure", "heights do not fit"),
        (
            {"agreement": Agreement(0.01, 0.01, 0.2)},
            "Undecided",
            "They share too little ground to tell.",
        ),
        (
            {"agreement": Agreement(0.01, 0.01, 0.02), "overlap_area": 50.0},
            "Undecided",
            "too smooth to tell: its relief is 2 cm, and noise explains 1 cm.",
        ),
        (
            {"agreement": Agreement(0.01, 0.01, 0.2), "overlap_area": 50.0},
            "No loop closure",
            "can agree as well",
        ),
        ({"agreement": None}, "Undecided", "They share too little ground to compare."),
        ({"T_database_query": None}, "No loop closure", "have too little in common"),
    ],
)
def test_a_low_score_is_explained(changes: dict[str, object], headline: str, words: str) -> None:
    result = with_evidence(2.0, -1.0, -1.0)
    registration = replace(result.registration, score=1.0, **changes)  # type: ignore[arg-type]
    html = verdict_html(STATE, judged(registration))
    assert f">{headline}<" in html
    assert words in html
    assert (AMBER_GROUND in html) == (headline == "Undecided")


def test_the_card_tells_a_refused_pair_and_why() -> None:
    state = open_dataset(make_dataset(), needing(20))
    html = verdict_html(state, make_result(state))
    assert ">No loop closure<" in html
    assert "12 keypoints agree; at least 20 are needed." in html
    assert "Too few keypoints agree." in html
    assert "12 inliers &lt; 20" in html  # the reason as closures.json has it, in the tooltip


def test_one_submap_alone_is_no_pair(server: viser.ViserServer) -> None:
    card = VerdictCard(server)
    card.show(STATE, make_result(STATE))
    card.show(LONE, None)
    assert NEEDS_TWO in html_of(card)
    assert "Score" not in html_of(card)
    card.outdate("out of date")
    assert "out of date" in html_of(card)
    assert NEEDS_TWO in html_of(card)


def test_names_cannot_bring_markup_into_the_page(server: viser.ViserServer) -> None:
    evil = "<img src=x onerror=alert(1)>"
    submap = Submap.from_points(np.random.default_rng(0).normal(size=(9, 3)), evil)
    dataset = Dataset(evil, (submap,), description=evil, notes=(evil,))
    state = open_dataset(dataset, PipelineParams())
    summary, bar = DatasetSummary(server), WorkBar(server, "Cancel loading", "dataset")
    summary.show(dataset)
    place = place_html(Path("root"), Listing(Path(evil), (evil,), is_dataset=True))
    bar.running(evil, 0.0)
    shown = html_of(summary) + place + command_html(f"gpgrad detect {evil}</textarea>")
    shown += bar.said
    bar.failed(evil)
    shown += bar.said + status_html(evil, "red", title=evil)
    result = make_result(STATE)
    shown += verdict_html(
        state, replace(result, closure=replace(result.closure, query_id=evil, reason=evil))
    )
    shown += legend_html(Scale(evil, evil, "viridis", 0.0, 1.0), note=evil)
    assert "<img src=x" not in shown
    assert shown.count("</textarea>") == 1
    assert "&lt;img src=x" in shown


@pytest.mark.parametrize(
    ("low", "high", "texts"),
    [
        (0.0, 1.0, (">0.00<", ">0.50<", ">1.00<")),
        (-0.02, 0.02, (">-0.020<", ">0.000<", ">0.020<")),
        (100.0, 900.0, (">100<", ">500<", ">900<")),
        (2.0, 2.0, (">2.0000<",)),
    ],
)
def test_the_legend_has_ends_and_a_unit(low: float, high: float, texts: tuple[str, ...]) -> None:
    html = legend_html(Scale("Elevation", "m", "viridis", low, high))
    assert "Elevation" in html
    assert "[m]" in html
    for text in texts:
        assert text in html


def test_the_legend_stands_under_its_histogram_and_above_its_note() -> None:
    scale = Scale("Mask", "m", "viridis", 0.0, 1.0)
    html = legend_html(scale, histogram="<svg/>", note="12 cells")
    assert html.index("<svg/>") < html.index(legend_uri(scale.bars)) < html.index("12 cells")
