"""A robot and a viewer over a real socket: what is acknowledged is kept."""

import queue
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gpgrad_core as gg
import gpgrad_core.live.server
from gpgrad_core.io.poses import read_poses
from gpgrad_core.live.follower import Follower
from gpgrad_core.live.frames import LARGEST_FRAME, LENGTH, Corrected, Hello, frame_of, submitted
from gpgrad_core.live.keeping import Keeper
from gpgrad_core.live.server import MOST_ROBOTS, Server
from gpgrad_core.live.source import Arrival, Source
from gpgrad_core.run import Progress
from gpgrad_core.types import Submap
from tests.core.live.submaps import Track, assert_same_submap, row
from tests.support.refusal import assert_refused

SUBMAPS = row(5)


class Viewer:
    """All of a viewer that a robot knows of."""

    def __init__(self, file: Path, port: int = 0, **options: Any) -> None:
        self.track, self.said, self.file = Track(), list[str](), file
        self.keeper, self.server = Keeper(file), Server(port=port)
        self.follower = Follower(
            self.server,
            self.keeper,
            self.track.compare,
            self.said.append,
            track=file.with_suffix(".txt"),
            **options,
        )
        self.follower.start()
        self.address = f"localhost:{self.server.port}"

    def __enter__(self) -> "Viewer":
        return self

    def __exit__(self, *_: object) -> None:
        self.follower.close()
        self.keeper.close()
        assert self.follower.failure is None


@pytest.fixture
def there(tmp_path: Path) -> Iterator[Viewer]:
    with Viewer(tmp_path / "run.submaps") as made:
        yield made


def send(live: gg.Live, submap: Submap, *, wait: bool = True) -> dict[str, gg.Pose]:
    return dict(live.add(submap.points, submap.pose_odometry, id=submap.id, wait=wait))


def test_submaps_go_there_and_the_track_comes_back(there: Viewer) -> None:
    heard: list[int] = []
    with gg.Live(there.address, on_corrected=lambda track: heard.append(len(track))) as live:
        for submap in SUBMAPS:
            track = send(live, submap)
        assert list(track) == there.track.ids == [s.id for s in SUBMAPS]
        for submap in SUBMAPS:
            found, given = track[submap.id], submap.pose_odometry
            np.testing.assert_array_equal(found.translation, given.translation)
            assert_same_submap(there.keeper.submap(submap.id), submap)
        assert live.kept == set(there.track.ids)
        assert live.closures == {("003", "000")}
        _, *rows = there.file.with_suffix(".txt").read_text().splitlines()
        places = [[row.partition(" ")[2] for row in of] for of in (rows, live.tum_lines())]
        assert places[0] == places[1]
        assert there.said == ["submap 003 closes a loop with 000"]
    assert heard[-1] == len(SUBMAPS)


def test_a_connection_that_is_gone_before_it_is_taken_ends_no_other(
    there: Viewer, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone, really = [ConnectionAbortedError(), ConnectionAbortedError()], socket.socket.accept

    def accept(listening: socket.socket) -> tuple[socket.socket, object]:
        if gone:
            raise gone.pop()
        return really(listening)

    monkeypatch.setattr(socket.socket, "accept", accept)
    for submap in SUBMAPS[:2]:
        with gg.Live(there.address) as live:
            send(live, submap)
    assert there.track.ids == ["000", "001"]
    assert not gone


def test_at_rest_the_track_is_settled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gpgrad_core.live.follower.REST", 0.05)
    moved = gg.Pose.from_planar(gg.SE2(9.0, 0.0, 0.0))

    def settle(_: Progress) -> Corrected | None:
        return Corrected("000", {"000": moved.row}, [])

    heard: queue.Queue[float] = queue.Queue()

    def hear(track: Mapping[str, gg.Pose]) -> None:
        heard.put(track["000"].translation[0])

    with (
        Viewer(tmp_path / "kept", settle=settle) as there,
        gg.Live(there.address, on_corrected=hear) as live,
    ):
        send(live, SUBMAPS[0])
        assert [heard.get(timeout=60.0) for _ in range(2)] == [0.0, 9.0]
        assert "9.0" in there.file.with_suffix(".txt").read_text()


def test_doubled_and_contradicting_submaps(there: Viewer) -> None:
    with gg.Live(there.address) as live:
        send(live, SUBMAPS[0])
        send(live, SUBMAPS[0])
        other = replace(SUBMAPS[1], id="000")
        assert_refused(lambda: send(live, other), "000", "came before with another")
        line = np.linspace(0, 1, 30)[:, None] * np.ones(3)
        pose = SUBMAPS[0].pose_odometry
        assert_refused(lambda: live.add(line, pose, id="0"), "lie on one line")
        send(live, SUBMAPS[1])  # the connection stays
        assert there.track.ids == ["000", "001"]
        assert there.follower.wait(lambda counts: counts.compared == 2, 10.0)
        counts = there.follower.counts
        assert (counts.doubled, counts.refused) == (1, 1)
        assert counts.spelled() == "2 submaps compared; 1 doubled, 1 refused"


def test_nothing_is_acknowledged_before_it_is_kept(tmp_path: Path) -> None:
    kept_by_then: list[tuple[str, ...]] = []

    class Robot(Source):
        def news(self, stopped: threading.Event) -> Iterator[Arrival]:
            del stopped
            yield Arrival(SUBMAPS[0], lambda _: kept_by_then.append(keeper.names))

    with closing(Keeper(tmp_path / "kept")) as keeper:
        follower = Follower(Robot("robot"), keeper, Track().compare, print)
        follower.start()
        assert follower.wait(lambda counts: counts.compared == 1, 10.0)
        follower.close()
    assert kept_by_then == [("000",)]


def test_a_robot_that_comes_back_learns_what_is_kept_in_its_order(there: Viewer) -> None:
    with gg.Live(there.address) as live:
        for number in (0, 3, 1, 2):
            send(live, SUBMAPS[number], wait=False)
        assert there.follower.wait(lambda counts: counts.compared == 4, 20.0)
    with gg.Live(there.address) as live:
        assert live.kept == {"000", "001", "002", "003"}
        assert list(send(live, SUBMAPS[4])) == there.track.ids == [s.id for s in SUBMAPS]


def test_a_viewer_that_comes_back_has_all_that_it_acknowledged(tmp_path: Path) -> None:
    with Viewer(tmp_path / "kept") as there:
        port = there.server.port
        live = gg.Live(there.address)
        for submap in SUBMAPS[:3]:
            send(live, submap)
    with Viewer(tmp_path / "kept", port) as there:
        assert there.follower.wait(lambda counts: counts.compared == 3, 10.0)
        assert there.track.ids == ["000", "001", "002"]
        track = send(live, SUBMAPS[3])  # on the old connection, which is broken
        assert list(track) == ["000", "001", "002", "003"]
        assert live.kept == set(track)
        live.close()


def test_strangers_are_told_and_sent_away(there: Viewer) -> None:
    submap = SUBMAPS[0]
    early = frame_of(submitted(submap.points, submap.pose_odometry, "0"))
    old = frame_of(Hello(version=99))
    for data in (b"GET / HTTP/1.1\r\n\r\n", LENGTH.pack(LARGEST_FRAME + 1), early, old):
        with socket.create_connection(("127.0.0.1", there.server.port), 10.0) as stranger:
            stranger.sendall(data)
            while stranger.recv(1 << 16):
                pass
    assert there.follower.wait(lambda _: len(there.said) == 4, 10.0)
    assert "gpgrad's frames" in there.said[0]
    assert "64,000,000" in there.said[1]
    assert "hello" in there.said[2]
    assert "version 99" in there.said[3]
    with gg.Live(there.address) as live:
        send(live, submap)


def test_an_id_that_no_track_can_hold_is_refused(there: Viewer) -> None:
    with gg.Live(there.address) as live:
        for name in (" ", "\t", "\u3000 ", "a/b", ".a"):
            named = replace(SUBMAPS[0], id=name)
            assert_refused(
                lambda named=named: send(live, named), "an id is printable and not blank"
            )
        assert there.track.ids == []


def test_a_track_can_be_read_back_with_every_id(tmp_path: Path) -> None:
    with Viewer(tmp_path / "run") as there, gg.Live(there.address) as live:
        send(live, replace(SUBMAPS[0], id="a 1"))
        send(live, replace(SUBMAPS[1], id="sub 2 b"))
        for name, rule in {"crater": "number", "b1": "of a 1", "s_1700000000123456789": ""}.items():
            named = replace(SUBMAPS[2], id=name)
            assert_refused(lambda named=named: send(live, named), name, rule)
    track = read_poses(tmp_path / "run.txt", {1, 2})
    for index, submap in zip((1, 2), SUBMAPS, strict=False):
        np.testing.assert_allclose(track[index].translation, submap.pose_odometry.translation)
    with closing(Keeper()) as keeper, closing(Server(port=0)) as server:
        keeper.keep(replace(SUBMAPS[0], id="crater"))
        told, track_file = list[str](), tmp_path / "t.txt"
        assert_refused(
            lambda: Follower(server, keeper, Track().compare, told.append, track=track_file),
            *("crater", "--track"),
        )


def test_the_silent_make_room_and_no_others(there: Viewer, monkeypatch: pytest.MonkeyPatch) -> None:
    with ExitStack() as ends:
        address = ("127.0.0.1", there.server.port)
        silent = [ends.enter_context(socket.create_connection(address, 30.0)) for _ in range(6)]

        def connected() -> gg.Live:
            return ends.enter_context(closing(gg.Live(there.address, patience=20.0)))

        robots = [connected() for _ in range(MOST_ROBOTS)]
        for robot, submap in zip(robots, SUBMAPS, strict=False):
            send(robot, submap)
        for connection in silent:
            assert b"it is full" in connection.makefile("rb").read()
        assert_refused(lambda: gg.Live(there.address, patience=0.1), "it is full")
        monkeypatch.setattr(gpgrad_core.live.server, "SILENT", 0.0)
        last = connected()
        send(last, SUBMAPS[4])
        send(robots[0], SUBMAPS[0])  # it comes again
        monkeypatch.undo()
        last.close()  # as one that leaves does
        send(connected(), SUBMAPS[4])


def test_who_says_no_hello_is_sent_away(there: Viewer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpgrad_core.live.server, "SLOWEST", 0.2)
    with socket.create_connection(("127.0.0.1", there.server.port), 30.0) as stranger:
        assert b"has not said hello" in stranger.makefile("rb").read()


def test_who_hangs_up_at_once_is_no_viewer() -> None:
    def hang_up(server: socket.socket) -> None:
        with suppress(OSError):
            while True:
                with server.accept()[0] as connection:
                    connection.recv(100)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=hang_up, args=(server,))
        thread.start()
        port = server.getsockname()[1]
        assert_refused(lambda: gg.Live(f"localhost:{port}", patience=0.1), f"{port}: has hung up")
        server.shutdown(socket.SHUT_RDWR)
        thread.join()


def test_nobody_answers() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert_refused(lambda: Server(port=port), f"{port}", "cannot listen")
    assert_refused(lambda: gg.Live(f"localhost:{port}", patience=0.1), "nobody answers")
    assert_refused(lambda: gg.Live("localhost"), "HOST:PORT")


def test_a_viewer_that_closes_lets_go_of_its_robots(tmp_path: Path) -> None:
    before = threading.active_count()
    with Viewer(tmp_path / "kept") as there:
        live = gg.Live(there.address)
        send(live, SUBMAPS[0])
    live.close()
    assert threading.active_count() == before
