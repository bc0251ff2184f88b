from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import viser

from app.viewer.features.pair import nodes as nodes_module
from app.viewer.features.pair.picture import comparison_in_words
from app.viewer.features.pair.scene import PairScene
from app.viewer.features.pair.verdict import verdict_html
from app.viewer.scene.associations import ARC_PIECES
from app.viewer.scene.colors import DATABASE, QUERY, UNTRUSTED_GREY
from app.viewer.scene.placement import Canvas
from app.viewer.scene.probing import Ray, measure
from app.viewer.session.state import (
    Probe,
    ViewOptions,
    ViewState,
    open_dataset,
    with_pair,
)
from gpgrad_core.detection import PipelineParams
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Agreement
from tests.support.synthetic import T_DATABASE_QUERY, make_dataset, make_map, make_result, needing
from tests.support.waiting import until
from tests.support.widgets import node

STATE = open_dataset(make_dataset(), PipelineParams())
RESULT = make_result(STATE)
TILTED = 2e-3
"""How far a tilt of less than a degree moves the ground aside, over its height [m]."""


def seeing(**options: object) -> ViewState:
    return replace(STATE, options=replace(ViewOptions(), **options))


def test_a_pair_is_shown_with_names_and_sizes(server: viser.ViserServer) -> None:
    shown = PairScene(server).show(STATE, RESULT)
    assert shown.num_surfels == sum(
        len(node(server, f"/pair/{role}/surface").points) for role in ("query", "database")
    )
    assert shown.num_points == 0
    assert shown.scale is not None
    assert shown.scale.unit == "m/m"
    assert "query 003 · 5.0 m x 5.0 m" in node(server, "/pair/query/label").text
    assert "database 000" in node(server, "/pair/database/label").text
    assert node(server, "/pair/scale/label").text == "1 m"


def is_painted_anew(scene: PairScene, before: tuple[Any, ...]) -> bool:
    """Say whether the ground has other arrays of colours, equal or not, than those of before."""
    return any(now is not then for now, then in zip(scene.colors, before, strict=True))


def test_neither_options_nor_an_inlier_slider_paint_the_ground_anew(
    server: viser.ViserServer,
) -> None:
    scene = PairScene(server)
    scene.show(STATE, RESULT)
    before = scene.colors
    scene.show(seeing(), RESULT)
    assert not is_painted_anew(scene, before)
    state = open_dataset(STATE.dataset, needing(20))
    other = replace(make_result(state, num_inliers=3), query_map=RESULT.query_map)
    other = replace(other, database_map=RESULT.database_map)
    scene.show(state, other)
    assert not is_painted_anew(scene, before)
    assert len(node(server, "/pair/matches/inliers").points) == 3 * ARC_PIECES


def test_the_range_stays_while_a_slider_is_held_or_it_is_locked(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    usual = scene.show(STATE, RESULT).paint.scale
    steep = replace(RESULT.query_map, slope=3.0 * RESULT.query_map.slope)
    other = replace(RESULT, query_map=steep, database_map=steep)
    scene.hold_range(on=True)
    assert scene.show(seeing(layer="slope_x"), other).paint.scale.low < 0  # of its own
    assert scene.show(STATE, other).paint.scale == usual
    assert scene.hold_range(on=False)
    seen = list[float]()

    def look(_share: float) -> None:
        assert scene.picture is not None
        seen.append(scene.picture.paint.scale.high)

    scene.ease_range(STATE, other, look)
    seen.append(scene.show(STATE, other).paint.scale.high)
    assert len(seen) > 4
    assert seen == sorted(set(seen))  # from one end to the other, no step back
    assert seen[0] == usual.high
    scene.ease_range(STATE, other, look)  # nothing was let go
    assert seen[-1] == max(seen)
    locked = seeing(locked="gradient", low=0.1, high=0.7)
    scale = scene.show(locked, other).paint.scale
    assert (scale.low, scale.high) == (0.1, 0.7)
    options = replace(locked.options, layer="std")
    assert scene.show(replace(STATE, options=options), other).paint.scale.high != 0.7


def test_a_motion_that_moves_by_a_hair_paints_no_ground_anew(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    scene.show(seeing(layer="elevation"), RESULT)
    for step, painted in ((1e-7, False), (0.1, True)):  # [m], [rad]
        before = scene.colors
        moved = T_DATABASE_QUERY @ SE2(step, -step, step)
        registration = replace(RESULT.registration, T_database_query=moved)
        scene.show(seeing(layer="elevation"), replace(RESULT, registration=registration))
        assert is_painted_anew(scene, before) is painted


def test_the_association_pointed_at_stands_out_and_the_others_step_back(
    server: viser.ViserServer,
) -> None:
    scene = PairScene(server)
    ground = scene.show(STATE, RESULT)
    lines = node(server, "/pair/matches/inliers")
    bold, colors = lines.thickness, np.array(lines.colors)
    scene.show(replace(STATE, match=2), RESULT)
    chosen = node(server, "/pair/match/line")
    assert chosen.visible
    assert len(chosen.points) == ARC_PIECES
    assert node(server, "/pair/match/label").text == "association 2: inlier, residual 0.000 m"
    assert lines.thickness < bold < chosen.thickness
    assert not np.array_equal(lines.colors, colors)
    ends = node(server, "/pair/match/ends").points
    start = ground.placements[0].apply(np.append(RESULT.matches.query_xy[1], 0.0)[None])[0]
    np.testing.assert_allclose(ends[0, :2], start[:2], atol=1e-4)
    scene.show(replace(STATE, match=13), RESULT)
    assert "association 13: outlier, residual 1.414 m" in node(server, "/pair/match/label").text
    for number in (0, 99):  # none, and none of that number
        scene.show(replace(STATE, match=number), RESULT)
        assert not chosen.visible
        assert lines.thickness == bold


def test_a_place_is_marked_with_its_values_in_both_layouts(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    for layout in ("side by side", "registered"):
        state = replace(seeing(layout=layout), probe=Probe("query", 0.5, -0.25))
        placement = scene.show(state, RESULT).placements[0]
        point = node(server, "/pair/probe/point")
        assert point.visible
        np.testing.assert_allclose(
            point.points[0, :2], placement.apply(np.array([[0.5, -0.25, 0.0]]))[0, :2], atol=TILTED
        )
        assert " m · slope " in node(server, "/pair/probe/label").text
    scene.show(STATE, RESULT)
    assert not point.visible


@pytest.mark.parametrize("layout", ["side by side", "registered"])
def test_a_click_is_the_place_that_is_seen_there(server: viser.ViserServer, layout: str) -> None:
    scene = PairScene(server)
    assert scene.pick(Ray(np.array([0.0, 0.0, 9.0]), np.array([0.0, 0.0, -1.0]))) is None
    ground = scene.show(seeing(layout=layout), RESULT)
    for role, placement in zip(("query", "database"), ground.placements, strict=True):
        above = placement.apply(np.array([[0.3, 0.4, 0.0]]))[0] + np.array([0.0, 0.0, 9.0])
        probe = scene.pick(Ray(above, np.array([0.0, 0.0, -1.0])))
        assert probe is not None
        if layout == "side by side":
            assert probe.role == role
            assert (probe.x, probe.y) == pytest.approx((0.3, 0.4), abs=TILTED)
    scene.visible = False
    assert scene.pick(Ray(above, np.array([0.0, 0.0, -1.0]))) is None


def test_each_way_of_comparing_shows_what_it_says(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    frames = node(server, "/pair/query"), node(server, "/pair/database")
    surfaces = (
        lambda: node(server, "/pair/query/surface").points,
        lambda: node(server, "/pair/database/surface").points,
    )

    def show(**options: Any) -> tuple[bool, bool]:
        scene.show(seeing(layout="registered", **options), RESULT)
        return tuple(frame.visible for frame in frames)  # type: ignore[return-value]

    assert show() == (True, True)
    whole = [len(points()) for points in surfaces]
    assert show(compare="query") == (True, False)
    assert show(compare="database") == (False, True)
    swiped = seeing(layout="registered", compare="swipe", swipe=0.5)
    ground = scene.show(swiped, RESULT)
    assert all(frame.visible for frame in frames)
    line = float(node(server, "/pair/swipe").points[0, 0, 0])
    for index, (points, count) in enumerate(zip(surfaces, whole, strict=True)):
        assert 0 < len(points()) < count
        x = ground.placements[index].apply(points().astype(np.float64))[:, 0]
        assert (x <= line).all() if index == 0 else (x > line).all()
    assert show() == (True, True)
    assert [len(points()) for points in surfaces] == whole
    assert not node(server, "/pair/swipe").visible
    scene.show(seeing(compare="query"), RESULT)  # side by side there is nothing to compare
    assert all(frame.visible for frame in frames)


def test_blinking_shows_one_after_the_other_until_it_ends(
    server: viser.ViserServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(nodes_module, "PERIOD", 0.02)
    scene = PairScene(server)
    frames = node(server, "/pair/query"), node(server, "/pair/database")
    scene.show(seeing(layout="registered", compare="blink"), RESULT)
    seen: set[tuple[bool, bool]] = set()

    def both_seen() -> bool:
        seen.add((frames[0].visible, frames[1].visible))
        return {(True, False), (False, True)} <= seen

    until(both_seen, "one after the other")
    scene.show(seeing(layout="registered"), RESULT)
    assert all(frame.visible for frame in frames)
    scene.show(seeing(layout="registered", compare="blink"), RESULT)
    scene.close()
    scene.close()


def test_the_height_difference_is_told_as_on_the_card(server: viser.ViserServer) -> None:
    agreement = Agreement(difference=0.009, possible=0.0064, relief=0.2)
    result = replace(RESULT, registration=replace(RESULT.registration, agreement=agreement))
    state = seeing(layout="registered", layer="difference")
    words = comparison_in_words(PairScene(server).show(state, result))
    assert words.startswith("; heights differ by 9 mm ")
    assert "Heights differ by 9 mm;" in verdict_html(state, result)


def test_the_height_difference_colours_both_maps_alike_and_grey_where_only_one_saw(
    server: viser.ViserServer,
) -> None:
    scene = PairScene(server)
    shown = scene.show(seeing(layout="registered", layer="difference"), RESULT)
    assert shown.scale is not None
    assert shown.scale.unit == "m"
    assert shown.scale.low == -shown.scale.high
    assert "root mean square 0.00" in comparison_in_words(shown)  # the true motion
    colors = node(server, "/pair/query/surface").colors
    grey = (colors == UNTRUSTED_GREY).all(axis=-1)
    assert 0 < grey.sum() < len(grey)
    again = scene.show(seeing(layout="registered", layer="difference", keypoints=False), RESULT)
    assert again.paint is shown.paint
    lost = replace(RESULT, registration=replace(RESULT.registration, T_database_query=None))
    scene.show(seeing(layer="difference"), lost)
    assert (node(server, "/pair/query/surface").colors == UNTRUSTED_GREY).all()


def test_from_above_both_show_the_gradient_and_the_matched_place(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    above = seeing(layout="gradient from above", layer="mask", clouds=True)
    shown = scene.show(above, RESULT)
    assert shown.scale is not None
    assert shown.scale.unit == "m/m"
    assert shown.num_points == 0
    assert not shown.is_registered
    camera = scene.camera(above)
    across = np.hypot(*(np.array(camera.position) - camera.look_at)[:2])
    assert across < 0.01 * (camera.position[2] - camera.look_at[2])
    place = Probe("database", 0.4, -0.3)
    here, there = shown.spots(place)
    x, y = T_DATABASE_QUERY.inverse().apply(np.array([[0.4, -0.3]]))[0]
    at_query, at_database = shown.placements
    np.testing.assert_allclose(here[:2], at_database.apply(np.array([[0.4, -0.3, 0.0]]))[0, :2])
    np.testing.assert_allclose(
        there[:2], at_query.apply(np.array([[x, y, 0.0]]))[0, :2], atol=TILTED
    )
    assert shown.spots(Probe("database", 99.0, 0.0)) == ()
    scene.show(replace(above, probe=place), RESULT)
    assert node(server, "/pair/probe/other").visible
    scene.show(replace(seeing(layout="registered"), probe=place), RESULT)
    assert not node(server, "/pair/probe/other").visible


def test_a_ruler_lies_on_the_ground_of_both(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    scene.show(STATE, RESULT)
    ends = Probe("database", -0.5, 0.2), Probe("database", 0.5, 0.2)
    ruler = measure(RESULT.maps, ends, T_DATABASE_QUERY, 0.0, 0.5)
    scene.show_ruler(ruler)
    for role in ("query", "database"):
        assert node(server, f"/pair/ruler/{role}").visible
    assert node(server, "/pair/ruler/label").text == "1.00 m"
    scene.show_ruler(None)
    assert not node(server, "/pair/ruler/database").visible
    assert not node(server, "/pair/ruler/label").visible


@pytest.mark.parametrize("standalone", [False, True])
def test_only_a_scene_of_its_own_says_what_it_is_and_no_label_is_without_a_word(
    server: viser.ViserServer, standalone: bool
) -> None:
    PairScene(server, standalone=standalone).show(STATE, RESULT)
    assert (node(server, "/pair/scale/label") is not None) is standalone
    names = ("scale/label", "match/label", "probe/label", "ruler/label", "query/label")
    labels = [node(server, f"/pair/{name}") for name in names]
    assert all(label.text for label in labels if label is not None)


def test_in_a_tall_and_small_canvas_names_stand_apart_and_marks_are_small(
    server: viser.ViserServer,
) -> None:
    scene = PairScene(server)
    scene.show(seeing(other_keypoints=True), RESULT)
    marks = [
        node(server, f"/pair/query/keypoints/{number}/{part}")
        for number in (0, 1)
        for part in ("rim", "core")
    ]
    usual = [mark.thickness for mark in marks]
    scene.tall, scene.mark_scale = True, Canvas(390.0, 300.0).mark_scale
    assert scene.mark_scale < Canvas(1440.0, 900.0).mark_scale == 1.0
    scene.show(seeing(other_keypoints=True), RESULT)
    assert [mark.thickness for mark in marks] == [scene.mark_scale * width for width in usual]
    query, database = (node(server, f"/pair/{role}/label") for role in ("query", "database"))
    assert query.anchor.startswith("bottom")
    assert database.anchor.startswith("top")


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


def test_registering_moves_the_frame_and_not_what_hangs_on_it(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    scene.show(seeing(layer="gradient", raw_frames=True), RESULT)
    points = node(server, "/pair/query/surface").points.copy()
    assert tuple(node(server, "/pair/query").wxyz) == (1.0, 0.0, 0.0, 0.0)
    shown = scene.show(seeing(layer="gradient", layout="registered"), RESULT)
    assert shown.is_registered
    frames = node(server, "/pair/query"), node(server, "/pair/database")
    assert 2 * np.arctan2(frames[0].wxyz[3], frames[0].wxyz[0]) == pytest.approx(
        T_DATABASE_QUERY.yaw
    )
    offset = np.array(frames[0].position) - np.array(frames[1].position)
    query, database = STATE.query.centre[:2], STATE.database.centre[:2]
    np.testing.assert_allclose(offset[:2], T_DATABASE_QUERY.apply(query[None])[0] - database)
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


def test_points_left_out_are_shown_red_but_not_those_far_outside(server: viser.ViserServer) -> None:
    scene, query = PairScene(server), STATE.query
    left_out = np.vstack([query.points[:5] + np.array([0.0, 0.0, 1.0]), [[0.0, 0.0, 1e6]]])
    spoilt = replace(query, left_out=left_out)
    others = tuple(spoilt if one is query else one for one in STATE.dataset.submaps)
    state = replace(seeing(left_out=True), dataset=replace(STATE.dataset, submaps=others))
    scene.show(state, RESULT)
    shown = node(server, "/pair/query/cloud")
    np.testing.assert_allclose(shown.points, left_out[:5] - query.centre, atol=1e-5)
    scene.show(replace(state, options=replace(state.options, clouds=True)), RESULT)
    assert len(shown.points) == len(query.points) + 5
    assert len(np.unique(shown.colors, axis=0)) == 2
    scene.show(seeing(left_out=True), RESULT)
    assert not shown.visible


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


def test_without_a_motion_registered_falls_back_to_side_by_side_where_both_are_seen(
    server: viser.ViserServer,
) -> None:
    lost = replace(RESULT, registration=replace(RESULT.registration, T_database_query=None))
    picture = PairScene(server).show(seeing(layout="registered", compare="query"), lost)
    assert not picture.is_registered
    assert picture.roles == ("query", "database")


def test_a_preview_brings_surfaces_and_leaves_what_was_found(server: viser.ViserServer) -> None:
    scene = PairScene(server)
    assert not scene.knows_motion(STATE)
    scene.show(seeing(layout="registered"), RESULT)
    assert scene.knows_motion(STATE)
    frame = np.array(node(server, "/pair/query").position)
    lines = len(node(server, "/pair/matches/inliers").points)
    before = scene.colors
    coarse = make_map(STATE.query, 0.3), make_map(STATE.database, 0.3)
    shown = scene.preview(seeing(layout="registered"), coarse)
    assert shown.is_registered
    assert shown.num_surfels == sum(int(m.trusted(0.3).sum()) for m in coarse)
    assert is_painted_anew(scene, before)
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
    shown = scene.preview(replace(other, options=ViewOptions(layout="registered")), maps)
    assert not shown.is_registered
    drawn = ("/pair/query/keypoints", "/pair/database/keypoints", "/pair/matches/inliers")
    assert not any(node(server, name).visible for name in drawn)
    assert "query 001" in node(server, "/pair/query/label").text
    scene.show(STATE, RESULT)
    assert all(node(server, name).visible for name in drawn)


def test_side_by_side_the_query_stands_in_the_databases_frame_unless_frames_are_raw(
    server: viser.ViserServer,
) -> None:
    scene = PairScene(server)
    assert not scene.turns(STATE)  # nothing is known yet
    ground = scene.show(STATE, RESULT)
    assert scene.turns(STATE)
    assert ground.placements[0].yaw == T_DATABASE_QUERY.yaw
    turned = round(np.degrees(T_DATABASE_QUERY.yaw))
    assert f"frame of the database: query turned {turned:+d}°" in ground.note
    arcs = node(server, "/pair/matches/inliers").points.reshape(-1, ARC_PIECES, 2, 3)
    along = arcs[:, -1, 1, :2] - arcs[:, 0, 0, :2]
    assert np.degrees(np.ptp(np.unwrap(np.arctan2(along[:, 1], along[:, 0])))) < 5.0
    raw = seeing(raw_frames=True)
    ground = scene.show(raw, RESULT)
    assert not scene.turns(raw)
    assert ground.placements[0].yaw == 0.0
    assert ground.note == ""


def test_registered_the_query_is_blue_and_the_database_orange_and_the_legend_says_so(
    server: viser.ViserServer,
) -> None:
    scene = PairScene(server)
    for layer in ("gradient", "elevation"):
        shown = scene.show(seeing(layout="registered", layer=layer), RESULT)
        query, database = (
            node(server, f"/pair/{role}/surface").colors.astype(int)
            for role in ("query", "database")
        )
        assert (query[:, 2] >= query[:, 0]).all()
        assert (database[:, 0] >= database[:, 2]).all()
        assert shown.scale is not None
        assert shown.scale.tints == (QUERY, DATABASE)
        assert shown.note.endswith("blue query, orange database")
    shown = scene.show(seeing(layout="registered", layer="difference"), RESULT)
    assert shown.scale is not None
    assert shown.scale.tints == ()  # its colours say how they differ
