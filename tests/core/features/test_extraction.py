"""Keypoints: in metres, at the right place, found again on turned ground, masked afterwards."""

from dataclasses import replace

import numpy as np
import pytest

from gpgrad_core.errors import InputError
from gpgrad_core.features import (
    DETECTORS,
    DetectorParams,
    FeatureParams,
    detect_features,
    extract_features,
    select_trusted,
)
from gpgrad_core.matching import match_features
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Grid
from tests.core.features.maps import by_hand, ground_turned_by, right_matches
from tests.support.ground import Ground, seen_from

IMAGE_BLOBS = [name for name, detector in DETECTORS.items() if detector.seeks == "blobs"]
LEAST_RIGHT = {"blobs": 0.9, "corners": 0.8, "landforms": 0.95}
"""Share of right associations on turned ground, by what a detector seeks."""
GRID = Grid((-5.0, -5.0), 0.05, (201, 201))  # of `ground_turned_by`


@pytest.mark.parametrize("name", DETECTORS)
@pytest.mark.parametrize(
    "degrees",
    [37, *(pytest.param(more, marks=pytest.mark.slow) for more in (180, 360))],  # 360: shifted only
)
def test_they_match_on_turned_ground(name: str, degrees: float) -> None:
    query, T_database_query = ground_turned_by(degrees)
    database, _ = ground_turned_by(0)
    params = FeatureParams(detector=DetectorParams(name))
    features = [extract_features(made, params) for made in (query, database)]
    right = right_matches(*features, T_database_query, 0.15, 4.7)
    assert len(right) > 100
    assert right.mean() >= LEAST_RIGHT[DETECTORS[name].seeks]


@pytest.mark.parametrize("name", IMAGE_BLOBS)
@pytest.mark.parametrize("place", [(1.3, -2.1), (-3.05, 2.0)])
def test_a_bump_is_found_where_it_is_and_as_wide_as_it_is(
    name: str, place: tuple[float, float]
) -> None:
    width = 0.25
    grid = Grid((-6.0, -5.0), 0.05, (201, 251))
    offsets = grid.positions - np.array(place)
    # A patch that is steep all over: a blob in the gradient image.
    steep = 1.2 * np.exp(-np.sum(offsets**2, axis=1) / (2 * width**2))
    made = by_hand(grid, np.column_stack([steep, np.zeros(grid.num_cells)]))
    features = detect_features(made, DetectorParams(name))
    strongest = int(np.argmax(features.responses))
    np.testing.assert_allclose(features.positions[strongest], place, atol=0.03)
    assert width < features.scales[strongest] < 10 * width


@pytest.mark.parametrize("name", DETECTORS)
def test_position_is_that_of_the_grid(name: str) -> None:
    made, _ = ground_turned_by(0)
    here = detect_features(made, DetectorParams(name))
    moved = Grid((95.0, -205.0), 0.05, GRID.shape)
    there = detect_features(replace(made, grid=moved), DetectorParams(name))
    assert len(here) > 50
    np.testing.assert_array_equal(here.descriptors, there.descriptors)
    np.testing.assert_allclose(
        here.positions + np.array([100.0, -200.0]), there.positions, atol=1e-9
    )


@pytest.mark.parametrize("name", DETECTORS)
def test_the_std_ratio_is_that_of_the_cell(name: str) -> None:
    made = ground_turned_by(0)[0]
    ramp = np.linspace(0.01, 1.0, GRID.shape[1]) * made.signal_std
    variance = np.broadcast_to(ramp**2, GRID.shape).copy()
    ramped = replace(made, variance=variance)
    features = detect_features(ramped, DetectorParams(name))
    # A keypoint half-way between two cells may have the ratio of either.
    ratio = np.interp(GRID.to_pixel(features.positions)[:, 0], np.arange(len(ramp)), ramp)
    half = 0.501 * (ramp[1] - ramp[0])
    np.testing.assert_allclose(made.signal_std * features.std_ratios, ratio, rtol=0, atol=half)
    for ratio in (0.3, 0.6, float(np.sort(features.std_ratios)[10])):  # one lies on the last
        kept = select_trusted(features, FeatureParams(max_std_ratio=ratio, max_keypoints=20_000))
        assert kept.std_ratios.max() <= ratio
        assert len(kept) == np.sum(features.std_ratios <= ratio)


def test_the_strongest_are_kept_in_their_order() -> None:
    features = detect_features(ground_turned_by(0)[0], DetectorParams("akaze"))
    kept = select_trusted(features, FeatureParams(max_std_ratio=1.0, max_keypoints=50))
    assert len(features) > 100
    assert len(kept) == 50
    assert kept.responses.min() >= np.sort(features.responses)[-50]
    order = [int(np.flatnonzero((features.positions == p).all(1))[0]) for p in kept.positions]
    assert order == sorted(order)


@pytest.mark.parametrize("name", DETECTORS)
@pytest.mark.parametrize("shape", [(1, 1), (2, 300), (15, 15), (17, 60)])
def test_tiny_maps_have_few_keypoints_or_none(name: str, shape: tuple[int, int]) -> None:
    tiny = seen_from(Ground.random(2), SE2(), Grid((0.0, 0.0), 0.05, shape))
    params = FeatureParams(detector=DetectorParams(name))
    features = extract_features(tiny, params)
    # Slopes are known at single cells already; blobs of an image need room.
    assert len(features) == 0 or min(shape) >= (3 if name == "slope" else 16)
    assert features.positions.shape == (len(features), 2)
    whole = extract_features(ground_turned_by(0)[0], params)
    assert features.descriptors.shape[1] == whole.descriptors.shape[1]
    assert len(features) == 0 or features.descriptors.dtype == whole.descriptors.dtype
    match_features(features, whole)  # either way round, and of nothing with nothing
    match_features(whole, features)
    match_features(features, features)


@pytest.mark.parametrize("name", DETECTORS)
def test_flat_ground_has_no_keypoints(name: str) -> None:
    flat = by_hand(GRID, np.zeros((*GRID.shape, 2)))
    assert len(extract_features(flat, FeatureParams(detector=DetectorParams(name)))) == 0


def test_the_gradient_range_is_what_an_8_bit_image_shows_as_white() -> None:
    made = ground_turned_by(0)[0]
    clipped = detect_features(made, DetectorParams("sift", gradient_range=0.05))
    assert len(clipped) != len(detect_features(made, DetectorParams("sift")))
    with pytest.raises(InputError, match="gradient_range"):
        DetectorParams("sift", gradient_range=0.0)
