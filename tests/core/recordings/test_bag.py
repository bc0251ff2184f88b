"""Bags of ROS 1 and ROS 2 give what was recorded; broken and ambiguous ones say so in a line."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpgrad_core.recordings import bag_reader
from gpgrad_core.recordings.bag_reader import DEEPEST_YAML, is_bag, is_split_bag
from gpgrad_core.recordings.build import open_recording
from gpgrad_core.recordings.level import level_recording
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.recording import Recording, RecordingSources
from tests.support.bags import BagWriter, write_bag
from tests.support.drive import MOUNT, Drive, assert_same_poses, make_drive, tum
from tests.support.recordings import opened, refused
from tests.support.refusal import assert_file_refused

pytest.importorskip("rosbags", reason="the extra 'ros' is not installed")
mcap_reader = pytest.importorskip("mcap.reader", reason="mcap is not installed")
mcap_writer = pytest.importorskip("mcap.writer", reason="mcap is not installed")
FEW = make_drive(num_scans=6, points_a_scan=50)


def assert_holds(recording: Recording, drive: Drive) -> None:
    """Compare with what was driven: times, sensor poses, and the points of every scan."""
    np.testing.assert_allclose(recording.stamps, drive.stamps, rtol=0, atol=1e-6)
    scans = [scan.points for scan in recording.read(0, len(recording))]
    assert len(scans) == len(drive.scans)
    for k, (points, driven) in enumerate(zip(scans, drive.scans, strict=True)):
        np.testing.assert_allclose(points, driven, rtol=0, atol=1e-5)
        assert_same_poses(recording.sensor(k), drive.sensor[k : k + 1])


@pytest.mark.parametrize(
    ("storage", "poses"),
    [
        ("ros1", "odometry"),
        ("ros1", "stamped"),
        ("ros1", "tf"),
        ("sqlite3", "odometry"),
        ("mcap", "stamped"),
        ("mcap", "tf"),
    ],
)
def test_every_kind_of_bag(storage: str, poses: str, tmp_path: Path) -> None:
    ros1 = storage == "ros1"
    path = tmp_path / ("a.bag" if ros1 else "a")
    write_bag(path, FEW, ros1=ros1, poses=poses, storage=storage)
    recording = open_recording(path)
    assert_holds(recording, FEW)
    if poses == "odometry":
        # A stretch alone is the same: what comes before is skipped.
        for scan, driven in zip(recording.read(2, 4), FEW.scans[2:4], strict=True):
            np.testing.assert_allclose(scan.points, driven, atol=1e-5)
        np.testing.assert_allclose(recording.covariance[3], 0.03 * np.eye(3), atol=1e-12)
    for file in path.glob("*.mcap"):
        assert_holds(open_recording(file), FEW)  # out of its folder


def test_poses_of_a_file_and_truth(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "a.bag", FEW, ros1=True, poses="stamped")
    (tmp_path / "slam.txt").write_text(tum(FEW.stamps, FEW.sensor))
    (tmp_path / "truth.txt").write_text(tum(FEW.stamps[2:], FEW.sensor[2:]))
    sources = RecordingSources(poses=tmp_path / "slam.txt", truth=tmp_path / "truth.txt")
    recording = open_recording(path, sources)
    assert_holds(recording, FEW)
    assert recording.truth.valid.tolist() == [False, False, True, True, True, True]
    assert any("2 of 6 scans have no true pose" in note for note in recording.notes)
    assert any("frame 'lidar'" in note for note in recording.notes)


def test_scans_without_a_pose_or_a_time_of_their_own_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    with BagWriter(path, ros1=True) as bag:
        for k, stamp in enumerate(FEW.stamps):
            if k < 4:
                bag.stamped("/pose", stamp, FEW.sensor, k)
            bag.cloud("/points", stamp, "lidar", FEW.scans[k], stamped=k > 0)
    recording = open_recording(path)
    assert len(recording) == 4
    assert "2 of 6 scans have no pose within 0.1 s and were left out" in recording.notes
    assert "1 message has no time" in "".join(recording.notes)
    assert recording.stamps is not None  # the first is that of the recorder
    np.testing.assert_allclose(recording.stamps[0], FEW.stamps[0] + 0.02, atol=1e-6)
    assert len(open_recording(path, params=BuildParams(max_time_difference=2.0))) == 6


def test_what_is_missing_or_ambiguous(tmp_path: Path) -> None:
    two = tmp_path / "two.bag"
    with BagWriter(two, ros1=True) as bag:
        for topic in ("/left", "/right"):
            bag.cloud(topic, FEW.stamps[0], "lidar", FEW.scans[0])
        bag.odometry("/odom", FEW.stamps[0], FEW.body, 0)
        bag.stamped("/pose", FEW.stamps[0], FEW.sensor, 0)
    refused(two, str(two), "/left (1), /right (1)", "--cloud-topic")
    refused(two, "/odom (1), /pose (1)", "--pose-topic", cloud_topic="/right")
    refused(two, "--cloud-topic /up", "/left (1)", cloud_topic="/up")
    refused(two, "'base_link'", "'lidar'", "--mount FILE", cloud_topic="/right", pose_topic="/odom")
    (tmp_path / "mount.txt").write_text("0.3 0 0.9 0 0 0 1\n")
    mount = tmp_path / "mount.txt"
    recording = opened(two, cloud_topic="/right", pose_topic="/odom", mount=mount)
    np.testing.assert_allclose(recording.mount.translation, [[0.3, 0.0, 0.9]])
    # All zeros is ROS's way of saying that nothing is known.
    assert recording.covariance is None

    alone = tmp_path / "alone.bag"
    with BagWriter(alone, ros1=True) as bag:
        bag.cloud("/points", FEW.stamps[0], "lidar", FEW.scans[0])
    refused(alone, "no topic of poses")


def test_broken_bags_and_a_missing_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_bag(tmp_path / "a.bag", FEW, ros1=True, poses="odometry")
    whole = path.read_bytes()
    for broken in (whole[: len(whole) // 2], b"", b"no bag\n" * 9):
        assert_file_refused(open_recording, path, broken, "not a complete bag")
    folder = write_bag(tmp_path / "a", FEW, ros1=False, poses="odometry")
    (file,) = folder.glob("*.db3")
    file.write_bytes(file.read_bytes()[:3000])
    refused(folder, str(folder), "not a complete bag")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    refused(path, "pip install 'gpgrad[ros]'")


def test_an_mcap_of_another_writer(tmp_path: Path) -> None:
    """Foxglove's own library writes a file without ROS 2's metadata.yaml beside it."""
    writer = pytest.importorskip("mcap_ros2.writer", reason="mcap-ros2-support is not installed")
    typesys = pytest.importorskip("rosbags.typesys")
    store, path = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE), tmp_path / "drive.mcap"
    with path.open("wb") as stream:
        out = writer.Writer(stream)
        cloud, stamped = (
            out.register_msgdef(name, store.generate_msgdef(name, ros_version=2)[0])
            for name in ("sensor_msgs/msg/PointCloud2", "geometry_msgs/msg/PoseStamped")
        )
        fields = [
            {"name": name, "offset": 4 * n, "datatype": 7, "count": 1}
            for n, name in enumerate("xyz")
        ]
        for k, stamp in enumerate(FEW.stamps):
            seconds, logged = int(stamp), round(stamp * 1e9)
            time = {"sec": seconds, "nanosec": round((stamp - seconds) * 1e9)}
            header = {"stamp": time, "frame_id": "lidar"}
            place = dict(zip("xyz", FEW.sensor.translation[k].tolist(), strict=True))
            turn = dict(zip("xyzw", FEW.sensor.rotation[k].as_quat().tolist(), strict=True))
            pose = {"position": place, "orientation": turn}
            out.write_message("/pose", stamped, {"header": header, "pose": pose}, logged)
            points = FEW.scans[k].astype("<f4")
            message = {"header": header, "height": 1, "width": len(points), "fields": fields}
            message |= {"is_bigendian": False, "point_step": 12, "row_step": 12 * len(points)}
            message |= {"data": points.tobytes(), "is_dense": True}
            out.write_message("/points", cloud, message, logged)
        out.finish()
    assert_holds(open_recording(path), FEW)
    half = path.read_bytes()[: path.stat().st_size // 2]
    assert_file_refused(open_recording, path, half, "is not a complete bag")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags") / "whole"
    (file,) = write_bag(folder, FEW, ros1=False, poses="odometry", storage="mcap").glob("*.mcap")
    return file


def messages(path: Path) -> Iterator[tuple[Any, Any, Any]]:
    with path.open("rb") as stream:
        yield from mcap_reader.NonSeekingReader(stream).iter_messages()


def rewrite(source: Path, target: Path, *, shuffled: bool = False, **options: Any) -> None:
    """Write an MCAP file again, with other parts of an index."""
    found = list(messages(source))
    if shuffled:  # chunks begin later than those after them end
        found = found[len(found) // 2 :] + found[: len(found) // 2]
    with target.open("wb") as stream:
        out = mcap_writer.Writer(
            stream, compression=mcap_writer.CompressionType.ZSTD, chunk_size=2000, **options
        )
        out.start("ros2")
        channels: dict[int, int] = {}
        for schema, channel, message in found:
            if channel.id not in channels:
                kind = out.register_schema(schema.name, schema.encoding, schema.data)
                coding = channel.message_encoding
                made = out.register_channel(channel.topic, coding, kind, channel.metadata)
                channels[channel.id] = made
            times = message.log_time, message.data, message.publish_time
            out.add_message(channels[channel.id], *times)
        out.finish()


INDEX = mcap_writer.IndexType


@pytest.mark.parametrize(
    "options",
    [
        {"index_types": INDEX.CHUNK},  # chunks, but not what is in them
        {"index_types": INDEX.CHUNK, "use_statistics": False},
        {"index_types": INDEX.NONE},
        {"index_types": INDEX.MESSAGE},
        {"repeat_channels": False},
        {"repeat_schemas": False},
        {"repeat_channels": False, "repeat_schemas": False, "use_statistics": False},
        {"use_chunking": False, "repeat_channels": False, "use_statistics": False},
    ],
    ids=str,
)
def test_an_mcap_of_a_partial_index(options: dict[str, Any], whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    has_chunks = "NONE" not in str(options) and "MESSAGE" not in str(options)
    for shuffled in (False, True)[: 1 + (options.get("use_chunking", True) and has_chunks)]:
        rewrite(whole, path, shuffled=shuffled, **options)
        assert len(list(messages(path))) == 2 * len(FEW.stamps) + 1
        recording = open_recording(path)
        assert_holds(recording, FEW)
        (third,) = (scan.points for scan in recording.read(2, 3))
        np.testing.assert_allclose(third, FEW.scans[2], atol=1e-5)
    cut = path.read_bytes()[:-200]
    assert_file_refused(open_recording, path, cut, "is not a complete bag")


@pytest.mark.parametrize(("ros1", "ending"), [(True, ".bag"), (False, ".mcap"), (False, ".db3")])
def test_files_of_a_split_bag_without_metadata(ros1: bool, ending: str, tmp_path: Path) -> None:
    parts = tmp_path / "run"
    parts.mkdir()
    storage = "mcap" if ending == ".mcap" else "sqlite3"
    for number in range(3):
        rows = slice(2 * number, 2 * number + 2)
        part = Drive(FEW.stamps[rows], FEW.body[rows], FEW.scans[rows])
        name = f"part{number}{ending * ros1}"
        written = write_bag(tmp_path / name, part, ros1=ros1, poses="odometry", storage=storage)
        (file,) = [written] if ros1 else written.glob(f"*{ending}")
        file.rename(parts / f"run_{number + 8}{ending}")  # 9 comes before 10
    (parts / "old.db3" if ending != ".db3" else parts / ".x.db3").write_bytes(b"")
    recording = open_recording(parts)
    assert_holds(recording, FEW)
    named = any("old.db3: not read" in note for note in recording.notes)
    assert named == (ending != ".db3")
    (parts / "poses.npy").write_bytes(b"")
    assert is_bag(parts) == ros1
    assert not is_split_bag(parts)  # a folder of clouds


def merges(levels: int) -> str:
    lines = ["a0: &a0 {k: 1}"]
    lines += [f"a{n}: &a{n} {{<<: [*a{n - 1}, *a{n - 1}], k{n}: 1}}" for n in range(1, levels)]
    return "\n".join(lines)


def aliases(levels: int) -> str:
    lines = ["a0: &a0 [1, 2]"]
    return "\n".join([*lines, *(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]" for n in range(1, levels))])


FEW_EVENTS = 1_000
"""The true limit takes seconds to reach."""
HOSTILE = {
    "merge keys": (merges(25), "it repeats the list or map"),
    "aliases": (aliases(40), "it repeats the list or map"),
    "a list": (f"a: [{'1,' * (FEW_EVENTS + 10)}]", f"more than {FEW_EVENTS:,} values"),
    "depth": ("a: " + "[" * 900 + "]" * 900, f"more than {DEEPEST_YAML} lists"),
    "blocks": ("- " * 900 + "1", f"more than {DEEPEST_YAML} lists"),
    "itself": ("a: &a [*a]", "it repeats the list or map"),
    "lines": ("\n" * (FEW_EVENTS + 10) + "a: 1", "values or lines"),
    "a long line": (f"a: '{'x' * bag_reader.LONGEST_LINE}'", "a line of more than"),
    "digits": (f"a: {'9' * 5_000}", "it has a number of thousands of digits"),
    "a date": ("a: 2024-13-41", "or no date"),
    "size": ("#" * 4_000_001, "is larger than"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_metadata_are_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bag_reader, "MOST_EVENTS", FEW_EVENTS)
    if name in ("a list", "lines", "a long line"):
        # A parser needs seconds for them, in which nobody could cancel.
        monkeypatch.setattr("ruamel.yaml.YAML.parse", lambda *_: pytest.fail("it was parsed"))
    text, reason = HOSTILE[name]
    path = tmp_path / "bag"
    path.mkdir()
    (path / "metadata.yaml").write_text(text)
    refused(path, "metadata.yaml", reason)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_odd_metadata_that_do_no_harm(storage: str, tmp_path: Path) -> None:
    """A bag that was indexed anew has no profiles of its topics; hostile ones are not parsed."""
    path = write_bag(tmp_path / "bag", FEW, ros1=False, poses="odometry", storage=storage)
    text = (path / "metadata.yaml").read_text()
    described = "".join(
        f"  - path: run_{n}.mcap\n    message_count: &c{n} 5\n"
        f"    duration: {{nanoseconds: *c{n}}}\n"
        for n in range(100)
    )
    hostile = merges(25).replace("\n", "\\n")
    for name, profile in (("''", r"- history: 3\n  depth: 0\n"), ("null", ""), (storage, hostile)):
        changed = text
        for old, new in (
            (f"storage_identifier: {storage}", f"storage_identifier: {name}"),
            ("profiles: []", f'profiles: "{profile}"'),
            ("  files:\n", f"  files:\n{described}"),
        ):
            assert old in changed
            changed = changed.replace(old, new)
        (path / "metadata.yaml").write_text(changed)
        assert_holds(open_recording(path), FEW)


ETNA = (37.75, 14.99, 2900.0)


def write_fixes(path: Path, *, topics: tuple[str, ...] = ("/fix",), late: float = 0.0) -> Path:
    """A drive with a satellite receiver, which has no fix at first."""
    with BagWriter(path, ros1=True) as bag:
        for k, stamp in enumerate(FEW.stamps):
            bag.odometry("/odom", stamp, FEW.body, k)
            bag.cloud("/points", stamp, "base_link", FEW.scans[k])
            for topic in topics:
                nowhere = (float("nan"), float("nan"), 0.0)
                bag.fix(topic, stamp + late - 0.01, nowhere, status=-1)
                place = (ETNA[0] + 1e-5 * k, ETNA[1] + 2e-5 * k, ETNA[2] + k)
                bag.fix(topic, stamp + late, place)
    return path


def test_satellite_positions_are_the_truth_and_the_origin(tmp_path: Path) -> None:
    recording = open_recording(write_fixes(tmp_path / "a.bag"))
    assert recording.positions_only
    assert recording.origin == ETNA
    assert recording.truth.valid.all()
    # A degree of latitude is 111.0 km there, one of longitude 88.2 km.
    east, north, up = recording.truth.poses.translation[5]
    assert (east, north, up) == pytest.approx((8.82, 5.55, 5.0), abs=0.02)
    assert "/fix: its satellite positions are kept as the truth" in recording.notes
    late = open_recording(write_fixes(tmp_path / "late.bag", late=500.0))
    assert late.truth is None
    assert "has no position at the time of a scan" in "".join(late.notes)


def test_of_several_receivers_one_is_named(tmp_path: Path) -> None:
    path = write_fixes(tmp_path / "a.bag", topics=("/left", "/right"))
    recording = open_recording(path)
    assert recording.truth is None
    assert recording.origin is None
    assert "satellite positions of /left, /right were ignored" in "".join(recording.notes)
    assert opened(path, gnss_topic="/right").origin == ETNA
    refused(path, "--gnss-topic /odom: is not a topic of positions", gnss_topic="/odom")


@pytest.mark.parametrize("poses", ["odometry", "stamped", "tf", "fixed tf", "odometry and tf"])
def test_clouds_in_the_frame_of_the_poses_are_not_moved_twice(poses: str, tmp_path: Path) -> None:
    """FAST-LIO and others give clouds in the world."""
    path = tmp_path / "a.bag"
    world = [FEW.sensor[k : k + 1].apply(scan) for k, scan in enumerate(FEW.scans)]
    frame = "map" if poses == "stamped" else "odom"
    with BagWriter(path, ros1=True) as bag:
        if poses == "fixed tf":
            bag.transform(FEW.stamps[0], "map", "odom", MOUNT, 0, topic="/tf_static")
        for k, stamp in enumerate(FEW.stamps):
            if "odometry" in poses:
                bag.odometry("/odom", stamp, FEW.body, k)
            if "tf" in poses:
                bag.transform(stamp, "odom", "base_link", FEW.body, k)
                bag.transform(stamp, "base_link", "wheel", MOUNT, 0)
            if poses == "stamped":
                bag.stamped("/pose", stamp, FEW.body, k)
            bag.cloud("/points", stamp, f"/{frame}", world[k])
    named = RecordingSources(world_frame=None if poses != "tf" else "odom")
    recording = open_recording(path, named)
    assert any("taken as in the world" in note for note in recording.notes)
    assert_same_poses(recording.body, FEW.body)
    for points_frame in ("auto", "world")[: 1 + (poses == "stamped")]:
        params = BuildParams(points_frame=points_frame)
        level, _ = level_recording(open_recording(path, named, params), params)
        for k, scan in enumerate(level.read(0, len(level))):
            np.testing.assert_allclose(level.sensor(k).apply(scan.points), world[k], atol=1e-4)
    if poses == "stamped":
        sensor = open_recording(path, params=BuildParams(points_frame="sensor"))
        assert not sensor.in_world
        assert any("--points-frame world" in note for note in sensor.notes)
    if poses == "tf":
        odometry = RecordingSources(odometry="kiss-icp")
        assert open_recording(path, odometry).in_world


def test_clouds_of_a_sensor_are_not_taken_for_the_world(tmp_path: Path) -> None:
    """What moves below a sensor's frame is a wheel or an arm; a header may be a copy."""
    path = tmp_path / "a.bag"
    with BagWriter(path, ros1=True) as bag:
        for k, stamp in enumerate(FEW.stamps):
            bag.stamped("/pose", stamp, FEW.sensor, k)
            bag.transform(stamp, "map", "arm", FEW.sensor, k)
            bag.cloud("/points", stamp, "map", FEW.scans[k])
    recording = open_recording(path)
    assert not recording.in_world
    assert_holds(recording, FEW)
    refused(path, "transforms do not join", pose_topic="/tf")
    world = BuildParams(points_frame="world")
    assert open_recording(path, params=world).in_world  # needs no mount
