"""Explore, Demo and the pose graph, without a browser."""

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import viser

from app.viewer.features import canvas as canvas_module
from app.viewer.features.demo.story import MOTION_SECONDS
from app.viewer.features.pairs.pose_graph import PoseGraphTab, result_rows
from app.viewer.features.params.tab import ParamsTab
from app.viewer.features.session import Session
from app.viewer.features.world import tab as explore_module
from app.viewer.features.world.scene import LOOP_PIECES
from app.viewer.features.world.submaps import WorldOptions
from app.viewer.scene.cameras import place_on_screen, view_of
from app.viewer.scene.placement import UNKNOWN_CANVAS, Canvas
from app.viewer.session.session_file import Opened
from app.viewer.session.state import ViewOptions, ViewState
from gpgrad_core.detection import PairResult
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import trajectory_error
from gpgrad_core.types import Dataset, LoopClosure, Registration
from tests.support.desk import changes, judge, uses
from tests.support.page import FakePage, ProtocolPage
from tests.support.synthetic import (
    NUMBERS,
    T_DATABASE_QUERY,
    FakePipeline,
    make_dataset,
    make_result,
)
from tests.support.waiting import until
from tests.support.widgets import find, html_says, node, run_command, said, user_presses, user_sets

DRIFT = SE2(0.15, -0.1, 0.025)
"""What odometry is off from each submap to the next."""


def drifted() -> Dataset:
    """Submaps whose odometry drifts off their true poses."""
    dataset = make_dataset()
    submaps, off = [], SE2()
    for submap in dataset.submaps:
        true = submap.pose_odometry
        assert true is not None
        believed = true.planar @ off
        half = believed.yaw / 2
        odometry = Pose(
            np.array([believed.x, believed.y, 0.0]),
            np.array([0.0, 0.0, np.sin(half), np.cos(half)]),
        )
        submaps.append(replace(submap, pose_true=true, pose_odometry=odometry))
        off = off @ DRIFT
    return replace(dataset, submaps=tuple(submaps))


DATASET = drifted()


def closure(query: str, database: str, motion: SE2 | None = None, score: float = 5.0) -> Any:
    poses = {submap.id: submap.pose_true for submap in DATASET.submaps}
    a, b = poses[database], poses[query]
    assert a is not None
    assert b is not None
    true = a.planar.inverse() @ b.planar
    registration = Registration(
        motion or true,
        np.ones(20, bool),
        0.5,
        15.0,
        0.9,
        score,
        covariance=np.diag([0.02, 0.02, 0.005]) ** 2,
    )
    return LoopClosure(query, database, registration, score >= 3, f"score {score}")


CLOSURES = (
    closure("002", "000"),
    closure("003", "000"),
    closure("003", "001", SE2(3.0, 3.0, 1.0), score=1.0),
)


def make_true_result(state: ViewState) -> PairResult:
    """Make a result whose maps are those of the true ground."""
    true = tuple(
        replace(submap, pose_odometry=submap.pose_true) for submap in state.dataset.submaps
    )
    return make_result(replace(state, dataset=replace(state.dataset, submaps=true)))


OPENED = Opened(DATASET, NUMBERS, "", None, NUMBERS)
OTHER = Opened(make_dataset(60, name="other"), NUMBERS, "", None, NUMBERS)


@pytest.fixture
def server(gui: viser.ViserServer) -> viser.ViserServer:
    return gui


@pytest.fixture
def session(
    shared: tuple[viser.ViserServer, Session],
    pipeline: FakePipeline,
    monkeypatch: pytest.MonkeyPatch,
) -> Session:
    """The shared session with another graph, and what moves arrives at once."""
    pipeline.make = make_true_result
    for motion in MOTION_SECONDS:
        monkeypatch.setitem(MOTION_SECONDS, motion, 0.02)
    monkeypatch.setattr(explore_module, "RELAXING_SECONDS", 0.02)
    server, session = shared
    user_sets(find(server, "Mode"), "Tune")
    user_sets(find(server, "Colour by"), WorldOptions().color)
    for opened in (OTHER, OPENED):
        session.desk.open(opened)
    changes(session, options=ViewOptions())
    return session


@pytest.fixture
def page(server: viser.ViserServer) -> Iterator[ProtocolPage]:
    made = ProtocolPage(f"http://127.0.0.1:{server.get_port()}")
    yield made
    made.close()


def host_of(session: Session) -> Any:
    return session.desk.host


def go(session: Session, mode: str) -> None:
    uses(session, "Mode", mode)


def graph(session: Session) -> PoseGraphTab:
    return session.pose_graph


def message(session: Session) -> str:
    return said(host_of(session), "graph-error") + said(host_of(session), "graph-message")


def test_the_world_is_drawn_when_it_is_looked_at(session: Session) -> None:
    assert node(host_of(session), "/world/submaps/0") is None
    go(session, "Explore")
    assert not node(host_of(session), "/pair").visible
    assert node(host_of(session), "/world").visible
    assert len(node(host_of(session), "/world/submaps/3/surface").points) > 100
    assert find(host_of(session), "Poses").options == ("odometry", "true")
    go(session, "Tune")
    assert node(host_of(session), "/pair").visible
    assert not node(host_of(session), "/world").visible


def test_a_click_chooses_the_submap_under_it(session: Session, page: ProtocolPage) -> None:
    go(session, "Explore")
    position = np.array(node(host_of(session), "/world/submaps/2").position)
    above = np.add(position, (0.0, 0.0, 20.0)).tolist()
    page.click_scene(above, (0.0, 0.0, -1.0))
    # The click is taken in a thread of the page's, which nothing here waits for.
    until(
        lambda: getattr(node(host_of(session), "/world/selected"), "visible", False), "the outline"
    )
    assert find(host_of(session), "Submap").value == "002"
    until(lambda: said(host_of(session), "submap-figures"), "the figures")
    figures = said(host_of(session), "submap-figures")
    assert "1,500" in figures
    assert "odometry off by" in figures
    run_command(host_of(session), "Next submap")
    assert find(host_of(session), "Submap").value == "003"
    uses(session, "Tune it as", "query")
    assert session.state.query_id == "003"
    assert node(host_of(session), "/pair").visible


def test_names_are_seen_at_the_ground_in_the_middle_of_their_submaps(session: Session) -> None:
    go(session, "Explore")
    scene = session.world.scene
    camera, terrain = scene.camera(), scene.terrain
    assert camera is not None
    assert terrain is not None
    names = scene.names
    assert {"000", "003"} <= names.keys()
    middles = np.array([terrain.poses[name].translation for name in names])
    middles[:, 2] = terrain.heights_near(middles[:, :2])
    labels, places = (
        place_on_screen(camera, UNKNOWN_CANVAS, points)
        for points in (np.array(list(names.values())), middles - scene.origin)
    )
    assert np.linalg.norm(labels - places, axis=1).max() < 12.0  # [pixels]


def test_a_click_on_an_arch_opens_its_pair(session: Session, page: ProtocolPage) -> None:
    go(session, "Explore")
    judge(session.desk, CLOSURES)
    scene = session.world.scene
    loop = next(one for one in scene.arches if one.pair == ("002", "000"))
    arch = scene.arch((loop.query_id, loop.database_id))
    piece = arch[LOOP_PIECES // 2 :][:2].mean(axis=0).astype(float)
    sight = (piece + np.array([0.0, 0.0, 20.0])), np.array([0.0, 0.0, -1.0])
    hit = scene.arch_at(*sight, 0.001)
    assert hit is not None
    names, card = session.world.look(*sight, 0.001)
    assert names == (hit.query_id, hit.database_id)
    assert "Loop closure" in card
    assert f"{hit.query_id} → {hit.database_id}" in card
    page.click_scene(tuple(sight[0].tolist()), (0.0, 0.0, -1.0))
    until(lambda: session.desk.now.mode == "Tune", "the pair")
    assert (session.state.query_id, session.state.database_id) == hit.pair


def test_colours_that_need_maps_make_them(session: Session) -> None:
    go(session, "Explore")
    uses(session, "Colour by", "deviation")
    explore = session.world
    assert "Standard deviation" in said(host_of(session), "legend")
    assert "median deviation" not in said(host_of(session), "submap-figures")
    explore.select("000")
    assert session.wait_idle(120)
    assert "median deviation" in said(host_of(session), "submap-figures")


def test_the_map_relaxes_by_the_accepted_closures(session: Session) -> None:
    go(session, "Explore")
    judge(session.desk, tuple(replace(closure, accepted=False) for closure in CLOSURES))
    user_presses(find(host_of(session), "Optimise"))
    assert "No closure is accepted" in message(session)
    judge(session.desk, CLOSURES)
    assert "2 loop closures accepted of 3 pairs" in said(host_of(session), "graph-summary")
    assert "0 of 0 odometry neighbours" in said(host_of(session), "graph-summary")
    assert node(host_of(session), "/world/loops/2").visible
    before = np.array(node(host_of(session), "/world/submaps/3").position)
    uses(session, "Optimise")
    assert find(host_of(session), "Poses").value == "corrected"
    assert (
        np.linalg.norm(np.array(node(host_of(session), "/world/submaps/3").position) - before) > 0.2
    )
    solved = graph(session).graph
    assert solved is not None
    rows = dict(result_rows(DATASET, solved, 0.1))
    first, last = (float(text.split()[0]) for text in rows["error (ATE)"].split("→"))
    assert last < 0.25 * first
    assert rows["loop closures used"] == "2 of 2"
    assert rows["odometry neighbours"] == "0 of 0"


def test_a_page_sees_all_of_the_relaxed_map_unless_its_camera_was_moved_by_hand(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    go(session, "Explore")
    judge(session.desk, CLOSURES)
    canvas, still, moved = Canvas(1280.0, 1000.0), FakePage(), FakePage()
    there: dict[int, Any] = {0: still, 1: moved}
    for module in (explore_module, canvas_module):
        monkeypatch.setattr(module, "pages", lambda _: there)
    for page in there.values():
        html_says(session.desk.bridge, "canvas", page, **vars(canvas))
    assert session.wait_idle(120)
    before = view_of(still)
    assert before == session.world.scene.camera(canvas)
    moved.camera.position = (7.0, -7.0, 30.0)
    by_hand = view_of(moved)
    uses(session, "Optimise")
    assert view_of(still) == session.world.scene.camera(canvas) != before
    assert view_of(moved) == by_hand


def test_one_slider_moves_the_map_from_before_to_after(session: Session) -> None:
    go(session, "Explore")
    slider = find(host_of(session), "Before → after")
    assert not slider.visible
    judge(session.desk, CLOSURES)
    uses(session, "Optimise")
    assert slider.visible
    assert slider.value == 1.0
    found = graph(session).graph
    assert found is not None
    solved = found.centred
    places: dict[float, Any] = {}  # from the first on: until then the map may still glide
    for share in (0.0, 0.4, 1.0):
        user_sets(slider, share)
        assert session.wait_idle(120)
        places[share] = np.array(node(host_of(session), "/world/submaps/3").position)
        moved = places[share] - places[0.0]
        way = solved.at(share)["003"].translation - solved.at(0.0)["003"].translation
        np.testing.assert_allclose(moved, way, atol=1e-9)
        world = session.world.world
        assert world is not None
        np.testing.assert_allclose(
            world.poses["003"].translation, solved.at(share)["003"].translation
        )  # of which the ground is merged by now
    world = session.world.world
    assert world is not None
    dataset = world.dataset
    off = trajectory_error(dataset.true_poses, dataset.odometry).absolute
    rows = re.sub("<[^>]*>", " ", said(host_of(session), "world-figures"))
    assert f"odometry is off by {off:.2f} m" in " ".join(rows.split())
    go(session, "Tune")
    assert not slider.visible


def sliders(session: Session) -> Any:
    (params,) = (tab for tab in session.desk.features if isinstance(tab, ParamsTab))
    return params.container


def test_the_rail_of_the_map_has_no_pair(session: Session, page: ProtocolPage) -> None:
    card = session.pair._verdict
    assert card.visible
    go(session, "Explore")
    judge(session.desk, CLOSURES)
    assert not card.visible
    assert not sliders(session).visible
    figures = said(host_of(session), "world-figures")
    assert "loop closures" in figures
    assert "odometry neighbours" in figures
    position = np.array(node(host_of(session), "/world/submaps/2").position)
    page.click_scene(np.add(position, (0.0, 0.0, 20.0)).tolist(), (0.0, 0.0, -1.0))
    until(lambda: said(host_of(session), "place"), "the place")
    assert "seen by" in said(host_of(session), "place")
    assert "±" in said(host_of(session), "place")
    go(session, "Tune")
    assert card.visible
    assert sliders(session).visible


def test_decisions_by_hand_change_the_graph_and_are_undone(session: Session) -> None:
    go(session, "Explore")
    judge(session.desk, CLOSURES)
    uses(session, "Optimise")
    listed = find(host_of(session), "Loop")
    assert [label[:9] for label in listed.options[1:]] == ["002 → 000", "003 → 000", "003 → 001"]
    assert "χ²" in listed.options[1]
    user_sets(find(host_of(session), "By hand"), "accept")
    assert "Choose a closure first" in message(session)
    user_sets(listed, listed.options[1])
    user_sets(find(host_of(session), "By hand"), "refuse")
    assert [closure.accepted for closure in session.desk.closures] == [False, True, False]
    assert "optimise again" in said(host_of(session), "graph-summary")
    user_presses(find(host_of(session), "Undo decision"))
    assert [closure.accepted for closure in session.desk.closures] == [True, True, False]
    assert "optimise again" not in said(host_of(session), "graph-summary")
    assert find(host_of(session), "Undo decision").disabled


def test_what_was_cancelled_stays_so(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    go(session, "Explore")
    monkeypatch.setitem(vars(graph(session)), "_find_closures", lambda: None)
    user_presses(find(host_of(session), "Optimise"))
    session.desk.update_pairs(lambda pairs: pairs._replace(fraction=0.5))
    session.desk.update_pairs(lambda pairs: pairs._replace(fraction=None, message="Cancelled."))
    judge(session.desk, CLOSURES)
    assert graph(session).graph is None


def test_another_dataset_has_another_graph(session: Session) -> None:
    go(session, "Explore")
    judge(session.desk, CLOSURES)
    session.desk.open(Opened(make_dataset(name="other"), NUMBERS, "", None, NUMBERS))
    assert session.wait_idle(120)
    assert session.desk.closures == ()
    assert "No closures yet" in said(host_of(session), "graph-summary")
    assert find(host_of(session), "Poses").options == ("odometry",)


def test_a_closure_glides_into_place(session: Session) -> None:
    go(session, "Demo")
    uses(session, "Play", "closure")
    assert session.state.options.layout == "registered"
    assert find(host_of(session), "Layout").value == "registered"
    registered = np.array(node(host_of(session), "/pair/query").position)
    database = np.array(node(host_of(session), "/pair/database").position)
    state = session.state
    there = T_DATABASE_QUERY.apply(state.query.centre[None, :2])[0] - state.database.centre[:2]
    np.testing.assert_allclose((registered - database)[:2], there, atol=1e-6)
    user_sets(find(host_of(session), "Play"), "pose graph")
    assert "Optimise the pose graph in Explore first" in said(host_of(session), "demo-error")


def test_the_query_is_nudged_and_refined(session: Session, page: ProtocolPage) -> None:
    uses(session, "Move the query", True)
    gizmo = node(host_of(session), "/pair/nudge")
    start = np.array(node(host_of(session), "/pair/query").position)
    place = np.add(gizmo.position, (0.15, -0.1, 0.0)).tolist()
    page.move_gizmo("/pair/nudge", place, np.array(gizmo.wxyz).tolist())
    until(lambda: bool(np.any(node(host_of(session), "/pair/query").position != start)), "the move")
    moved = np.array(node(host_of(session), "/pair/query").position)
    np.testing.assert_allclose((moved - start)[:2], [0.15, -0.1], atol=1e-6)
    assert find(host_of(session), "Use in the pose graph").disabled
    uses(session, "Refine")
    back = np.array(node(host_of(session), "/pair/query").position)
    np.testing.assert_allclose(back[:2], start[:2], atol=0.05)
    user_presses(find(host_of(session), "Use in the pose graph"))
    (used,) = session.desk.closures
    assert (used.query_id, used.database_id, used.accepted) == ("003", "000", True)
    uses(session, "Move the query", False)
    assert node(host_of(session), "/pair/nudge") is None
