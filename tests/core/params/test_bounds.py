"""Bounds: rounding that makes equal slider positions equal keys, and checks that name the rule."""

from dataclasses import dataclass
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
    with_path,
)
from gpgrad_core.registration import RegistrationParams
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


@given(steps, st.integers(-10_000, 10_000), st.floats(-0.4, 0.4))
def test_all_values_near_a_step_become_one_value(step: float, k: int, off: float) -> None:
    bounds = Bounds(-1e6, 1e6, step)
    assert bounds.round((k + off) * step) == bounds.round(k * step)


@given(steps, st.floats(-1000, 1000))
def test_rounding_twice_changes_nothing(step: float, value: float) -> None:
    bounds = Bounds(-1e6, 1e6, step)
    once = bounds.round(value)
    assert bounds.round(once) == once
    assert abs(once - value) <= step * 0.5000001 + 1e-6


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


def test_every_parameter_is_read_and_changed_by_its_path() -> None:
    params = PipelineParams()
    for field in parameters_of(PipelineParams):
        assert get_path(params, field.path) == field.default
        if field.bounds is None:
            continue
        low = int(field.bounds.low) if field.kind is int else float(field.bounds.low)
        changed = with_path(params, field.path, low)
        assert get_path(changed, field.path) == low
        assert with_path(changed, field.path, field.default) == params


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
