"""The slope detector: the same at any resolution and turn, and blind to what was not seen."""

from dataclasses import replace

import numpy as np
import pytest

from gpgrad_core.features import DetectorParams, FeatureParams, detect_features, extract_features
from gpgrad_core.features.slope_field import detect_slope_field
from gpgrad_core.matching import match_features
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Grid
from tests.core.features.maps import by_hand, ground_turned_by, right_matches
from tests.support.ground import SIGNAL_STD, Ground, seen_from

SLOPE = DetectorParams("slope")


def test_resolution_does_not_matter() -> None:
    fine, coarse = (ground_turned_by(0, resolution)[0] for resolution in (0.05, 0.1))
    a, b = detect_features(fine, SLOPE), detect_features(coarse, SLOPE)
    right = right_matches(a, b, SE2(), 0.1, 4.2)
    assert len(right) > 60
    assert right.mean() > 0.97
    assert len(a) == pytest.approx(len(b), rel=0.1)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("place", [(1.3, -2.1), (-3.05, 2.0)])
def test_a_hill_or_a_pit_is_found_where_it_is(sign: int, place: tuple[float, float]) -> None:
    grid = Grid((-6.0, -5.0), 0.03, (334, 401))
    offset = grid.positions - np.array(place)
    height = sign * 0.4 * np.exp(-np.sum(offset**2, axis=1) / (2 * 0.4**2))
    features = detect_features(by_hand(grid, -height[:, None] * offset / 0.4**2, height), SLOPE)
    strongest = int(np.argmax(features.responses))
    np.testing.assert_allclose(features.positions[strongest], place, atol=0.03)
    assert 0.3 <= features.scales[strongest] <= 0.6  # diameter of its Gaussian [m]


def test_a_saddle_is_found_where_it_is() -> None:
    grid = Grid((-4.0, -4.0), 0.05, (161, 161))
    x, y = (grid.positions - [0.7, -0.4]).T
    fade = np.exp(-(x**2 + y**2) / (2 * 0.5**2))
    height = 0.8 * x * y * fade
    slope = np.stack([0.8 * y * fade - x * height / 0.25, 0.8 * x * fade - y * height / 0.25], -1)
    features = detect_features(by_hand(grid, slope, height), SLOPE)
    nearest = np.hypot(*(features.positions - [0.7, -0.4]).T).min()
    assert nearest < 0.02


def test_the_gradient_image_is_not_looked_at_but_its_vectors_are() -> None:
    made, _ = ground_turned_by(0)
    mirrored = replace(made, slope=made.slope * [-1, 1])
    a, b = detect_features(made, SLOPE), detect_features(mirrored, SLOPE)
    np.testing.assert_array_equal(made.gradient, mirrored.gradient)
    matches = match_features(a, b)
    right = np.hypot(*(matches.query_xy - matches.database_xy).T) < 0.1
    assert right.mean() < 0.2


def test_steepness_counts_and_height_does_not() -> None:
    made, _ = ground_turned_by(0)
    same = detect_slope_field(made)
    higher = detect_slope_field(replace(made, elevation=made.elevation + 40))
    np.testing.assert_array_equal(same.descriptors, higher.descriptors)
    steeper = detect_slope_field(replace(made, slope=2 * made.slope))
    np.testing.assert_allclose(steeper.pixels, same.pixels, atol=1e-3)
    np.testing.assert_allclose(steeper.descriptors, 2 * same.descriptors, atol=1e-3)


def test_what_was_not_seen_says_nothing() -> None:
    """Rubbish beyond the edge of what is known changes no keypoint far from it, and no match."""
    made, _ = ground_turned_by(0)
    unseen = made.grid.positions[:, 0].reshape(made.grid.shape) > 1.0
    variance = np.where(unseen, SIGNAL_STD**2, made.variance)
    rng = np.random.default_rng(0)
    slope = np.where(unseen[..., None], rng.normal(size=made.slope.shape), made.slope)
    half = replace(made, variance=variance, slope=slope)
    params = FeatureParams(detector=SLOPE)
    seen, whole = extract_features(half, params), extract_features(made, params)
    assert seen.positions[:, 0].max() <= 1.05
    matches = match_features(seen, whole)
    right = np.hypot(*(matches.query_xy - matches.database_xy).T) < 0.05
    assert right.mean() > 0.95
    # Also close to the edge, where a fifth of what a descriptor sees is gone.
    edge = matches.query_xy[:, 0] > 0.4
    assert edge.sum() >= 5
    assert right[edge].mean() > 0.8


def test_a_plane_has_no_keypoints() -> None:
    grid = Grid((0.0, 0.0), 0.05, (120, 140))
    slope = np.broadcast_to([0.3, -0.7], (*grid.shape, 2)).copy()
    assert len(detect_features(by_hand(grid, slope), SLOPE)) == 0


@pytest.mark.parametrize("length_scale", [0.03, 3.0, 100.0])
def test_any_length_scale_will_do(length_scale: float) -> None:
    grid = Grid((0.0, 0.0), 0.1, (60, 75))
    made = seen_from(Ground.random(0), SE2(), grid, length_scale=length_scale)
    found = detect_slope_field(made)
    assert np.isfinite(found.pixels).all()
    assert np.isfinite(found.descriptors).all()
    assert found.descriptors.shape == (len(found.pixels), 98)
