"""XYZ products of rovers: labels and images written by the rules of PDS3, and tables of PLACES."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gpgrad_core.io.folder import load_dataset
from gpgrad_core.recordings.build import build_dataset, open_recording
from gpgrad_core.recordings.params import BuildParams
from tests.support.recordings import refused

pytest.importorskip("pdr", reason="the extra 'pds' is not installed")

LABEL = """\
PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = {record}
FILE_RECORDS = {records}
^IMAGE = ("{name}.IMG", 1)
DATA_SET_ID = "MSL-M-NAVCAM-5-RDR-V1.0"
ROVER_MOTION_COUNTER_NAME = ("SITE", "DRIVE", "POSE", "ARM")
ROVER_MOTION_COUNTER = ({site}, {drive}, 4, 0)
SPACECRAFT_CLOCK_START_COUNT = "{clock}"
GROUP = ROVER_COORDINATE_SYSTEM
 COORDINATE_SYSTEM_NAME = ROVER_NAV_FRAME
 ORIGIN_OFFSET_VECTOR = ({offset})
 ORIGIN_ROTATION_QUATERNION = ({turn})
 REFERENCE_COORD_SYSTEM_NAME = SITE_FRAME
END_GROUP = ROVER_COORDINATE_SYSTEM
GROUP = DERIVED_IMAGE_PARMS
 DERIVED_IMAGE_TYPE = XYZ_MAP
 REFERENCE_COORD_SYSTEM_NAME = {frame}
END_GROUP = DERIVED_IMAGE_PARMS
OBJECT = IMAGE
 INTERCHANGE_FORMAT = BINARY
 LINES = {lines}
 LINE_SAMPLES = {samples}
 SAMPLE_TYPE = IEEE_REAL
 SAMPLE_BITS = 32
 BANDS = 3
 BAND_STORAGE_TYPE = BAND_SEQUENTIAL
 MISSING_CONSTANT = (0.0, 0.0, 0.0)
END_OBJECT = IMAGE
END
"""
LINES, SAMPLES = 30, 40
TURNS = [Rotation.from_euler("ZYX", [20.0 * k, 3.0, -4.0], degrees=True) for k in range(3)]
PLACES = [np.array([2.0 * k, 0.5 * k, -0.1 * k]) for k in range(3)]


def ground(xy: np.ndarray) -> np.ndarray:
    """Depth below the site's level [m]: z points down."""
    return 0.2 * np.sin(xy[:, 0]) - 0.1 * np.cos(1.3 * xy[:, 1]) + 1.0


def write_product(folder: Path, k: int, frame: str, *, site: int = 7) -> Path:
    """Write what the rover sees from its place k: a fan of ground ahead, with gaps."""
    rng = np.random.default_rng(k)
    xy = PLACES[k][:2] + rng.uniform(-4, 4, (LINES * SAMPLES, 2))
    points = np.column_stack([xy, ground(xy)])
    if frame != "SITE_FRAME":
        points = TURNS[k].inv().apply(points - PLACES[k])
    points[::5] = 0.0
    name = f"NLB_{k:03d}XYZ_F0070010NCAM00200M1"
    bands = points.T.reshape(3, LINES, SAMPLES).astype(">f4")
    (folder / f"{name}.IMG").write_bytes(bands.tobytes())
    x, y, z, w = TURNS[k].as_quat()
    text = LABEL.format(
        record=4 * SAMPLES,
        records=3 * LINES,
        name=name,
        site=site,
        drive=10 * k,
        clock=f"39750{k}188.872",
        offset=", ".join(f"{value:.9f}" for value in PLACES[k]),
        turn=", ".join(f"{value:.9f}" for value in (w, x, y, z)),
        frame=frame,
        lines=LINES,
        samples=SAMPLES,
    )
    label = folder / f"{name}.LBL"
    label.write_text(text.replace("\n", "\r\n"), newline="")
    return label


def write_places(path: Path) -> Path:
    """Write a table of PLACES: the site lies at north 5000, east -300 and height 12."""
    rows = ["frame,site,drive,pose,landing_x,northing,easting,elevation,roll,pitch,yaw"]
    rows.append("SITE,7,-1,-1,0,5000,-300,12,0,0,0")
    for k in range(3):
        north, east, down = PLACES[k] + [5000.0, -300.0, -12.0]
        angles = f"-4,3,{20 * k}"
        rows.append(f"ROVER,7,{10 * k},4,0,{north:.6f},{east:.6f},{-down:.6f},{angles}")
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(
    ("frame", "with_places"),
    [("SITE_FRAME", False), ("SITE_FRAME", True), ("ROVER_NAV_FRAME", True)],
)
def test_products_of_a_rover(frame: str, with_places: bool, tmp_path: Path) -> None:
    folder = tmp_path / "sol"
    folder.mkdir()
    for k in range(3):
        write_product(folder, k, frame)
    if with_places:
        write_places(folder / "localized_interp.csv")
    recording = open_recording(folder)
    assert recording.up == "-z"
    assert "its z axis points down and is turned up" in recording.notes[0]
    shift = np.array([5000.0, -300.0, -12.0]) if with_places else np.zeros(3)
    for k, points in enumerate(scan.points for scan in recording.read(0, 3)):
        assert len(points) == 4 * LINES * SAMPLES // 5
        world = recording.sensor(k).apply(points) - shift
        np.testing.assert_allclose(world[:, 2], ground(world[:, :2]), atol=1e-4)
    build_dataset(folder, tmp_path / "out", BuildParams(max_length=1.0))
    dataset = load_dataset(tmp_path / "out")
    assert len(dataset.submaps) == 3
    for submap in dataset.submaps:
        world = submap.pose_odometry.apply(submap.points)
        # Upright: north, west and up.
        back = world * [1.0, -1.0, -1.0] - shift
        assert np.median(np.abs(back[:, 2] - ground(back[:, :2]))) < 0.01


def test_several_sites(tmp_path: Path) -> None:
    write_product(tmp_path, 0, "SITE_FRAME")
    write_product(tmp_path, 1, "SITE_FRAME", site=8)
    refused(tmp_path, "the sites 7, 8", "localized_interp.csv")
    table = write_places(tmp_path / "mine.csv")
    refused(tmp_path, *(str(table), "no place of site 8, drive 10"), poses=table)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("BANDS = 3", "BANDS = 1", "has 1 bands"),
        ("SITE_FRAME\r\nEND_GROUP = D", "MAST_FRAME\r\nEND_GROUP = D", "MAST_FRAME"),
        ("ORIGIN_OFFSET_VECTOR", "ORIGIN_VECTOR", "ORIGIN_OFFSET_VECTOR must have 3 numbers"),
        ("ROVER_MOTION_COUNTER =", "MOTION =", "ROVER_MOTION_COUNTER must have 3 numbers"),
        ("LINES = 30", "LINES = 30000000", "30000000"),
        ('"397500188.872"', '"UNK"', "SPACECRAFT_CLOCK_START_COUNT"),
        ("yaw", "heading", "has no column yaw"),
        (",4,0,5000", ",4,5000", "line 3: has 10 columns, the first row 11"),
        ("ROVER,7,0", "ROVER,7.5,0", "line 3: site, drive and pose must be whole numbers"),
        ("ROVER,7,0,4,0,5000", "ROVER,7,0,4,0,x", "line 3: holds something that is not a number"),
        (",-4,3,0\n", ",-4,3,9999\n", "line 3: yaw, pitch and roll"),
        ("ROVER,", "SITE,", "holds no place of the rover"),
    ],
)
def test_wrong_labels_and_tables(old: str, new: str, said: str, tmp_path: Path) -> None:
    files = [write_product(tmp_path, 0, "SITE_FRAME"), write_places(tmp_path / "best_interp.csv")]
    (wrong,) = (file for file in files if old.encode() in file.read_bytes())
    wrong.write_bytes(wrong.read_bytes().replace(old.encode(), new.encode()))
    refused(tmp_path, str(wrong), said)


def test_cut_and_missing_images(tmp_path: Path) -> None:
    label = write_product(tmp_path, 0, "SITE_FRAME")
    image = label.with_suffix(".IMG")
    image.write_bytes(image.read_bytes()[:5000])
    refused(tmp_path, str(label), "image")
    image.unlink()
    refused(tmp_path, str(label), "is not beside it")
