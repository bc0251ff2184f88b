"""S3LI's form: a ROS 1 bag, TUM poses, weak points to leave out, and a truth of positions only."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import measure_pairs
from gpgrad_core.io.folder import load_dataset, outline_dataset, write_dataset
from gpgrad_core.io.poses import poses_at
from gpgrad_core.recordings.build import build_dataset, open_recording
from gpgrad_core.recordings.params import BuildParams, Condition, parse_condition
from gpgrad_core.recordings.pose_files import read_truth_file
from gpgrad_core.recordings.recording import RecordingSources
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import join_datasets, trajectory_error
from tests.support.bags import BagWriter
from tests.support.drive import as_kitti, make_drive, tum, write_drive
from tests.support.recordings import refused
from tests.support.refusal import assert_file_refused, assert_refused

DRIVE = make_drive(num_scans=12, points_a_scan=150)


def write_s3li(folder: Path) -> tuple[Path, RecordingSources]:
    """Write a bag with /bf_lidar/points_raw, poses by SLAM and true positions, each in a file."""
    folder.mkdir()
    bag_path = folder / "s3li_loops.bag"
    with BagWriter(bag_path, ros1=True) as bag:
        for stamp, points in zip(DRIVE.stamps, DRIVE.scans, strict=True):
            noise = np.full((40, 3), 1.5)
            strength = np.repeat([10.0, 2.0], [len(points), len(noise)])
            both = np.vstack([points, noise])
            bag.cloud("/bf_lidar/points_raw", stamp, "bf_lidar", both, intensity=strength)
    (folder / "slam.txt").write_text(tum(DRIVE.stamps, DRIVE.sensor))
    # The frame of the true positions is turned from that of the poses.
    turned = Rotation.from_euler("z", 1.1).apply(DRIVE.sensor.translation)
    true = turned + np.array([40.0, -7.0, 3.0])
    rows = np.column_stack([DRIVE.stamps, true])
    np.savetxt(folder / "gnss.txt", rows, fmt="%.6f", header="time x y z")
    keep = (parse_condition("intensity>3"),)
    sources = RecordingSources(folder / "slam.txt", folder / "gnss.txt", keep=keep)
    return bag_path, sources


def test_a_bag_of_s3li(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra 'ros' is not installed")
    path, sources = write_s3li(tmp_path / "s3li")
    recording = open_recording(path, sources)
    assert recording.positions_only
    assert recording.notes[-1] == "only points with intensity>3 are kept"
    read = (scan.points for scan in recording.read(0, 12))
    for points, driven in zip(read, DRIVE.scans, strict=True):
        np.testing.assert_allclose(points, driven, rtol=0, atol=1e-5)
    built = tmp_path / "built"
    build_dataset(path, built, BuildParams(max_length=1.0), sources=sources)
    assert not (built / "poses_gt.txt").exists()
    dataset = load_dataset(built)
    assert dataset.positions_only
    assert "without headings" in "".join(dataset.notes)
    assert "intensity>3" in (built / "build.jsonl").read_text()
    for submap in dataset.submaps:
        off = submap.pose_true.planar.yaw - submap.pose_odometry.planar.yaw - 1.1
        assert abs((off + np.pi) % (2 * np.pi) - np.pi) < 0.01
    pairs = measure_pairs(dataset)
    assert pairs.positions_only
    assert "its turn is not judged" in pairs.notes[0]
    # Through memory and back.
    write_dataset(dataset, tmp_path / "copy")
    again = load_dataset(tmp_path / "copy")
    assert again.positions_only
    assert join_datasets([outline_dataset(tmp_path / "copy")]).outline.dataset.positions_only
    wanted = RecordingSources(sources.poses, keep=(Condition("ring", "==", 1.0),))
    refused = open_recording(path, wanted)
    assert_refused(lambda: list(refused.read(0, 1)), "message 0", "no field ring", "intensity")


@pytest.mark.parametrize(
    "text", ["intensity", "intensity>", "intensity>>3", "3<x", "x>nan", "a b>1"]
)
def test_wrong_conditions(text: str) -> None:
    assert_refused(lambda: parse_condition(text), f"--keep {text}", "such as intensity>3")


def test_headings_from_positions() -> None:
    rng = np.random.default_rng(1)
    xy = np.cumsum(rng.normal(1.0, 0.6, (12, 2)), axis=0)
    yaws = rng.uniform(-3, 3, 12)
    odometry = {k: Pose.from_planar(SE2(*xy[k], yaws[k]), 0.1 * k) for k in range(12)}
    world = SE2(5.0, 6.0, -2.0)
    places = {k: np.array([*world.apply(xy[k : k + 1])[0], 2.0 * k]) for k in range(0, 12, 2)}
    found = poses_at(places, odometry)
    assert sorted(found) == list(range(0, 12, 2))
    for k, pose in found.items():
        true = world @ odometry[k].planar
        np.testing.assert_allclose(pose.translation, places[k], atol=1e-9)
        assert abs(np.sin(pose.planar.yaw - true.yaw)) < 1e-9
    assert poses_at({k: 0.01 * places[k] for k in places}, odometry) == {}
    assert poses_at(places, {}) == {}


def test_errors_without_headings() -> None:
    """Turning the true headings about changes nothing, and no turn is reported."""
    rng = np.random.default_rng(3)
    found = {f"{k}": Pose.from_planar(SE2(*rng.normal(0, 5, 2), 0.3 * k)) for k in range(8)}
    first, second = (
        {
            name: Pose.from_planar(SE2(pose.planar.x + 0.1 * int(name), pose.planar.y, yaw))
            for name, pose in found.items()
        }
        for yaw in (0.0, 2.0)
    )
    error = trajectory_error(first, found, positions_only=True)
    assert error == trajectory_error(second, found, positions_only=True)
    assert error.relative_turn is None
    assert 0 < error.relative <= 0.1


GPST = """\
% program   : RTKLIB ver.2.4.2
% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites)
%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)
2021/07/08 10:00:18.000   37.724000000   14.998000000  2012.3000   1  12   0.0100
2021/07/08 10:00:19.000   37.724010000   14.998000000  2012.4000   1  12   0.0100
2021/07/08 10:00:20.000   37.724000000   14.998020000  2012.3000   2  12   0.0100
"""


def test_positions_of_rtklib(tmp_path: Path) -> None:
    pyproj = pytest.importorskip("pyproj", reason="pyproj is not installed")
    path = tmp_path / "gnss.pos"
    # The same in GPS weeks, as S3LI's files have it, and in UTC.
    weeks = GPST.replace("2021/07/08 10:00:", "2165 3816")
    utc = GPST.replace("GPST", "UTC ").replace("10:00:18", "10:00:00")
    for text in (utc, weeks, GPST):
        path.write_text(text)
        found = read_truth_file(path)
        assert found.positions_only
        assert found.trajectory.stamps[0] == 1_625_738_400.0  # 10:00:00 UTC, 18 s behind GPS
    to_local = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=cart +ellps=WGS84 "
        "+step +proj=topocentric +ellps=WGS84 +lon_0=14.998 +lat_0=37.724 +h_0=2012.3"
    )
    places = np.array([row.split()[2:5] for row in GPST.splitlines()[3:]], float)
    theirs = np.column_stack(to_local.transform(places[:, 1], places[:, 0], places[:, 2]))
    np.testing.assert_allclose(found.trajectory.poses.translation, theirs, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.pos", GPST.replace("37.724010000", "97.7"), "line 5: 97.7 14.998 "),
        ("a.pos", GPST.replace("2021/07/08 10:00:19.000", "2021/13/08 10:00:19.000"), "no date"),
        ("a.pos", GPST.replace("2021/07/08 10:00:19.000", "2165 700000"), "no GPS week"),
        ("a.pos", GPST[: GPST.index(" 2012.4")], "line 5: has 4 columns"),
        ("a.pos", "% nothing\n", "holds no positions"),
        ("a.txt", "1 2 3 4\n2 3 4\n", "line 2: has 3 columns"),
        ("a.txt", "1 2 3 1e12\n", "line 1: the position"),
        ("a.txt", "1 2 x 4\n", "line 1: holds something that is not a number"),
    ],
)
def test_wrong_positions(name: str, text: str, said: str, tmp_path: Path) -> None:
    assert_file_refused(read_truth_file, tmp_path / name, text, said)


def test_wrong_positions_of_a_dataset(tmp_path: Path) -> None:
    write_drive(tmp_path / "drive", make_drive(4, 120))
    build_dataset(tmp_path / "drive", tmp_path / "data", BuildParams(max_length=1.0))
    file = tmp_path / "data" / "positions_gt.txt"
    for text, said in (
        ("0 1 2 3\n0 1 2 3\n", "line 2: names submap 0 a second time"),
        ("99 1 2 3\n", "line 1: names submap 99"),
        ("0 1 2\n", "line 1: has 3 columns, but a position needs 4"),
    ):
        assert_file_refused(lambda file: load_dataset(file.parent), file, text, said)
    file.write_text("0 1 2 3\n")
    dataset = load_dataset(tmp_path / "data")
    assert not dataset.positions_only
    assert "was ignored" in "".join(dataset.notes)
    with pytest.raises(InputError):
        measure_pairs(dataset)


def test_positions_beside_kitti_poses(tmp_path: Path) -> None:
    write_drive(tmp_path, make_drive(3, 60))
    rows = "1 0 0 0 0 1 0 0 0 0 1 0\n"
    (tmp_path / "poses.txt").write_text(3 * rows)
    (tmp_path / "positions_gt.txt").write_text("1 2 3 4\n")
    refused(tmp_path, "positions_gt.txt", "give TUM poses")


def as_pcd(path: Path, points: np.ndarray) -> None:
    fields = "VERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
    size = f"WIDTH {len(points)}\nHEIGHT 1\nPOINTS {len(points)}\nDATA binary\n"
    table = np.column_stack([points, strength_of(points)])
    path.write_bytes(f"{fields}{size}".encode() + table.astype("<f4").tobytes())


def as_las(path: Path, points: np.ndarray) -> None:
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=int(path.parent.name), version="1.4")
    header.scales = np.full(3, 1e-6)
    las = laspy.LasData(header)
    las.xyz = points
    las.intensity = strength_of(points).astype(np.uint16)
    las.classification = np.full(len(points), 17)
    las.return_number = 1 + np.arange(len(points)) % 5
    las.number_of_returns = np.full(len(points), 5)
    las.user_data = np.full(len(points), 200)
    las.write(str(path))


def strength_of(points: np.ndarray) -> np.ndarray:
    """Give points 2 and 300 in turns."""
    return np.where(np.arange(len(points)) % 2, 300.0, 2.0)


@pytest.mark.parametrize(
    ("name", "ending", "writer"),
    [
        ("kitti", ".bin", lambda path, points: as_kitti(path, points, strength_of(points))),
        ("pcd", ".pcd", as_pcd),
        *[("3", ".las", as_las), ("7", ".las", as_las), ("6", ".laz", as_las)],
    ],
)
def test_conditions_on_scans_and_how_many_points_they_keep(
    name: str, ending: str, writer: Callable[[Path, np.ndarray], None], tmp_path: Path
) -> None:
    drive = make_drive(num_scans=6, points_a_scan=60)
    folder = write_drive(tmp_path / name, drive, ending, writer)

    def first(condition: str) -> np.ndarray:
        keep = RecordingSources(keep=(parse_condition(condition),))
        (scan,) = open_recording(folder, keep).read(0, 1)
        return scan.points

    strong = "reflectance >= 3" if ending == ".bin" else "intensity>3"
    np.testing.assert_allclose(first(strong), drive.scans[0][1::2], atol=1e-5)
    params = BuildParams(max_length=100.0, min_points=10)
    keep = RecordingSources(keep=(parse_condition(strong),))
    report = build_dataset(folder, tmp_path / "built", params, sources=keep)
    assert "180 of 360 points (50.0%) meet --keep and are kept" in report.notes
    if ending == ".las":
        for condition in ("classification==17", "user_data==200", "return_number==2"):
            wanted = drive.scans[0][1::5] if condition.startswith("return") else drive.scans[0]
            np.testing.assert_allclose(first(condition), wanted, atol=1e-5)
    assert_refused(lambda: first("ring>1"), ending, "no field ring for --keep ring>1")
