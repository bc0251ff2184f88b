"""`gpgrad slam`, as a process."""

import json
import shutil
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio

from gpgrad_core.io.records.closures import read_closures
from gpgrad_core.slam import read_run
from tests.core.pages.walk import read_page
from tests.end_to_end.conftest import ground
from tests.end_to_end.process import gpgrad
from tests.support.closures import content_of


@pytest.mark.slow
def test_a_traverse_is_corrected_and_merged(traverse: Path, tmp_path: Path) -> None:
    out = tmp_path / "map"
    finished = gpgrad("slam", traverse, "--out", out, "--merged.resolution", "0.1")
    assert finished.code == 0, finished.err
    assert "4 submaps, 1 loop closure used, 0 refused as wrong" in finished.out
    (closure,) = read_closures(out / "closures.json").accepted
    assert closure.pair == ("003", "000")
    assert closure.registration.covariance is not None
    poses = np.loadtxt(out / "poses_corrected.txt")
    assert poses[:, 0].tolist() == [0, 1, 2, 3]
    # The closure says what odometry, which is right here, says too.
    np.testing.assert_allclose(poses[3, 1:3], [0.5, 0.4], atol=0.1)
    report = json.loads((out / "report.json").read_text())
    assert report["trajectory_error"] == {}  # there is no truth
    assert (out / "cloud.ply").stat().st_size > 10_000
    assert {path.suffix for path in out.iterdir()} >= {".png", ".tif", ".npz", ".g2o", ".txt"}
    page = read_page((out / "page.html").read_text(encoding="utf-8"))
    assert len(page.content["submaps"]) == 4
    assert page.content["poses"]["after"] is not None
    assert [(k[0], k[1]) for k in page.content["lines"]] == [(3, 0)]


@pytest.mark.slow
@pytest.mark.parametrize("how", ["at once", "stepwise", "given"])
def test_a_cloud_that_cannot_be_a_map_is_left_out(how: str, traverse: Path, tmp_path: Path) -> None:
    folder, out = tmp_path / "traverse", tmp_path / "map"
    shutil.copytree(traverse, folder)
    next((folder / "submaps").glob("001.*")).unlink()
    np.savetxt(folder / "submaps" / "001.xyz", np.linspace([0, 0, 0], [3, 3, 1], 40))
    flags: tuple[str | Path, ...] = ()
    if how == "stepwise":
        flags = ("--record", tmp_path / "run.gpgrad")
    elif how == "given":
        flags = ("--closures", write_by_hand(tmp_path / "mine.json", accepted=True))
    finished = gpgrad("slam", folder, "--out", out, *flags)
    assert finished.code == 0, finished.err
    assert "001.xyz: all 40 points lie on one line seen from above" in finished.err
    assert "3 submaps, 1 loop closure used" in finished.out
    assert np.loadtxt(out / "poses_corrected.txt")[:, 0].tolist() == [0, 2, 3]
    page = read_page((out / "page.html").read_text(encoding="utf-8"))
    assert len(page.content["submaps"]) == 3


@pytest.mark.slow
def test_closures_found_before_are_taken_and_no_map_is_made(traverse: Path, tmp_path: Path) -> None:
    closures = write_by_hand(tmp_path / "mine.json", accepted=True)
    out = tmp_path / "map"
    finished = gpgrad("slam", traverse, "--out", out, "--closures", closures, "--no-merge")
    assert "1 loop closure used" in finished.out
    assert not (out / "cloud.ply").exists()


@pytest.mark.slow
def test_the_page_judges_the_verdicts_by_the_truth(with_truth: Path, tmp_path: Path) -> None:
    closures = write_by_hand(tmp_path / "mine.json", accepted=True)
    out = tmp_path / "map"
    gpgrad("slam", with_truth, "--out", out, "--closures", closures, "--no-merge")
    text = (out / "page.html").read_text(encoding="utf-8")
    curve = read_page(text).content["curve"]
    assert curve is not None
    assert curve["true"] >= 1
    assert "average precision" in text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("accepted", "decided", "x", "said"),
    [
        (True, False, 0.5, "0 loop closures used, 0 refused as wrong"),
        # Odometry contradicts these: the solver refuses one, unless a person vouches for it.
        (True, None, 3.5, "0 loop closures used, 1 refused as wrong"),
        (True, True, 3.5, "1 loop closure used, 0 refused as wrong"),
    ],
)
def test_what_a_person_decided_is_heeded(
    accepted: bool, decided: bool | None, x: float, said: str, traverse: Path, tmp_path: Path
) -> None:
    decision = {"accepted": decided, "note": "seen from above"}
    closures = write_by_hand(tmp_path / "mine.json", accepted=accepted, x=x, decision=decision)
    flags = ("--closures", closures, "--no-merge")
    assert said in gpgrad("slam", traverse, "--out", tmp_path / "map", *flags).out


def write_by_hand(
    path: Path, *, accepted: bool, x: float = 0.5, decision: dict[str, object] | None = None
) -> Path:
    """Write one closure of the traverse, as another tool might."""
    record: dict[str, object] = {
        "query": "003",
        "database": "000",
        "num_inliers": 20,
        "score": 5.0,
        "dissimilarity": 1.0,
        "overlap_area": 20.0,
        "accepted": accepted,
        "reason": "by hand",
        "T_database_query": {"x": x, "y": 0.4, "yaw": 3.0},
    }
    if decision is not None:
        record["decision"] = decision
    content = {
        "dataset": "x",
        "method": "mine",
        "seed": 0,
        "params": {},
        "versions": {},
        "seconds": {},
        "submaps": [],
        "pairs": [record],
    }
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--closures", "none.json"), "none.json"),
        (("--search-radius", "-1"), "--search-radius must be above 0 m"),
        (("--search-radius", "far"), "--search-radius: the value must be a number, got 'far'"),
        (("--graph.odometry-drift", "7"), "--graph.odometry-drift: the value must be from 0 to 1"),
        (("--merged.voxel", "0"), "--merged.voxel: the value must be from 0.001"),
    ],
)
def test_wrong_usage_is_one_line(
    traverse: Path, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    assert said in gpgrad("slam", traverse, "--out", tmp_path / "map", *arguments).refusal
    assert not (tmp_path / "map").exists()


def test_without_odometry_it_says_so_at_once(traverse: Path, tmp_path: Path) -> None:
    line = gpgrad("slam", traverse / "submaps", "--out", tmp_path / "map").refusal
    assert "a pose graph needs odometry, and submap 000 has none" in line


@pytest.mark.slow
def test_a_recorded_drive_ends_as_it_would_without_the_record(
    traverse: Path, tmp_path: Path
) -> None:
    plain, recorded, record = tmp_path / "plain", tmp_path / "recorded", tmp_path / "run.gpgrad"
    flags = ("--no-merge", "--cache", "none")
    assert gpgrad("slam", traverse, "--out", plain, *flags).code == 0
    command = ("slam", traverse, "--out", recorded, "--record", record, *flags)
    assert gpgrad(*command).code == 0
    for name in ("poses_corrected.txt", "graph.g2o"):
        assert (plain / name).read_bytes() == (recorded / name).read_bytes()
    first, second = (read_closures(folder / "closures.json") for folder in (plain, recorded))
    assert content_of(first)["pairs"] == content_of(second)["pairs"]
    assert first.params == second.params
    run = read_run(record)
    assert not run.notes
    accepted = {(c.query_id, c.database_id) for m in run.moments for c in m.accepted}
    assert accepted == {pair.pair for pair in first.accepted}
    written = np.loadtxt(recorded / "poses_corrected.txt")[:, 1:]
    np.testing.assert_allclose(run.moments[-1].places, written, atol=1e-6)
    assert (
        "run.gpgrad: exists already"
        in gpgrad(*command[:2], "--out", tmp_path / "new", *command[4:]).refusal
    )


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--record", "run.txt"), "run.txt: the ending must be one of .gpgrad"),
        (("--record", "r.gpgrad", "--closures", "c.json"), "--record does not go with --closures"),
        (("--record", "r.gpgrad", "--scheduler", "tcp://x:1"), "does not go with --record"),
    ],
)
def test_a_record_that_cannot_be_is_refused_before_the_work(
    flags: tuple[str, ...], says: str, traverse: Path, tmp_path: Path
) -> None:
    assert says in gpgrad("slam", traverse, "--out", tmp_path / "map", *flags).refusal


def write_model(path: Path, *, crs: str | None = "EPSG:32633") -> Path:
    """Write the ground of the traverse as an elevation model, 30 m above it."""
    cell, east, north = 1.0, 500_000.0, 4_000_000.0
    fine = np.arange(-10.5, 29.5, cell / 4) + cell / 8
    many = len(fine) // 4
    heights = 30.0 + ground(*np.meshgrid(fine, fine)).reshape(many, 4, many, 4).mean(axis=(1, 3))
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=many,
        height=many,
        count=1,
        dtype="float32",
        crs=crs,
        transform=rasterio.transform.Affine(
            cell, 0.0, east - 10.5, 0.0, -cell, north - 10.5 + many * cell
        ),
    ) as file:
        file.write(heights[::-1].astype("float32"), 1)
    return path


@pytest.mark.slow
def test_a_map_is_anchored_on_an_elevation_model(traverse: Path, tmp_path: Path) -> None:
    closures = write_by_hand(tmp_path / "mine.json", accepted=True)
    model, out = write_model(tmp_path / "dem.tif"), tmp_path / "map"
    flags = ("--anchor-start", "500000,4000000,0", "--anchor-std", "0.1", "--crs", "EPSG:32633")
    flags = (*flags, "--closures", closures, "--no-merge", "--no-page")
    finished = gpgrad("slam", traverse, "--out", out, "--anchor", model, *flags)
    assert finished.code == 0, finished.err
    assert "anchored on dem.tif: 4 heights of its surface" in finished.out
    assert "placed by the elevation model" in finished.out
    poses = np.loadtxt(out / "poses_corrected.txt")
    report = json.loads((out / "report.json").read_text())
    origin = report["anchor"]["origin"]
    assert origin == [499_990.0, 3_999_990.0]  # near the model's corner
    np.testing.assert_allclose(poses[:, 3], 30.0, atol=0.2)
    np.testing.assert_allclose(poses[1, 1:3] + origin, [500_010.0, 4_000_000.0], atol=1.0)
    covariances = np.loadtxt(out / "covariances_corrected.txt")
    assert covariances.shape == (4, 1 + 21)
    assert 0.01 < np.sqrt(covariances[0, 1 + 11]) < 0.2  # of z
    (first,) = [
        feature["geometry"]["coordinates"]
        for feature in json.loads((out / "poses.geojson").read_text())["features"]
        if feature["properties"].get("submap") == "000"
    ]
    place = pyproj.Transformer.from_crs(4326, 32633, always_xy=True).transform(*first[:2])
    np.testing.assert_allclose(place, poses[0, 1:3] + origin, atol=0.01)


@pytest.mark.parametrize(
    ("model", "flags", "said"),
    [
        ({}, ("--anchor-std", "0"), "--anchor-std must be above 0"),
        ({}, ("--anchor-start", "5,x"), "--anchor-start 5,x: must be E,N,YAW"),
        ({"crs": "EPSG:4326"}, (), "dem.tif: is in degrees; project it to metres first"),
        ({}, ("--crs", "EPSG:32634"), "dem.tif: is in EPSG:32633, not in EPSG:32634"),
        ({"crs": None}, ("--origin", "37,15,0"), "dem.tif: names no coordinate system"),
        (None, ("--anchor-std", "1"), "--anchor-std 1.0: needs the elevation model"),
        (
            None,
            ("--anchoring.start-std", "2"),
            "--anchoring.start-std 2.0: needs the elevation model",
        ),
    ],
)
def test_a_model_that_cannot_be_used_is_one_line(
    traverse: Path,
    tmp_path: Path,
    model: dict[str, str | None] | None,
    flags: tuple[str, ...],
    said: str,
) -> None:
    if model is not None:
        file = write_model(tmp_path / "dem.tif", **model)
        flags = (*flags, "--anchor", str(file))
    assert said in gpgrad("slam", traverse, "--out", tmp_path / "map", *flags).refusal
    assert not (tmp_path / "map").exists()
