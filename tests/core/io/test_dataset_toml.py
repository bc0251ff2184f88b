"""dataset.toml: what is written comes back, and wrong types are refused."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from gpgrad_core.io.dataset_toml import read_dataset_toml, write_dataset_toml
from gpgrad_core.types import Dataset
from tests.support.laws import examples
from tests.support.refusal import assert_file_refused

IDS = frozenset({"000", "001"})
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=40)

VALUES = st.integers(1, 10**9) | st.floats(0.01, 100) | st.booleans() | TEXT
ABOUT: dict[str, st.SearchStrategy[Any]] = {
    "name": TEXT,
    "description": TEXT,
    "sensor_noise": st.dictionaries(st.sampled_from(["constant", "quadratic"]), st.floats(0, 10)),
    "origin": st.none() | st.tuples(st.floats(-90, 90), st.floats(-360, 360), st.floats(-1e5, 1e5)),
}


@examples(50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(about=st.fixed_dictionaries(ABOUT), of_map=st.dictionaries(TEXT, VALUES))
def test_everything_comes_back(
    about: dict[str, Any], of_map: dict[str, object], tmp_path: Path
) -> None:
    preferred = {"query": "001", "map": of_map, "closure": {}}
    written = Dataset(submaps=(), licence="MIT", preferred=preferred, **about)
    write_dataset_toml(tmp_path / "dataset.toml", written)
    assert vars(read_dataset_toml(tmp_path / "dataset.toml", IDS)) == vars(written)


def test_unknown_keys_are_ignored_aloud(tmp_path: Path) -> None:
    (tmp_path / "dataset.toml").write_text('name = "a"\ncolour = "red"\n[robot]\nwheels = 6\n')
    assert read_dataset_toml(tmp_path / "dataset.toml", IDS).notes == (
        "dataset.toml: the unknown key 'colour' was ignored",
        "dataset.toml: the unknown key 'robot' was ignored",
    )


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("name = 3", "'name' must be a text, got 3"),
        ("licence = ['MIT']", "'licence' must be a text, got a list"),
        ("name = unquoted", "is not TOML: "),
        ("origin = 3", "'origin' must be [latitude, longitude, height]"),
        ("origin = [91, 2, 3]", "'origin' must be [latitude, longitude, height]"),
        ("origin = [1, 2, nan]", "'origin' must be [latitude, longitude, height]"),
        ("origin = [1, true, 3]", "'origin' must be [latitude, longitude, height]"),
        ("sensor_noise = 0.1", "'sensor_noise' must be a table, got 0.1"),
        ("[sensor_noise]\nlinear = 1", "sensor_noise: has the unknown key 'linear'"),
        ("[sensor_noise]\nconstant = 'much'", "sensor_noise: 'constant' must be a finite number"),
        ("[sensor_noise]\nconstant = nan", "sensor_noise: 'constant' must be a finite number"),
        ("[sensor_noise]\nconstant = -1", "0 or more, got -1"),
        ("preferred = 1", "'preferred' must be a table, got 1"),
        ("[preferred]\nquery = 1", "preferred.query must be a submap's id in quotes, got 1"),
        ("[preferred]\ndatabase = '009'", "preferred.database names submap '009'"),
        ("[preferred]\nquery = '000'\ndatabase = '000'", "two different submaps, got '000' twice"),
        ("[preferred]\nlength_scale = 0.3", "preferred.length_scale must be a table"),
    ],
)
def test_wrong_types_are_refused(text: str, rule: str, tmp_path: Path) -> None:
    path = tmp_path / "dataset.toml"
    assert_file_refused(lambda path: read_dataset_toml(path, IDS), path, text, rule)
