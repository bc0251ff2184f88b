from dataclasses import replace

import numpy as np
import pytest

from app.viewer.session.state import (
    ViewOptions,
    neighbour,
    open_dataset,
    promising_pair,
    same_surfaces,
    was_fitted,
    with_fitted,
    with_pair,
    with_params,
)
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.features import FeatureParams
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.registration import RegistrationParams
from gpgrad_core.types import Dataset, Submap
from tests.support.synthetic import NUMBERS, make_dataset, needing


def test_a_dataset_opens_at_a_revisit() -> None:
    state = open_dataset(make_dataset(), PipelineParams())
    assert (state.query_id, state.database_id) == ("003", "000")
    assert [submap.id for submap in state.pair] == ["003", "000"]
    preferring = replace(state.dataset, preferred={"query": "001", "database": "002"})
    assert promising_pair(preferring) == ("001", "002")
    points = np.random.default_rng(0).normal(size=(20, 3))
    bare = tuple(Submap.from_points(points, name) for name in "abc")
    assert promising_pair(Dataset("plain", bare)) == ("c", "a")  # the last and the first
    assert promising_pair(Dataset("single", bare[:1])) == ("a", "a")


def test_surfaces_are_the_same_whatever_is_found_on_them() -> None:
    state = open_dataset(make_dataset(), NUMBERS)
    assert same_surfaces(state, with_params(state, needing(20)))
    masked = replace(state.params, features=FeatureParams(max_std_ratio=0.2))
    smoother = replace(state.params, map=MapParams(length_scale=0.4))
    for other in (
        with_params(state, masked),
        with_params(state, smoother),
        replace(state, options=ViewOptions(layer="std")),
        with_pair(state, query_id="001"),
        open_dataset(make_dataset(), PipelineParams()),
    ):
        assert not same_surfaces(state, other)


def test_a_pair_is_made_of_two_submaps() -> None:
    state = open_dataset(make_dataset(), PipelineParams())
    with pytest.raises(InputError, match="003 beside itself is no pair"):
        with_pair(state, query_id="003", database_id="003")
    with pytest.raises(InputError, match="beside itself"):
        replace(state, query_id=state.database_id)
    # Whoever names one of the two for the other's role has them change places.
    for swapped in (with_pair(state, query_id="000"), with_pair(state, database_id="003")):
        assert (swapped.query_id, swapped.database_id) == ("000", "003")


def test_one_submap_is_shown_alone() -> None:
    lone = open_dataset(replace(make_dataset(), submaps=make_dataset().submaps[:1]), needing(3))
    assert not lone.is_pair
    assert lone.names == "000"
    assert with_pair(lone, query_id="000", database_id="000").query is lone.dataset.submaps[0]
    with pytest.raises(InputError, match="needs two submaps"):
        _ = lone.pair


def test_neighbours_go_round_and_pass_over_the_other_submap() -> None:
    dataset = make_dataset()
    assert neighbour(dataset, "003", 1) == "000"
    assert neighbour(dataset, "000", -1) == "003"
    assert neighbour(dataset, "003", 1, skip="000") == "001"
    lone = Dataset("one", dataset.submaps[:1])
    assert neighbour(lone, "000", 1, skip="000") == "000"


FITTED = replace(
    PipelineParams(),
    map=MapParams(length_scale=0.4, noise_std=0.03, signal_std=0.2, scale=0.19),
    registration=RegistrationParams(inlier_radius=0.24),
)


def test_what_is_automatic_is_computed_with_the_fitted_number() -> None:
    state = open_dataset(make_dataset(), PipelineParams(), used=FITTED)
    assert (state.asked, state.params, state.resolved) == (PipelineParams(), FITTED, True)
    # What needs no fit keeps the numbers.
    closer = with_params(state, replace(PipelineParams(), closure=needing(9).closure))
    assert closer.resolved
    assert closer.params == replace(FITTED, closure=needing(9).closure)
    finer = with_params(state, PipelineParams(map=MapParams(resolution=0.1)))
    assert finer.resolved
    assert finer.params.map == replace(FITTED.map, resolution=0.1)
    radius = with_params(state, PipelineParams(registration=RegistrationParams(inlier_radius=0.5)))
    assert radius.resolved


def test_what_needs_a_fit_waits_for_it_with_the_numbers_before() -> None:
    state = open_dataset(make_dataset(), PipelineParams(), used=FITTED)
    by_hand = with_params(state, PipelineParams(map=MapParams(length_scale=0.8)))
    assert not by_hand.resolved
    assert by_hand.params.map == replace(FITTED.map, length_scale=0.8)
    noisier = replace(by_hand.params, map=replace(by_hand.params.map, noise_std=0.05))
    fitted = with_fitted(by_hand, noisier)
    assert (fitted.params, fitted.resolved, fitted.asked) == (noisier, True, by_hand.asked)
    assert was_fitted(by_hand, fitted)
    assert not was_fitted(state, by_hand)
    assert not with_params(fitted, PipelineParams()).resolved  # its length-scale is one of a hand
    wider = PipelineParams(map=MapParams(scale=0.5))
    assert not with_params(state, wider).resolved  # the inlier radius follows from it
    assert with_params(state, FITTED).resolved


def test_before_any_fit_the_numbers_are_a_guess() -> None:
    state = open_dataset(make_dataset(), PipelineParams())
    assert not state.resolved
    assert state.params.map == MapParams().guessed
    whole = replace(PipelineParams(), map=MapParams(length_scale=0.3, noise_std=0.05))
    assert with_params(open_dataset(make_dataset(), FITTED), whole).params.map.signal_std is None
