from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import viser

from app.state import ViewOptions, ViewState, open_dataset, with_options, with_pair
from app.views import scene as scene_module
from app.views.associations import ARC_PIECES
from app.views.scene import PairScene, round_length
from gpgrad_core.pipeline import PipelineParams
from tests.app.synthetic import T_DATABASE_QUERY, make_dataset, make_map, make_result, needing

STATE = open_dataset(make_dataset(), PipelineParams())
RESULT = make_result(STATE)


def node(server: viser.ViserServer, name: str) -> Any:
    return server.scene._handle_from_node_name[name]


def count_messages(server: viser.ViserServer) -> int:
    return server._websock_server._broadcast_buffer.message_counter


def seeing(**options: object) -> ViewState:
    return with_options(STATE, replace(ViewOptions(), **options))


def test_a_pair_is_shown_with_names_and_sizes(server: viser.ViserServer) -> None:
    shown = PairScene(server).show(STATE, RESULT)
    assert shown.num_surfels == sum(
        len(node(server, f"/pair/{role}/surface").points) for role in ("query", "database")
    )
    assert shown.num_points == 0
    assert shown.scale is not None
    assert shown.scale.unit == "m"
    assert "query 003 · 5.0 m x 5.0 m" in node(server, "/pair/query/label").text
    assert "database 000" in node(server, "/pair/database/label").text
    assert node(server, "/pair/scale/label").text == "1 m"


@pytest.fixture
def conversions(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the conversions made, as they are made."""
    made: list[str] = []
    for name in ("make_surfels", "match_lines", "keypoint_dots"):
        original = getattr(scene_module, name)

        def watched(*args: Any, _name: str = name, _original: Any = original, **kwargs: Any) -> Any:
            made.append(_name)
            return _original(*args, **kwargs)

        monkeypatch.setattr(scene_module, name, watched)
    return made


def test_nothing_is_made_twice(server: viser.ViserServer, conversions: list[str]) -> None:
    scene = PairScene(server)
    scene.show(STATE, RESULT)
    assert sorted(set(conversions)) == ["keypoint_dots", "make_surfels", "match_lines"]
    conversions.clear()
    before = count_messages(server)
    scene.show(seeing(), RESULT)
    assert conversions == []
    assert count_messages(server) == before


def test_moving_an_inlier_slider_leaves_the_surfaces_alone(
    server: viser.ViserServer, conversions: list[str]
) -> None:
    scene = PairScene(server)
    scene.show(STATE, RESULT)
    conversions.clear()
    state = open_dataset(STATE.dataset, needing(20))
    other = replace(make_result(state, num_inliers=3), query_map=RESULT.query_map)
    other = replace(other, database_map=RESULT.database_map)
    scene.show(state, other)
    assert "make_surfels" not in conversions
    assert len(node(server, "/pair/matches/inliers").points) == 3 * ARC_PIECES


def test_the_nodes_of_a_surface_are_changed_in_place(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    scene.show(STATE, RESULT)
    handle = node(server, "/pair/query/surface")
    colors = handle.colors.copy()  # viser writes into it
    scene.show(seeing(layer="std"), RESULT)
    assert node(server, "/pair/query/surface") is handle
    assert not np.array_equal(handle.colors, colors)
    assert handle.precision == "float32"
    assert handle.point_shading == "flat"


def test_registering_moves_the_frame_and_not_what_hangs_on_it(
    server: viser.ViserServer,
) -> None:
    scene = PairScene(server)
    state = seeing(layer="gradient")
    scene.show(state, RESULT)
    points = node(server, "/pair/query/surface").points.copy()
    assert tuple(node(server, "/pair/query").wxyz) == (1.0, 0.0, 0.0, 0.0)
    shown = scene.show(seeing(layer="gradient", layout="registered"), RESULT)
    assert shown.registered
    frames = node(server, "/pair/query"), node(server, "/pair/database")
    assert 2 * np.arctan2(frames[0].wxyz[3], frames[0].wxyz[0]) == pytest.approx(
        T_DATABASE_QUERY.yaw
    )
    offset = np.array(frames[0].position) - np.array(frames[1].position)
    np.testing.assert_allclose(offset[:2], (T_DATABASE_QUERY.x, T_DATABASE_QUERY.y))
    assert np.array_equal(node(server, "/pair/query/surface").points, points)


def test_each_switch_hides_and_shows_its_nodes(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    everything = {"clouds": True, "outlier_lines": True}
    scene.show(seeing(**everything), RESULT)
    nodes = {
        "surfaces": "/pair/query/surface",
        "clouds": "/pair/database/cloud",
        "keypoints": "/pair/query/keypoints",
        "inlier_lines": "/pair/matches/inliers",
        "outlier_lines": "/pair/matches/outliers",
    }
    for option, name in nodes.items():
        assert node(server, name).visible
        scene.show(seeing(**(everything | {option: False})), RESULT)
        assert not node(server, name).visible, option
        scene.show(seeing(**everything), RESULT)
        assert node(server, name).visible, option


def test_no_association_is_no_error(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    state = seeing(outlier_lines=True)
    scene.show(state, make_result(STATE, num_inliers=4, num_outliers=3))
    scene.show(state, make_result(STATE, num_inliers=0, num_outliers=0))
    assert not node(server, "/pair/matches/inliers").visible
    assert not node(server, "/pair/matches/outliers").visible


def test_a_mask_that_hides_everything_is_no_error(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    scene.show(STATE, RESULT)
    params = replace(STATE.params, features=replace(STATE.params.features, max_std_ratio=0.01))
    shown = scene.show(replace(STATE, params=params), RESULT)
    assert 0 < shown.num_surfels < 100  # the true maps are sure in the very middle only
    sure = replace(RESULT.query_map, variance=RESULT.query_map.variance + 1.0)
    shown = scene.show(STATE, replace(RESULT, query_map=sure, database_map=sure))
    assert shown.num_surfels == 0
    assert not node(server, "/pair/query/surface").visible


def test_without_a_motion_registered_falls_back_to_side_by_side(
    server: viser.ViserServer,
) -> None:
    lost = replace(RESULT, registration=replace(RESULT.registration, T_database_query=None))
    assert not PairScene(server).show(seeing(layout="registered"), lost).registered


def test_new_pages_begin_with_both_submaps_in_view(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    camera = scene.camera(STATE)
    scene.start_camera(camera)
    np.testing.assert_allclose(server.initial_camera.position, camera.position)
    np.testing.assert_allclose(server.initial_camera.look_at, camera.look_at)


@pytest.mark.parametrize(
    ("longest", "length"), [(4.7, 2.0), (5.0, 5.0), (0.3, 0.2), (99.0, 50.0), (1.0, 1.0)]
)
def test_the_scale_bar_has_a_round_length(longest: float, length: float) -> None:
    assert round_length(longest) == pytest.approx(length)


def test_a_preview_brings_surfaces_and_leaves_what_was_found(
    server: viser.ViserServer, conversions: list[str]
) -> None:
    scene = PairScene(server)
    assert not scene.knows_motion(STATE)
    scene.show(seeing(layout="registered"), RESULT)
    assert scene.knows_motion(STATE)
    frame = np.array(node(server, "/pair/query").position)
    lines = len(node(server, "/pair/matches/inliers").points)
    conversions.clear()
    coarse = make_map(STATE.query, 0.3), make_map(STATE.database, 0.3)
    shown = scene.preview(seeing(layout="registered"), coarse)
    assert shown.registered
    assert shown.num_surfels == sum(int(m.trusted(0.3).sum()) for m in coarse)
    assert conversions == ["make_surfels", "make_surfels"]
    np.testing.assert_allclose(node(server, "/pair/query").position, frame, atol=0.05)
    assert node(server, "/pair/matches/inliers").visible
    assert len(node(server, "/pair/matches/inliers").points) == lines


def test_a_preview_of_another_pair_hides_what_was_found_on_the_last(
    server: viser.ViserServer,
) -> None:
    scene = PairScene(server)
    scene.show(STATE, RESULT)
    other = with_pair(STATE, query_id="001")
    assert not scene.knows_motion(other)
    maps = make_map(other.query, 0.3), make_map(other.database, 0.3)
    shown = scene.preview(with_options(other, ViewOptions(layout="registered")), maps)
    assert not shown.registered
    found = ("/pair/query/keypoints", "/pair/database/keypoints", "/pair/matches/inliers")
    assert not any(node(server, name).visible for name in found)
    assert node(server, "/pair/verdict").text == ""
    assert "query 001" in node(server, "/pair/query/label").text
    scene.show(STATE, RESULT)
    assert all(node(server, name).visible for name in found)


def test_the_pair_goes_out_of_sight_and_comes_back_as_it_was(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    scene.show(STATE, RESULT)
    points = node(server, "/pair/query/surface").points
    before = count_messages(server)
    scene.visible = False
    assert not scene.visible
    scene.visible = True
    assert count_messages(server) - before <= 2  # nothing is sent again
    assert node(server, "/pair/query/surface").points is points
