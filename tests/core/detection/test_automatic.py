"""Parameters that choose themselves."""

from dataclasses import replace

import numpy as np
import pytest

from gpgrad_core.detection import (
    PipelineParams,
    describe_choice,
    infer_gradient_map,
    infer_slope_variance,
    is_resolved,
    register_pair,
    resolve_parameters,
)
from gpgrad_core.errors import InputError
from gpgrad_core.mapping.fitting import fit_parameters
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods import METHODS
from gpgrad_core.registration import RegistrationParams
from gpgrad_core.run.memo import Memo
from tests.support.ground import submap

MEMO = Memo()


SUBMAPS = tuple(submap(k, 400, (4.0, 4.0)) for k in range(2))


def test_what_is_not_given_is_fitted() -> None:
    assert not is_resolved(PipelineParams())
    chosen = resolve_parameters(SUBMAPS, memo=MEMO)
    assert is_resolved(chosen)
    fitted = fit_parameters(SUBMAPS, choose=True).params
    assert chosen.map.length_scale == pytest.approx(fitted.length_scale, rel=1e-3)
    assert chosen.map.noise_std == pytest.approx(fitted.noise_std, rel=1e-3)
    assert chosen.map.signal_std == pytest.approx(fitted.signal_std, rel=1e-3)
    assert chosen.registration.inlier_radius == pytest.approx(
        PipelineParams().registration.radius(chosen.map.scale), rel=1e-3
    )
    untouched = replace(chosen.registration, inlier_radius=None)
    assert replace(chosen, map=MapParams(), registration=untouched) == PipelineParams()
    assert resolve_parameters(SUBMAPS, chosen) is chosen


def test_a_number_that_is_given_is_taken_as_it_is() -> None:
    asked = PipelineParams(map=MapParams(length_scale=0.3, resolution=0.1))
    chosen = resolve_parameters(SUBMAPS, asked, MEMO)
    assert chosen.map.length_scale == 0.3
    assert chosen.map.resolution == 0.1
    assert chosen.map.noise_std is not None
    start = MapParams(length_scale=0.3).guessed.terrain
    beside = fit_parameters(SUBMAPS, start, fixed=("length_scale",), choose=True).params
    assert beside.length_scale == 0.3
    assert chosen.map.noise_std == pytest.approx(beside.noise_std, rel=1e-3)


def test_the_scale_is_fitted_and_the_signal_is_the_points_own_where_the_rest_is_given() -> None:
    fitted = [
        resolve_parameters(
            SUBMAPS, PipelineParams(map=MapParams(length_scale=length, noise_std=0.05)), MEMO
        ).map
        for length in (0.2, 0.8)
    ]
    scale = resolve_parameters(SUBMAPS, memo=MEMO).map.scale
    assert [(one.scale, one.signal_std) for one in fitted] == [(scale, None)] * 2
    given = PipelineParams(
        map=MapParams(length_scale=0.3, noise_std=0.05, scale=0.5),
        registration=RegistrationParams(inlier_radius=0.5),
    )
    assert resolve_parameters(SUBMAPS, given) is given


def test_a_fit_is_kept() -> None:
    memo, heard = Memo(), list[float]()
    first = resolve_parameters(SUBMAPS, memo=memo, progress=heard.append)
    assert len(heard) > 3
    assert heard == sorted(heard)
    heard.clear()
    assert resolve_parameters(SUBMAPS, memo=memo, progress=heard.append) == first
    assert heard == [1.0]


def test_only_the_methods_with_a_fitted_gp_fit() -> None:
    asked = PipelineParams()
    assert is_resolved(METHODS["gradient"].resolve(SUBMAPS, asked, MEMO))
    smoothed = METHODS["smoothed"].resolve(SUBMAPS, asked, MEMO)
    assert smoothed == replace(asked, map=asked.map.guessed)  # its own defaults
    paper = METHODS["paper"].resolve(SUBMAPS, asked, MEMO).map
    assert (paper.length_scale, paper.noise_std) == (None, None)  # it fits every submap by itself


def test_what_was_chosen_is_said_in_a_line() -> None:
    asked = PipelineParams(map=MapParams(noise_std=0.05))
    used = resolve_parameters(SUBMAPS, asked, MEMO)
    said = describe_choice(asked, used)
    assert said.startswith(f"fitted: length-scale {used.map.length_scale:.3g} m, signal ")
    assert f"scale of comparison {used.map.scale:.3g} m" in said
    assert "noise" not in said
    assert describe_choice(used, used) == ""


def test_one_submap_by_itself_is_fitted_too() -> None:
    (one, _), grid = SUBMAPS, MapParams(resolution=0.1)
    fitted = resolve_parameters([one], PipelineParams(map=grid)).map
    by_itself, given = infer_gradient_map(one, grid), infer_gradient_map(one, fitted)
    assert by_itself.length_scale == fitted.length_scale
    np.testing.assert_array_equal(by_itself.elevation, given.elevation)
    np.testing.assert_array_equal(
        infer_slope_variance(one, grid), infer_slope_variance(one, fitted)
    )


def test_a_pair_is_registered_with_what_is_fitted_to_it() -> None:
    asked = PipelineParams(map=MapParams(resolution=0.1))
    used = resolve_parameters(SUBMAPS, asked, MEMO)
    automatic = register_pair(*SUBMAPS, asked, MEMO)
    assert automatic.query_map.length_scale == used.map.length_scale
    assert automatic.registration is register_pair(*SUBMAPS, used, MEMO).registration


@pytest.mark.parametrize("given", [{}, {"length_scale": 0.3}, {"noise_std": 0.05}])
def test_no_number_stands_in_silently_for_an_automatic_one(given: dict[str, float]) -> None:
    missing = "noise_std" if "length_scale" in given else "length_scale"
    with pytest.raises(InputError, match=rf"map\.{missing} is automatic"):
        _ = MapParams(**given).terrain  # type: ignore[arg-type]
    assert MapParams(**given).guessed.terrain is not None  # type: ignore[arg-type]
