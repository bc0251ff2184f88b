"""Parameters out of TOML: what is said is taken, what cannot be is refused in one line."""

from pathlib import Path

import pytest

from gpgrad_core.detection import PipelineParams
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.params import preferred_parameters, read_parameters, to_tables, with_tables
from gpgrad_core.types import Dataset
from tests.support.refusal import assert_refused


def test_what_the_file_says_is_taken_and_the_rest_stays(tmp_path: Path) -> None:
    base = PipelineParams(map=MapParams(noise_std=0.2))
    path = tmp_path / "mine.toml"
    path.write_text("""
        [map]
        length_scale = 1  # a whole number where a number is wanted
        signal_std = 0.5
        [features.detector]
        name = "sift"
        [matching]
        mutual = false
        [closure]
        min_inliers = 12
        """)
    params = read_parameters(path, base)
    assert params.map == MapParams(length_scale=1.0, noise_std=0.2, signal_std=0.5)
    assert isinstance(params.map.length_scale, float)
    assert params.features.detector.name == "sift"
    assert params.matching.mutual is False
    assert params.closure.min_inliers == 12
    assert params.registration == base.registration


def test_all_parameters_go_there_and_back() -> None:
    params = PipelineParams()
    assert with_tables(params, to_tables(params), "here") == params


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("[map]\nlenght_scale = 0.3", "parameter map.lenght_scale; did you mean map.length"),
        ("[mapp]\nlength_scale = 0.3", "unknown parameter mapp; did you mean map?"),
        ("[xyzzy]\na = 1", "unknown parameter xyzzy; known: map, features, matching"),
        ("map = 3", "map must be a table, [map], got 3"),
        ("[map]\nlength_scale = '0.3'", 'length_scale must be a number or "automatic"'),
        ("[map]\nlength_scale = true", 'length_scale must be a number or "automatic", got True'),
        ("[map]\nmax_points = 3.5", 'max_points must be a whole number or "automatic", got 3.5'),
        ("[matching]\nmutual = 1", "matching.mutual must be true or false, got 1"),
        ("[map]\nlength_scale = 0.3\n[features.detector]\nname = 'mask'", "'surf' or 'slope'"),
        ("[map]\nlength_scale = -1", "map.length_scale must be from 0.01 to 100 m, got -1"),
        ("[map]\nlength_scale = nan", "map.length_scale must be from 0.01 to 100 m, got nan"),
        ("[map]\nlength_scale", "is not TOML"),
        ("[map\n", "is not TOML"),
        ("\udcff", "is not text in UTF-8"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path: Path, text: str, rule: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    assert_refused(lambda: read_parameters(path, PipelineParams()), f"{path}: ", rule)


def test_a_dataset_prefers_parameters_and_names_submaps_beside_them() -> None:
    dataset = Dataset("moon", (), preferred={"query": "008", "map": {"length_scale": 0.45}})
    params = preferred_parameters(dataset, PipelineParams())
    assert params == PipelineParams(map=MapParams(length_scale=0.45))
    wrong = Dataset("moon", (), preferred={"map": {"length_scale": 1e9}})
    place = "moon: dataset.toml, [preferred]: map.length_scale"
    assert_refused(lambda: preferred_parameters(wrong, PipelineParams()), place)
