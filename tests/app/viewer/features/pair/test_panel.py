from dataclasses import replace

import viser

from app.viewer.features.pair.panel import DatasetSummary, PairPanel, ViewPanel
from app.viewer.session.state import ViewOptions, open_dataset
from gpgrad_core.detection import PipelineParams
from tests.support.synthetic import make_dataset
from tests.support.widgets import find, user_sets

STATE = open_dataset(make_dataset(), PipelineParams())
LONE = open_dataset(replace(STATE.dataset, submaps=STATE.dataset.submaps[:1]), STATE.params)


def test_what_is_open_and_what_loading_left_out_is_shown(server: viser.ViserServer) -> None:
    summary = DatasetSummary(server)
    summary.show(replace(STATE.dataset, notes=("003.ply: 7 rows dropped",)))
    assert "hills · 4 submaps" in summary.html
    assert "003.ply: 7 rows dropped" in summary.html


def test_the_pair_is_chosen_and_stepped(server: viser.ViserServer) -> None:
    chosen: list[tuple[str, str]] = []
    panel = PairPanel(server, STATE, lambda query, database: chosen.append((query, database)))
    user_sets(find(server, "Query"), "002")
    user_sets(find(server, "Database"), "001")
    panel.step("query", 1)
    panel.step("query", 1)
    panel.step("database", -1)
    assert chosen == [
        ("002", "000"),
        ("002", "001"),
        ("003", "001"),
        ("000", "001"),
        ("000", "003"),  # 000 is the query and is passed over
    ]
    panel.show(open_dataset(make_dataset(), PipelineParams()))
    assert find(server, "Query").value == "003"
    assert len(chosen) == 5


def test_whoever_names_the_other_of_the_pair_has_them_change_places(
    server: viser.ViserServer,
) -> None:
    chosen: list[tuple[str, str]] = []
    panel = PairPanel(server, STATE, lambda query, database: chosen.append((query, database)))
    user_sets(find(server, "Query"), "000")
    user_sets(find(server, "Query"), "003")
    user_sets(find(server, "Database"), "003")
    assert chosen == [("000", "003"), ("003", "000"), ("000", "003")]
    assert (find(server, "Query").value, find(server, "Database").value) == ("000", "003")
    panel.show(LONE)
    assert not find(server, "Database").visible
    panel.step("query", 1)
    assert chosen[-1] == ("000", "000")
    panel.show(STATE)
    assert find(server, "Database").visible


def test_every_option_of_the_view_is_reported(server: viser.ViserServer) -> None:
    reported: list[ViewOptions] = []
    panel = ViewPanel(server, ViewOptions(), reported.append)
    for label, value in (
        ("Layout", "registered"),
        ("Layer", "standard deviation"),
        ("Colours", "turbo"),
        ("Surfaces", False),
        ("Point clouds", True),
        ("Points left out", True),
        ("Keypoints", False),
        ("Inlier lines", False),
        ("Outlier lines", True),
        ("Masked cells", "grey"),
        ("Hillshade", False),
        ("Point size", 0.1),
    ):
        user_sets(find(server, label), value)
    assert reported[-1] == panel.options
    assert panel.options == ViewOptions(
        layer="std",
        color_map="turbo",
        layout="registered",
        surfaces=False,
        clouds=True,
        left_out=True,
        untrusted="grey",
        hillshade=False,
        keypoints=False,
        inlier_lines=False,
        outlier_lines=True,
        point_size=0.1,
    )


def test_comparisons_are_offered_where_they_apply(server: viser.ViserServer) -> None:
    reported: list[ViewOptions] = []
    panel = ViewPanel(server, ViewOptions(), reported.append)
    compare, swipe = find(server, "Compare"), find(server, "Swipe")
    assert not compare.visible
    user_sets(find(server, "Layout"), "registered")
    assert compare.visible
    assert not swipe.visible
    user_sets(compare, "swipe")
    assert swipe.visible
    user_sets(swipe, 0.25)
    assert (reported[-1].compare, reported[-1].swipe) == ("swipe", 0.25)
    panel.set(ViewOptions(layer="difference", layout="registered", compare="query"))
    assert compare.value == "query only"
    assert not swipe.visible
    assert find(server, "Layer").value == "height difference"
    assert len(reported) == 3
