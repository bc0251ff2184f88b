"""What a fit found, as a file of parameters."""

from pathlib import Path

import pytest

from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.io.records.maps import write_fitted
from gpgrad_core.mapping.fitting import FitResult
from gpgrad_core.mapping.gradient_map import TerrainParams
from gpgrad_core.params.files import read_parameters


def found(params: TerrainParams) -> FitResult:
    return FitResult(params, 1.0, 2.0, 8000, 12, ("000", "001"))


@pytest.mark.parametrize(
    "params",
    [
        TerrainParams(2.0, 0.0123456, signal_std=1e-3),
        TerrainParams(0.4, noise_model="measured", noise_factor=1.25, signal_std=0.2),
        TerrainParams(0.4, 0.01, noise_model="range", noise_growth=5e-5, signal_std=0.2),
        TerrainParams(0.4, 0.01, noise_model="file"),
    ],
)
def test_it_is_read_as_parameters(tmp_path: Path, params: TerrainParams) -> None:
    write_fitted(tmp_path / "fit.toml", found(params))
    read = read_parameters(tmp_path / "fit.toml", PipelineParams()).map.guessed.terrain
    for name in ("length_scale", "noise_model", "noise_growth", "noise_factor", "signal_std"):
        assert getattr(read, name) == getattr(params, name), name
    if params.noise_model in ("constant", "range"):
        assert read.noise_std == params.noise_std
    assert "8000 points of submaps 000, 001" in (tmp_path / "fit.toml").read_text()


def test_no_folder_to_write_to(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no folder"):
        write_fitted(tmp_path / "nowhere" / "fit.toml", found(TerrainParams()))
