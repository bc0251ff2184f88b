"""``gpgrad locate`` finds a simulated rover on the elevation model that it drove over."""

import json
from pathlib import Path

import numpy as np
import pytest

from app.cli import run
from gpgrad_core.io.folder import load_dataset
from tests.end_to_end.process import gpgrad

rasterio = pytest.importorskip("rasterio", reason="rasterio is not installed")
CELL, SIDE = 0.2, 250
EAST, NORTH = 300_000.0, 4_000_000.0


def write_model(path: Path) -> None:
    """Rough ground of 60 m in a GeoTIFF."""
    chance = np.random.default_rng(3)
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE, CELL), np.fft.fftfreq(SIDE, CELL)))
    power = (k + 0.02) ** -1.6 * np.exp(-((k * 0.8) ** 2))
    heights = np.fft.ifft2(np.fft.fft2(chance.normal(size=k.shape)) * power).real
    heights *= 2.0 / heights.std()
    profile = {
        "driver": "GTiff", "width": SIDE, "height": SIDE, "count": 1, "dtype": "float32",
        "crs": "EPSG:32633",
        "transform": rasterio.transform.Affine(CELL, 0, EAST, 0, -CELL, NORTH),
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as file:
        file.write(heights.astype("float32"), 1)


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("locate")
    write_model(folder / "dem.tif")
    flags = ["--num-submaps", "3", "--extent", "45", "--max-points", "5000", "--rock-density", "0"]
    terrain = ["--terrain", str(folder / "dem.tif")]
    assert run(["simulate", str(folder / "drive"), *terrain, *flags]) == 0
    return folder


@pytest.mark.slow
def test_a_drive_is_found(driven: Path) -> None:
    out, shown = driven / "located.json", driven / "shown"
    arguments = ("locate", str(driven / "drive"), "--map", str(driven / "dem.tif"), "--out")
    finished = gpgrad(*arguments, str(out), "--show", str(shown))
    assert finished.code == 0, finished.err
    assert "submaps found on dem.tif" in finished.out
    content = json.loads(out.read_text())
    assert content["system"] == "EPSG:32633"
    truth = {submap.id: submap.pose_true for submap in load_dataset(driven / "drive").submaps}
    # The simulated world has its zero in the corner of a square around the model's middle.
    corner = np.array([EAST, NORTH - SIDE * CELL]) + (SIDE * CELL - 45) / 2
    for row in content["submaps"]:
        pose = truth[row["submap"]]
        assert pose is not None
        place = row["T_map_submap"]
        located = np.array([place["x"], place["y"]]) - corner
        assert np.linalg.norm(located - pose.translation[:2]) < 0.4
        assert np.linalg.eigvalsh(row["covariance"]).min() > 0
    accepted = [row["submap"] for row in content["submaps"] if row["accepted"]]
    assert accepted
    assert [submap.id for submap in load_dataset(shown).submaps][:-1] == accepted
    assert "--overwrite" in gpgrad(*arguments, str(out)).refusal


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (("--near", "0,0,5"), "no 100 heights together within 5 m of 0, 0"),
        (("--near", "1,2"), "an origin is"),
        (("--near", "1,2,-3"), "the radius must be above 0"),
        (("--map-noise", "0"), "--map-noise must be from"),
        (("--poses", "no.txt", "--merged"), "no.txt"),
        (("--poses", "no.txt"), "which --merged asks for"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(
    flags: tuple[str, ...], said: str, driven: Path
) -> None:
    drive, terrain, out = (str(driven / name) for name in ("drive", "dem.tif", "no.json"))
    assert said in gpgrad("locate", drive, "--map", terrain, "--out", out, *flags).refusal
    assert not Path(out).exists()
