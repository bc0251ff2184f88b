"""Methods by their names, and what is said of those that cannot run."""

from dataclasses import replace

import numpy as np
import pytest

from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.features import DetectorParams
from gpgrad_core.methods import METHODS, find_method
from gpgrad_core.run.memo import Memo
from tests.support.ground import submap


def test_the_promised_methods_are_there_under_their_own_names() -> None:
    promised = {"gradient", "paper", "elevation", "smoothed", "fpfh", "shot", "cshot", "chance"}
    assert set(METHODS) >= promised
    for name, method in METHODS.items():
        assert method.name == name
        assert method.summary.endswith(".")


def test_an_unknown_method_is_refused_with_all_that_are_known() -> None:
    with pytest.raises(InputError, match="unknown --method 'magic'; known: gradient, "):
        find_method("magic")


def test_a_missing_package_is_named_with_the_extra_that_brings_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    absent = replace(METHODS["kiss-matcher"], package="no_such_package")
    monkeypatch.setitem(METHODS, "kiss-matcher", absent)
    with pytest.raises(InputError, match=r"no_such_package is not installed: .*gpgrad\[peers\]"):
        find_method("kiss-matcher")


@pytest.mark.parametrize("name", ["fpfh", "fgr", "shot", "cshot", "chance", "scan-context"])
def test_rivals_without_a_dense_check_have_thresholds_of_their_own(name: str) -> None:
    asked = PipelineParams()
    adapted = METHODS[name].adapt(asked)
    assert adapted.closure.min_score == (0.86 if name == "scan-context" else 0)
    assert replace(adapted, closure=asked.closure) == asked


def test_a_method_that_fits_nothing_has_a_guess_for_what_is_automatic() -> None:
    for name, method in METHODS.items():
        params = method.ready(PipelineParams()).map
        assert (None in (params.length_scale, params.noise_std)) == (
            name in ("gradient", "elevation", "paper")
        )


def test_chance_guesses_the_same_again_and_something_else_for_another_seed() -> None:
    a, b = submap(1, 50), submap(2, 50)
    params = PipelineParams()
    other = replace(params, registration=replace(params.registration, seed=1))
    detectors = [METHODS["chance"].detector(p, Memo()) for p in (params, params, other)]
    first, again, different = (detector(a, b) for detector in detectors)
    assert first.score == again.score != different.score
    assert first.T_database_query == again.T_database_query
    assert 0 <= first.score < 1
    scores = [detectors[0](submap(k, 50), b).score for k in range(3, 40)]
    assert abs(np.mean(scores) - 0.5) < 0.2


def test_elevation_looks_at_its_image_with_a_detector_for_images() -> None:
    asked = PipelineParams()
    assert asked.features.detector.name == "slope"  # which would not look at the image
    adapted = METHODS["elevation"].adapt(asked)
    assert adapted.features.detector.name == "akaze"
    assert replace(adapted, features=asked.features) == asked
    other = replace(asked, features=replace(asked.features, detector=DetectorParams("sift")))
    assert METHODS["elevation"].adapt(other) == other
