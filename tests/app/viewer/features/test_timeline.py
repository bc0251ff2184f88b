"""The time line of a session, without a browser."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import viser

from app.viewer.features.pairs.all_pairs import AllPairsTab
from app.viewer.features.session import Session
from app.viewer.features.world import Timeline, World
from app.viewer.scene.layers import Scale
from app.viewer.session.decisions import with_verdict
from app.viewer.session.jobs import Capacity
from app.viewer.session.session_file import Opened
from gpgrad_core.detection import MapDetector, detect_loop_closures
from gpgrad_core.run.memo import Memo
from gpgrad_core.slam import Drive, build_pose_graph, optimise_pose_graph
from tests.support.server import started_server
from tests.support.synthetic import make_dataset, needing
from tests.support.waiting import PATIENCE, until
from tests.support.widgets import html_says, said

NUMBERS = needing(8)
DATASET = make_dataset(num_points=400)
MEMO = Memo()
"""Holds what the drives of all tests compute of the submaps."""
OPENED = Opened(DATASET, NUMBERS, "", None, NUMBERS)


def asks(session: Session, act: str, value: float = 0.0) -> None:
    html_says(session.desk.bridge, "timeline", act=act, value=value)


def data(timeline: Timeline) -> dict[str, object]:
    return timeline._data()


def is_at_rest(timeline: Timeline) -> bool:
    told = data(timeline)
    return not told["playing"] and not told["busy"]


def test_nothing_is_computed_before_it_is_asked_for(session: Session) -> None:
    assert data(session.timeline)["ready"] == 0
    assert data(session.timeline)["shown"] is False
    session.desk.update(lambda now: replace(now, subject="world"))
    assert data(session.timeline)["shown"] is True
    assert session.timeline.moments == ()


@pytest.mark.slow
def test_it_plays_to_the_end_and_ends_as_all_at_once(session: Session) -> None:
    timeline = session.timeline
    asks(session, "speed")
    asks(session, "speed")
    asks(session, "play")
    until(lambda: is_at_rest(timeline), "the end")
    assert data(timeline)["at"] == 3
    together = detect_loop_closures(DATASET, NUMBERS)
    graph = optimise_pose_graph(build_pose_graph(DATASET, together.closures))
    np.testing.assert_array_equal(timeline.moments[-1].places, graph.history[-1])
    assert session.wait_idle(PATIENCE)
    world = session.world.world
    assert world is not None
    assert world.past is not None
    assert list(world.poses) == ["000", "001", "002", "003"]
    centre = graph.poses["003"].apply(DATASET.submap("003").centre[None])[0]
    np.testing.assert_array_equal(world.poses["003"].translation, centre)


def test_it_stands_where_it_is_put_and_the_whole_comes_back(session: Session) -> None:
    timeline = session.timeline
    asks(session, "at", 1)
    until(lambda: is_at_rest(timeline), "the drive")
    assert session.wait_idle(PATIENCE)
    world = session.world.world
    assert world is not None
    assert list(world.poses) == ["000", "001"]
    asks(session, "step", 1)
    asks(session, "step", -1)
    assert data(timeline)["at"] == 1
    asks(session, "at", 1e9)  # no page of ours says so
    assert data(timeline)["at"] == 3
    asks(session, "leave")
    assert session.wait_idle(PATIENCE)
    assert session.world.world is not None
    assert session.world.world.past is None


def test_at_rest_no_submap_is_just_coming(session: Session) -> None:
    world = session.world
    asks(session, "at", 1)
    until(lambda: is_at_rest(session.timeline), "the drive")
    assert session.wait_idle(PATIENCE)

    def words() -> str:
        assert world.world is not None
        return "" if world.world.past is None else world.world.past.words

    asks(session, "play")
    until(lambda: "has just come" in words(), "a submap that comes")
    asks(session, "play")
    assert session.wait_idle(PATIENCE)
    assert "has just come" not in words()


@pytest.mark.slow
def test_other_thresholds_are_judged_anew_where_it_stands(
    open_session: Callable[..., Session],
) -> None:
    session = open_session(make_dataset(), NUMBERS)
    timeline, desk = session.timeline, session.desk
    asks(session, "at", 3)
    until(lambda: is_at_rest(timeline), "the drive")
    accepted = [closure.database_id for closure in timeline.moments[3].accepted]
    assert accepted
    asked = desk.state.asked
    strict = replace(asked, closure=replace(asked.closure, min_score=100.0))
    desk.change(params=strict, moving=True)
    assert is_at_rest(timeline)  # a hand is still on it
    desk.release(strict)
    until(lambda: is_at_rest(timeline) and not timeline.moments[3].accepted, "other verdicts")
    assert data(timeline)["at"] == 3
    desk.change(params=asked)
    until(lambda: is_at_rest(timeline) and bool(timeline.moments[3].accepted), "as before")
    assert [closure.database_id for closure in timeline.moments[3].accepted] == accepted


def test_without_odometry_it_says_why_there_is_no_drive(
    open_session: Callable[..., Session],
) -> None:
    bare = replace(
        DATASET,
        submaps=tuple(replace(submap, pose_odometry=None) for submap in DATASET.submaps),
    )
    session = open_session(bare, NUMBERS)
    asks(session, "play")
    assert "no odometry" in str(data(session.timeline)["words"])
    assert is_at_rest(session.timeline)


@pytest.fixture
def live() -> Iterator[tuple[viser.ViserServer, Session, Drive]]:
    """A session that was opened on a drive of which two submaps have come."""
    with started_server() as server:
        drive = Drive(NUMBERS, detector=MapDetector(NUMBERS, MEMO), name="live")
        for submap in DATASET.submaps[:2]:
            drive.add(submap)
        so_far = replace(DATASET, name="live", submaps=DATASET.submaps[:2])
        opened = Opened(so_far, NUMBERS, "", None, NUMBERS, drive)
        session = Session(server, opened, MEMO, Capacity())
        yield server, session, drive
        session.close()
        drive.close()


def test_a_drive_is_followed_until_its_end(live: tuple[viser.ViserServer, Session, Drive]) -> None:
    _, session, drive = live
    assert session.wait_idle(PATIENCE)
    assert session.world.scene.visible  # what there is to see is the map
    assert data(session.timeline)["live"]
    drive.add(DATASET.submaps[2])
    assert session.wait_idle(PATIENCE)
    world = session.world.world
    assert world is not None
    assert list(world.poses) == ["000", "001", "002"]
    asks(session, "at", 0)  # who looks back is not disturbed
    drive.add(DATASET.submaps[3])
    assert session.wait_idle(PATIENCE)
    assert session.world.world is not None
    assert list(session.world.world.poses) == ["000"]
    drive.finish()
    assert session.wait_idle(PATIENCE)
    assert [submap.id for submap in session.state.dataset.submaps] == ["000", "001", "002", "003"]
    told = data(session.timeline)
    assert not told["live"]
    assert told["ready"] == 4
    assert (session.state.query_id, session.state.database_id) == ("003", "000")


def test_words_figures_and_pose_graph_tell_of_the_moment_that_is_drawn(
    live: tuple[viser.ViserServer, Session, Drive], monkeypatch: pytest.MonkeyPatch
) -> None:
    server, session, drive = live
    assert session.wait_idle(PATIENCE)
    scene, seen = session.world.scene, list[tuple[str, str]]()
    show = scene.show

    def told() -> tuple[str, str]:
        return str(data(session.timeline)["words"])[:3], said(server, "world-figures")

    def show_slowly(world: World, **how: Any) -> Scale | None:
        seen.append(told())  # whatever came meanwhile, the map is still that of before
        return show(world, **how)

    monkeypatch.setattr(scene, "show", show_slowly)
    for submap in DATASET.submaps[2:]:
        drive.add(submap)
    assert session.wait_idle(PATIENCE)
    words, figures = told()
    assert words == "003"
    assert "4 so far" in figures
    assert all(f"{int(words) + 1} so far" in figures for words, figures in seen)
    world = session.world.world
    assert world is not None
    loops, neighbours = world.num_accepted
    assert loops + neighbours > 0
    summary = said(server, "graph-summary")
    assert "No closures yet" not in summary
    assert f">{loops} loop closure" in summary
    assert f"and {neighbours} odometry neighbours." in summary


def test_all_that_came_is_known_on_request(live: tuple[viser.ViserServer, Session, Drive]) -> None:
    server, session, drive = live
    desk = session.desk
    comparison = next(f for f in desk.features if isinstance(f, AllPairsTab))

    def num_known() -> int:
        return len(session.state.dataset.submaps)

    session.desk.catch_up()
    drive.add(DATASET.submaps[2])
    assert num_known() == 2  # who tunes a pair is not disturbed
    html_says(desk.bridge, "pair-search", role="query", text="")  # the list is opened
    assert num_known() == 3
    desk.change(pair=("001", "000"))
    desk.decide(lambda decisions: with_verdict(decisions, ("001", "000"), accepted=False))
    drive.add(DATASET.submaps[3])
    comparison.compare_pairs()
    assert num_known() == 4
    assert session.wait_idle(PATIENCE)
    assert "in 6 pairs" in said(server)
    assert (session.state.query_id, session.state.database_id) == ("001", "000")
    assert desk.now.decisions.verdicts == {("001", "000"): False}
    drive.finish()
    assert (session.state.query_id, session.state.database_id) == ("001", "000")


def test_who_works_alone_follows_it_too(live: tuple[viser.ViserServer, Session, Drive]) -> None:
    _, session, drive = live
    drive.add(DATASET.submaps[2])
    with started_server() as server:
        alone = Session(server, session.desk.present(), session.desk.memo, Capacity())
        try:
            drive.add(DATASET.submaps[3])
            assert alone.wait_idle(PATIENCE)
            assert alone.world.world is not None
            assert list(alone.world.world.poses) == ["000", "001", "002", "003"]
            drive.finish()
            for each in (alone, session):
                assert len(each.state.dataset.submaps) == 4
        finally:
            alone.close()
