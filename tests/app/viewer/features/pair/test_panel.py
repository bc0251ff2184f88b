from dataclasses import replace

import pytest
import viser

from app.viewer.features.pair.panel import DatasetSummary, ViewPanel
from app.viewer.scene.layers import Scale
from app.viewer.session.state import ViewOptions, open_dataset
from gpgrad_core.detection import PipelineParams
from tests.support.synthetic import make_dataset
from tests.support.widgets import find, user_sets

STATE = open_dataset(make_dataset(), PipelineParams())


def test_what_is_open_and_what_loading_left_out_is_shown(server: viser.ViserServer) -> None:
    summary = DatasetSummary(server)
    summary.show(replace(STATE.dataset, notes=("003.ply: 7 rows dropped",)))
    assert "hills · 4 submaps" in summary.html
    assert "003.ply: 7 rows dropped" in summary.html


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
    assert reported[-1] == panel.value
    assert panel.value == ViewOptions(
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


def test_a_range_is_typed_locked_let_go_and_picked(server: viser.ViserServer) -> None:
    reported: list[ViewOptions] = []
    panel = ViewPanel(server, ViewOptions(), reported.append)
    panel.show_range(Scale("Gradient", "m/m", "ember", 0.0, 0.8))
    assert find(server, "Range").value == (0.0, 0.8)
    user_sets(find(server, "Range"), (0.9, 0.8))  # half typed
    assert not reported
    user_sets(find(server, "Range"), (0.1, 0.8))
    assert reported[-1].ends == (0.1, 0.8)
    assert replace(reported[-1], layer="std").ends is None
    user_sets(find(server, "Lock range"), False)
    assert reported[-1] == ViewOptions()
    panel.pick(0.25, 0.75)
    assert reported[-1].picked_values == pytest.approx((0.2, 0.6))
    panel.pick(0.4, 0.4)  # a click on what is picked
    assert reported[-1] == ViewOptions()
    panel.pick(0.501, 0.501)
    assert reported[-1].picked_values == pytest.approx((0.4, 0.416))


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


def test_what_a_layout_does_not_show_is_not_offered(server: viser.ViserServer) -> None:
    options = ViewOptions(layer="mask", clouds=True, surfaces=False)
    panel = ViewPanel(server, options, lambda _: None)
    labels = "Layer", "Surfaces", "Point clouds", "Point size"
    offered = [find(server, label) for label in labels]
    assert all(handle.visible for handle in offered)
    assert not find(server, "Colours").visible
    panel.set(replace(options, layout="gradient from above"))
    assert not any(handle.visible for handle in offered)
    assert find(server, "Colours").visible  # of the surfaces, which this layout shows
    panel.set(replace(options, layout="registered"))
    assert all(handle.visible for handle in offered)


def test_what_belongs_to_a_layer_is_shown_while_it_is(server: viser.ViserServer) -> None:
    panel = ViewPanel(server, ViewOptions(), lambda _: None)

    def shown(*labels: str) -> list[bool]:
        return [find(server, label).visible for label in labels]

    belongs = "Colours", "Hillshade", "Masked cells", "All lines", "Point size"
    assert shown(*belongs) == [True, True, True, True, False]
    user_sets(find(server, "Surfaces"), False)
    user_sets(find(server, "Points left out"), True)
    user_sets(find(server, "Inlier lines"), False)
    assert shown(*belongs) == [False, False, False, False, True]
    panel.set(ViewOptions(layout="registered", outlier_lines=True, inlier_lines=False))
    assert shown(*belongs, "Raw frames") == [True, True, True, True, False, False]
