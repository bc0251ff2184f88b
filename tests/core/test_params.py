"""Params: bounds and their rounding, fields by their paths, and what TOML may say of them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typing_extensions import Doc

from gpgrad_core.detection import PipelineParams
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.errors import InputError
from gpgrad_core.features import FeatureParams
from gpgrad_core.mapping.gradient_map import MapParams, TerrainParams
from gpgrad_core.matching import MatchParams
from gpgrad_core.params import (
    Bounds,
    Field,
    bounds_of,
    check_bounds,
    fields_of,
    get_path,
    parameters_of,
    preferred_parameters,
    read_parameters,
    to_tables,
    with_path,
    with_tables,
)
from gpgrad_core.registration import RegistrationParams
from gpgrad_core.types import Dataset
from tests.support.refusal import assert_refused

PARAMS = (MapParams, TerrainParams, FeatureParams, MatchParams, RegistrationParams, ClosureParams)
steps = st.sampled_from([1e-3, 0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 1.0, 10.0])


@dataclass(frozen=True)
class Oven:
    heat: Annotated[float, Bounds(20.0, 250.0, 5.0, "°C"), Doc("How hot.")] = 180.0
    minutes: Annotated[int | None, Bounds(1, 90, 1)] = None
    fan: Annotated[bool, Doc("Whether it blows.")] = False

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True)
class Grill:
    heat: Literal["low", "high"] = "low"

    def __post_init__(self) -> None:
        check_bounds(self)


@given(steps, st.integers(-10_000, 10_000), st.floats(-0.5, 0.5))
def test_all_values_near_a_step_become_one_value(step: float, k: int, off: float) -> None:
    bounds, value = Bounds(-1e6, 1e6, step), (k + off) * step
    once = bounds.round(value)
    assert bounds.round(once) == once
    assert abs(once - value) <= step * 0.5000001 + 1e-6
    if abs(off) < 0.4:
        assert once == bounds.round(k * step)


@given(st.integers(0, 10_000))
def test_it_is_the_number_that_a_person_would_type(k: int) -> None:
    assert Bounds(0.0, 100.0, 0.01).round(k * 0.01) == float(f"{k / 100:.2f}")


def test_a_slider_offers_all_unless_told() -> None:
    assert Bounds(0.0, 2.0, 0.1).slider_range == (0.0, 2.0)
    assert Bounds(0.0, 2.0, 0.1, slider=(0.5, 1.0)).slider_range == (0.5, 1.0)


def test_fields_are_found_in_order() -> None:
    heat, minutes, fan = fields_of(Oven)
    bounds = bounds_of(Oven)
    assert list(bounds) == ["heat", "minutes"]
    assert heat == Field("heat", float, bounds["heat"], False, 180.0, "How hot.")
    assert minutes == Field("minutes", int, bounds["minutes"], True, None, "")
    assert fan == Field("fan", bool, None, False, False, "Whether it blows.")


@pytest.mark.parametrize("heat", [19.999, 250.001, float("nan"), float("inf"), -float("inf")])
def test_values_outside_are_refused_by_name_rule_and_value(heat: float) -> None:
    for right in (20.0, 250.0, 33):
        assert Oven(heat=right, minutes=None).heat == right
    assert_refused(lambda: Oven(heat=heat), f"heat must be from 20 to 250 °C, got {heat!r}")
    assert_refused(lambda: Grill("mild"), "heat must be one of low, high, got 'mild'")


def test_every_parameter_goes_there_and_back_by_its_path_and_in_tables() -> None:
    params = PipelineParams()
    for field in parameters_of(PipelineParams):
        assert get_path(params, field.path) == field.default
        if field.bounds is None:
            continue
        low = int(field.bounds.low) if field.kind is int else float(field.bounds.low)
        changed = with_path(params, field.path, low)
        assert get_path(changed, field.path) == low
        assert with_path(changed, field.path, field.default) == params
    assert with_tables(params, to_tables(params), "here") == params


def test_only_objects_can_be_checked() -> None:
    for wrong in (Oven, 3.0):
        with pytest.raises(TypeError, match="dataclass object"):
            check_bounds(wrong)


@pytest.mark.parametrize("params", PARAMS, ids=lambda params: params.__name__)
def test_every_parameter_of_the_pipeline_is_sound(params: type) -> None:
    default = params()
    assert default == params()
    assert hash(default) == hash(params())
    for field in fields_of(params):
        bounds = field.bounds
        if bounds is None:
            continue
        low, high = bounds.slider_range
        assert bounds.low <= low < high <= bounds.high
        assert 0 < bounds.step <= high - low
        assert field.doc.endswith(".")
        if field.default is not None:
            assert low <= field.default <= high
            assert bounds.round(field.default) == field.default
        for right in (bounds.low, bounds.high):
            assert getattr(params(**{field.name: right}), field.name) == right
        for wrong in (bounds.low - bounds.step, bounds.high + bounds.step):
            with pytest.raises(InputError, match=field.name):
                params(**{field.name: wrong})


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
