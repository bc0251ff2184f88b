"""`gpgrad map`, as a process."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.end_to_end.process import QUICK_MAP, gpgrad, run_on_terminal


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    """A tilted, noisy plane of which two rows are broken: z = 3 + 0.2 x."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 4, (2000, 2))
    points = np.column_stack([xy, 3 + 0.2 * xy[:, 0] + rng.normal(0, 0.01, 2000)])
    points[[5, 50]] = np.nan
    points[70, 2] += 0.3  # and one is a bird
    np.save(tmp_path / "plane.npy", points)
    return tmp_path / "plane.npy"


def test_arrays_hold_the_terrain_and_broken_rows_are_counted_aloud(
    cloud: Path, tmp_path: Path
) -> None:
    out = tmp_path / "map.npz"
    finished = gpgrad("map", cloud, "--out", out, *QUICK_MAP)
    assert finished.code == 0, finished.err
    dropped, outlying = finished.err.splitlines()
    assert dropped.startswith("gpgrad: ")
    assert "plane.npy" in dropped
    assert "2 of 2,000" in dropped
    assert "1 of 1,998 points was left out: no ground explains it" in outlying
    assert str(out) in finished.out
    with np.load(out) as layers:
        middle = (slice(5, -5), slice(5, -5))
        columns = layers["origin"][0] + layers["resolution"] * np.arange(
            layers["elevation"].shape[1]
        )
        expected = np.broadcast_to(3 + 0.2 * columns, layers["elevation"].shape)
        np.testing.assert_allclose(layers["elevation"][middle], expected[middle], atol=0.05)
        assert np.median(layers["slope_x"][middle]) == pytest.approx(0.2, abs=0.02)
        assert np.median(layers["slope_y"][middle]) == pytest.approx(0.0, abs=0.02)
        np.testing.assert_allclose(
            layers["gradient"], np.hypot(layers["slope_x"], layers["slope_y"])
        )
        assert np.all(layers["variance"] > 0)


@pytest.mark.parametrize("ending", ["tif", "png"])
def test_pictures_open(cloud: Path, tmp_path: Path, ending: str) -> None:
    out = tmp_path / f"map.{ending}"
    finished = gpgrad("map", cloud, "--out", out, *QUICK_MAP)
    assert finished.code == 0, finished.err
    with Image.open(out) as image:
        assert min(image.size) >= 40


def test_a_parameter_file_serves_every_verb(cloud: Path, tmp_path: Path) -> None:
    toml = tmp_path / "mine.toml"
    toml.write_text(
        "[map]\nresolution = 0.2\nlength_scale = 0.3\nnoise_std = 0.02\nscale = 0.2\n"
        "[closure]\nmin_inliers = 5\n"
    )
    out = tmp_path / "map.npz"
    assert gpgrad("map", cloud, "--out", out, "--params", toml).code == 0
    with np.load(out) as layers:
        assert layers["resolution"] == 0.2


@pytest.mark.slow
def test_a_terminal_sees_a_bar(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "map.npz"
    code, seen = run_on_terminal("map", cloud, "--out", out, *QUICK_MAP)
    assert code == 0
    assert "map" in seen
    assert "100 %" in seen
    assert out.exists()
