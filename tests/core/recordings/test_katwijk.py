"""Katwijk's form: triples of images by Pillow, and positions whose track gives the heading."""

import struct
import zlib
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gpgrad_core.io.folder import load_dataset
from gpgrad_core.recordings.build import build_dataset, open_recording
from gpgrad_core.recordings.katwijk import points_of_images
from gpgrad_core.recordings.params import BuildParams, PointFilter, parse_condition
from gpgrad_core.recordings.recording import RecordingSources
from tests.support.drive import tum
from tests.support.recordings import opened, refused
from tests.support.refusal import assert_refused

START = datetime(2015, 11, 26, 12, 53, 34, 667_000, tzinfo=UTC)
LATITUDE, LONGITUDE = 52.2159, 4.4195
NORTH, EAST = 111_267.0, 68_324.0
"""Metres of a degree there; good to a part in a thousand."""
HEIGHT = 1.6
"""Of the LiDAR above a flat beach [m]."""


def named(seconds: float) -> str:
    """Spell a time as the dataset does."""
    time = datetime.fromtimestamp(START.timestamp() + seconds, UTC)
    return f"{time:%Y_%m_%d_%H_%M_%S}_{time.microsecond // 1000:03d}"


def write_image(path: Path, values: np.ndarray) -> None:
    Image.fromarray(values if values.ndim == 3 else values.astype(np.uint16)).save(path)


def beach() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a level VLP-16 sees of a flat beach: the seven lower lasers hit it."""
    elevation = np.radians(np.arange(15, -16, -2.0))[:, None] + np.zeros((1, 1808))
    azimuth = np.tile(np.linspace(0, 35_999, 1808), (16, 1))
    with np.errstate(divide="ignore"):
        ranges = np.where(elevation < -0.05, 1000 * HEIGHT / np.sin(-elevation), 0)
    strength = np.where(azimuth < 18_000, 50, 1)
    return np.round(ranges), np.round(azimuth), strength


@pytest.fixture
def part(tmp_path: Path) -> Path:
    """Drive north-east for six seconds, half a metre a second."""
    path = tmp_path / "Part1"
    (path / "Velodyne").mkdir(parents=True)
    images = beach()
    for k in range(6):
        for kind, values in zip(("range", "azimuth", "intensity"), images, strict=True):
            write_image(path / "Velodyne" / f"Velodyne_{named(k)}_{kind}.png", values)
    rows: list[str] = []
    for k in range(-5, 70):
        way = 0.05 * k * np.sqrt(0.5)
        place = f"{LATITUDE + way / NORTH:.9f} {LONGITUDE + way / EAST:.9f} {5.0:.3f}"
        rows.append(f"{named(0.1 * k)} 4 {place} 0.01 0.01 0.02")
    (path / "gps-latlong.txt").write_text("\n".join(rows) + "\n")
    return path


def test_a_part_of_a_traverse(part: Path, tmp_path: Path) -> None:
    recording = open_recording(part)
    assert len(recording) == 6
    assert recording.stamps[0] == pytest.approx(START.timestamp(), abs=1e-3)
    yaw = recording.body.rotation.as_euler("ZYX")[:, 0]
    np.testing.assert_allclose(yaw, np.pi / 4, atol=0.02)
    moved = recording.body.translation[5] - recording.body.translation[0]
    np.testing.assert_allclose(moved, [2.5 * np.sqrt(0.5)] * 2 + [0.0], atol=0.02)
    (points,) = (scan.points for scan in recording.read(3, 4))
    assert len(points) == 7 * 1808
    np.testing.assert_allclose(points[:, 2], -HEIGHT, atol=0.01)
    assert "heading of the track" in "".join(recording.notes)
    build_dataset(part, tmp_path / "out", BuildParams(max_length=1.0, max_range=20))
    dataset = load_dataset(tmp_path / "out")
    assert len(dataset.submaps) == 3
    assert dataset.submaps[0].pose_true is None


def test_what_is_asked_for(part: Path, tmp_path: Path) -> None:
    keep = (parse_condition("intensity>10"), parse_condition("range<8"))
    recording = opened(part, keep=keep)
    (points,) = (scan.points for scan in recording.read(0, 1))
    assert (points[:, 1] >= -1e-6).all()
    assert np.linalg.norm(points, axis=1).max() < 8
    (tmp_path / "mount.txt").write_text("0 0 1 0 0 0 1\n")
    recording = opened(part, mount=tmp_path / "mount.txt")
    assert recording.mount.translation[0, 2] == 1.0
    refused(part, "no field ring", keep=(parse_condition("ring>1"),))
    refused(part, "--truth", truth=tmp_path / "a.txt")


def test_positions_are_the_truth_of_given_poses(part: Path, tmp_path: Path) -> None:
    first = open_recording(part)
    assert first.truth is None
    (tmp_path / "mine.txt").write_text(tum(first.stamps, first.body))
    mine = RecordingSources(poses=tmp_path / "mine.txt")
    recording = open_recording(part, mine)
    assert recording.positions_only
    np.testing.assert_allclose(recording.truth.poses.translation, first.body.translation, atol=1e-6)
    (part / "gps-latlong.txt").unlink()
    assert open_recording(part, mine).truth is None
    refused(part, "has no gps-latlong.txt", "--poses FILE")


def test_the_lasers() -> None:
    """The formula of the program that was the specification: elevations of 15 to -15 degrees."""
    ranges, azimuth, strength = (np.zeros((16, 1808), np.uint16) for _ in range(3))
    ranges[0, 5], azimuth[0, 5] = 2000, 9000
    ranges[15, 9], azimuth[15, 9] = 4000, 18_000
    points = points_of_images(ranges, azimuth, strength, PointFilter(), "a turn")
    c, s = np.cos(np.radians(15)), np.sin(np.radians(15))
    np.testing.assert_allclose(points, [[0, 2 * c, 2 * s], [-4 * c, 0, -4 * s]], atol=1e-12)


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def with_rows(whole: bytes, count: int, *, row_filter: int = 0) -> bytes:
    """Put so many rows of zeros behind the header of a PNG of 16 bits."""
    rows = count * (bytes([row_filter]) + bytes(2 * 1808))
    return whole[:33] + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def test_wrong_images(part: Path) -> None:
    file = sorted((part / "Velodyne").glob("*_azimuth.png"))[1]
    whole = file.read_bytes()
    for broken, *said in (
        (whole[: len(whole) // 2], "is cut short"),
        (whole[:-12], "is cut short"),  # the last chunk, which is the end alone
        (with_rows(whole, 15), "does not hold 16 rows of 1808 pixels"),
        (with_rows(whole, 17), "does not hold 16 rows of 1808 pixels"),
        (with_rows(whole, 16, row_filter=5), "does not hold 16 rows of 1808 pixels"),
        (whole[:60] + bytes([whole[60] ^ 1]) + whole[61:], "a checksum in it is wrong"),
        (b"GIF89a" + whole, "is not a PNG image"),
        (np.zeros((16, 100)), "16 rows and 1808 columns", "it has 16 rows, 100 columns"),
        (np.zeros((16, 1808, 3), np.uint8), "must be a grey image"),
        (np.full((16, 1808), 40_000), "an azimuth is 400 degrees"),
        (whole + b"\0" * 300_000, "is larger than an image"),
        (None, "no such file"),
    ):
        if isinstance(broken, bytes):
            file.write_bytes(broken)
        elif broken is None:
            file.unlink()
        else:
            write_image(file, broken)
        about = file.name.replace("azimuth", "range") if "400 degrees" in said[0] else file.name
        assert_refused(lambda: list(open_recording(part).read(0, 3)), about, *said)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.replace("52.2159", "152.21"), "no latitude, longitude, height"),
        (lambda text: text.replace("2015_11", "2015_31", 1), "line 1: '2015_31"),
        (lambda text: text[:47], "line 1: has"),
        (lambda text: text.splitlines()[0], "holds 1 positions"),
        (lambda text: "\n".join(text.splitlines()[:5]), "is 0.20 m long"),
    ],
)
def test_wrong_positions(part: Path, change: object, said: str) -> None:
    file = part / "gps-latlong.txt"
    assert callable(change)
    file.write_text(change(file.read_text()))
    refused(part, str(file), said)
