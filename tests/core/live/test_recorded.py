"""A recording that still grows gives the submaps that gpgrad build makes of the whole one."""

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.io.folder import load_dataset
from gpgrad_core.live import recorded
from gpgrad_core.live.recorded import MAGIC, GrowingMcap, GrowingRecording, whole_until
from gpgrad_core.live.source import Arrival, News, Trouble
from gpgrad_core.recordings.build import build_dataset
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.types import Dataset, Submap
from tests.support.bags import write_bag
from tests.support.drive import Drive, make_drive, tum, write_drive
from tests.support.refusal import assert_refused

DRIVE = make_drive(points_a_scan=150)
PARAMS = BuildParams(max_length=3.0, voxel_size=0.2)


@pytest.fixture(autouse=True)
def _no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, seconds in {"LOOK": 0.02, "PATIENCE": 0.1, "SHARE": 0.0}.items():
        monkeypatch.setattr(recorded, name, seconds)


def first(count: int) -> Drive:
    return Drive(DRIVE.stamps[:count], DRIVE.body[slice(0, count)], DRIVE.scans[:count])


def arrivals(news: Iterator[News]) -> Iterator[Submap]:
    for found in news:
        if isinstance(found, Arrival):
            yield found.submap


def assert_as_built(made: list[Submap], built: Dataset) -> None:
    assert [submap.id for submap in made] == [submap.id for submap in built.submaps[: len(made)]]
    for submap, whole in zip(made, built.submaps, strict=False):
        np.testing.assert_allclose(submap.points, whole.points, atol=1e-5)
        places = [one.pose_odometry.translation for one in (submap, whole)]
        np.testing.assert_allclose(*places, atol=1e-5)


def test_scans_become_submaps_while_they_are_written(tmp_path: Path) -> None:
    whole = write_drive(tmp_path / "whole", DRIVE)
    build_dataset(whole, tmp_path / "built", PARAMS)
    built = load_dataset(tmp_path / "built")
    growing = tmp_path / "growing"
    write_drive(growing, first(3))
    news = arrivals(GrowingRecording(growing, PARAMS).news(threading.Event()))
    made: list[Submap] = []
    for count in (10, 17, 24):
        write_drive(growing, first(count))
        made.append(next(news))
    assert_as_built(made, built)
    assert len(made) == 3


def test_scans_wait_for_their_poses(tmp_path: Path) -> None:
    growing = write_drive(tmp_path / "growing", DRIVE)
    (growing / "poses.txt").write_text(tum(DRIVE.stamps[:8], DRIVE.sensor[slice(0, 8)]))
    news = arrivals(GrowingRecording(growing, PARAMS).news(threading.Event()))
    assert next(news).id == "000"
    (growing / "poses.txt").write_text(tum(DRIVE.stamps, DRIVE.sensor))
    assert next(news).id == "001"


def test_an_mcap_file_without_an_end(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra 'ros' is not installed")
    folder = write_bag(tmp_path / "whole", DRIVE, ros1=False, poses="odometry", storage="mcap")
    (file,) = folder.glob("*.mcap")
    build_dataset(folder, tmp_path / "built", PARAMS)
    built = load_dataset(tmp_path / "built")
    data = file.read_bytes()
    growing = tmp_path / "growing.mcap"
    growing.write_bytes(data[: len(data) // 3])
    end = whole_until(growing)
    assert len(MAGIC) < end <= len(data) // 3
    news = GrowingRecording(growing, PARAMS).news(threading.Event())
    growing.write_bytes(data[:-1])  # all messages, but not the end
    made = [next(arrivals(news)) for _ in range(2)]
    growing.write_bytes(data)
    made += arrivals(news)  # it is finished: so is its last submap
    assert_as_built(made, built)
    assert len(made) == len(built.submaps)


def test_any_part_of_an_mcap_file_is_read_as_far_as_it_is_whole(tmp_path: Path) -> None:
    records = b"".join(bytes([5]) + size.to_bytes(8, "little") + bytes(size) for size in (3, 0, 40))
    path = tmp_path / "a.mcap"
    ends = [8, 8 + 12, 8 + 21, 8 + 70]
    for cut in range(8, 8 + 71):
        path.write_bytes((MAGIC + records)[:cut])
        end = whole_until(path)
        assert end == max(e for e in ends if e <= cut)
        growing = GrowingMcap(path)
        growing.whole = end
        with growing.open("rb") as file:
            content = file.read()
            assert content.startswith((MAGIC + records)[:end])
            assert content.endswith(MAGIC)
            file.seek(-37, 2)
            assert file.tell() == end
            assert file.read(1) == b"\x02"


def test_what_cannot_be_read_is_spoken_of_once(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra 'ros' is not installed")
    path = tmp_path / "a.bag"
    path.write_bytes(b"#ROSBAG V2.0\n")
    recording = GrowingRecording(path, PARAMS)
    found = next(recording.news(threading.Event()))
    assert isinstance(found, Trouble)
    assert "a.bag" in found.text
    by_cloud = BuildParams(gravity="cloud")
    assert_refused(lambda: GrowingRecording(path, by_cloud), "take it from the poses")
