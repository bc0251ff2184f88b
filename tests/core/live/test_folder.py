"""Submaps that are written into a folder come one by one, each whole and with its pose."""

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.io.clouds.ply import write_ply
from gpgrad_core.io.poses import pose_row
from gpgrad_core.live import folder, sources
from gpgrad_core.live.folder import SubmapFolder
from gpgrad_core.live.source import Arrival, News, Trouble
from gpgrad_core.live.sources import open_source
from gpgrad_core.types import Submap
from tests.core.live.submaps import row
from tests.support.refusal import assert_refused

SUBMAPS = row(4)


class Writer:
    def __init__(self, path: Path) -> None:
        self.path = path
        (path / "submaps").mkdir(parents=True, exist_ok=True)

    def cloud(self, submap: Submap, share: float = 1.0) -> None:
        path = self.path / "submaps" / f"{submap.id}.ply"
        write_ply(path, submap.points)
        data = path.read_bytes()
        path.write_bytes(data[: round(share * len(data))])

    def pose(self, submap: Submap) -> None:
        with (self.path / "poses_odom.txt").open("a") as file:
            file.write(f"{pose_row(str(int(submap.id)), submap.pose_odometry)}\n")

    def submap(self, submap: Submap) -> None:
        self.cloud(submap)
        self.pose(submap)


@pytest.fixture(autouse=True)
def _no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folder, "LOOK", 0.02)
    monkeypatch.setattr(folder, "PATIENCE", 0.1)
    monkeypatch.setattr(sources, "LOOK", 0.02)


@pytest.fixture
def writer(tmp_path: Path) -> Writer:
    return Writer(tmp_path / "growing")


def watched(writer: Writer) -> Iterator[News]:
    return SubmapFolder(writer.path).news(threading.Event())


def arrived(news: Iterator[News]) -> Submap:
    found = next(news)
    assert isinstance(found, Arrival), found
    return found.submap


def test_submaps_come_as_they_are_written_and_again_if_they_change(writer: Writer) -> None:
    stopped = threading.Event()
    news = SubmapFolder(writer.path).news(stopped)
    for submap in SUBMAPS:
        writer.submap(submap)
        made = arrived(news)
        assert made.id == submap.id
        np.testing.assert_allclose(made.points, submap.points, atol=1e-6)
        places = [one.pose_odometry.translation for one in (made, submap)]
        np.testing.assert_allclose(*places, atol=1e-6)
    moved = SUBMAPS[0].points + 0.01
    write_ply(writer.path / "submaps" / "000.ply", np.vstack([moved, moved[:1] + 0.02]))
    again = arrived(news)
    assert (again.id, again.num_points) == ("000", len(moved) + 1)
    stopped.set()
    assert list(news) == []


def test_a_cloud_is_taken_when_it_is_whole_and_has_its_pose(writer: Writer) -> None:
    news = watched(writer)
    writer.cloud(SUBMAPS[0], share=0.5)
    writer.pose(SUBMAPS[0])
    writer.pose(SUBMAPS[3])  # of a submap that is still to come
    found = next(news)
    assert isinstance(found, Trouble)  # half a cloud is spoken of after a while …
    assert "000.ply" in found.text
    writer.cloud(SUBMAPS[0])
    assert arrived(news).id == "000"  # … and taken once it is whole
    writer.cloud(SUBMAPS[1])
    assert next(news) == Trouble("submap 001 waits for its pose in poses_odom.txt")
    writer.pose(SUBMAPS[1])
    assert arrived(news).id == "001"


def test_what_is_kept_is_not_read_again_but_for_the_first(writer: Writer) -> None:
    for submap in SUBMAPS:
        writer.submap(submap)
    source = SubmapFolder(writer.path)
    source.keep(lambda: ("000", "001", "002"))
    news = source.news(threading.Event())
    assert [arrived(news).id for _ in range(2)] == ["000", "003"]


def test_broken_poses_are_spoken_of(writer: Writer) -> None:
    writer.cloud(SUBMAPS[0])
    (writer.path / "poses_odom.txt").write_text("0 1 2 3 0 0\n")
    news = watched(writer)
    said = {news_.text for _ in range(2) if isinstance(news_ := next(news), Trouble)}
    assert any("poses_odom.txt, line 1" in text for text in said)
    (writer.path / "poses_odom.txt").unlink()
    writer.pose(SUBMAPS[0])
    assert arrived(news).id == "000"


def test_an_empty_folder_is_waited_for(tmp_path: Path) -> None:
    class Stopped(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            if not any(tmp_path.iterdir()):
                Writer(tmp_path).submap(SUBMAPS[0])
            return super().wait(timeout)

    assert arrived(open_source(str(tmp_path)).news(Stopped())).id == "000"


def test_what_is_no_source(tmp_path: Path) -> None:
    (tmp_path / "cloud.ply").write_text("")
    assert_refused(lambda: open_source(f"{tmp_path}/nothing"), "nothing", "no such file")
    assert_refused(lambda: open_source(f"{tmp_path}/cloud.ply"), "cloud.ply", "a bag")
    assert_refused(lambda: open_source("tcp://localhost"), "a port is a number")
    assert_refused(lambda: open_source("99999"), "99999", "65535")
