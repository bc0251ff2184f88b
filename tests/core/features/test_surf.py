"""SURF: blobs against mahotas and filters spelled out; headings and descriptors under turns."""

import cv2
import numpy as np
import pytest
from mahotas.features import surf as mahotas_surf

from gpgrad_core.arrays import Array
from gpgrad_core.features import surf
from gpgrad_core.features.surf import (
    SIGMA_OF_SIDE,
    SIGN_DISTANCE,
    describe,
    detect_surf,
    fill_hessian,
    filter_sides,
    find_blobs,
    find_headings,
    integral_image,
)
from tests.core.features.maps import ground_turned_by


@pytest.fixture(scope="module")
def ground() -> Array:
    return ground_turned_by(0)[0].gradient


@pytest.fixture(scope="module")
def image() -> Array:
    return ground_turned_by(0, 0.03)[0].gradient[:220, :240]


def test_all_of_mahotas_points_are_found(ground: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    # mahotas takes a weight of 0.6, keeps a far wider margin, and mixes up x and y when it
    # interpolates: so the cells and their responses are compared, not the last fraction.
    monkeypatch.setattr(surf, "XY_WEIGHT", 0.6)
    theirs = mahotas_surf.interest_points(ground, 4, 4, 1, threshold=1e-6)
    assert len(theirs) > 50
    blobs = find_blobs(ground)
    nearest = np.abs(blobs.responses[:, None] - theirs[:, 3]).argmin(axis=0)
    same = np.isclose(blobs.responses[nearest], theirs[:, 3], rtol=1e-6)
    # What is missing has its peak so far off that ours leaves it out.
    assert same.mean() > 0.9
    ours = nearest[same]
    offset = np.abs(blobs.pixels[ours] - theirs[same][:, [1, 0]]).max(axis=1)
    # Ours may lie a cell off the peak and theirs half a cell; a cell is at most a tenth of a side.
    assert (offset <= 1.5 * np.maximum(1.0, 0.1 * blobs.sides[ours])).all()
    assert (blobs.signs[ours] == theirs[same, 4]).all()


def test_filters_are_the_boxes_of_the_paper(ground: Array) -> None:
    side, lobe = filter_sides(0)[1], 5
    across = np.repeat([1.0, -2.0, 1.0], lobe)[None] * np.ones((2 * lobe - 1, 1))
    edge = np.r_[np.ones(lobe), 0.0, -np.ones(lobe)]
    xx, yy, xy = (
        cv2.filter2D(ground, cv2.CV_64F, kernel)[side:-side, side:-side] / side**2
        for kernel in (across, across.T.copy(), np.outer(edge, edge))
    )
    determinant, trace = np.zeros((2, *ground.shape))
    integral = integral_image(ground)
    fill_hessian(integral, side, 1, determinant, trace)
    inside = (slice(side, -side), slice(side, -side))
    np.testing.assert_allclose(determinant[inside], xx * yy - 0.81 * xy**2, atol=1e-10)
    np.testing.assert_allclose(trace[inside], xx + yy, atol=1e-10)


@pytest.mark.parametrize("sigma", [2.5, 8.0])
@pytest.mark.parametrize(("column", "row"), [(60.0, 71.0), (65.3, 58.6)])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_blob_is_found_where_it_is_and_as_wide(
    sigma: float, column: float, row: float, sign: int
) -> None:
    y, x = np.mgrid[:140, :130]
    image = 0.3 + sign * 0.2 * np.exp(-((x - column) ** 2 + (y - row) ** 2) / (2 * sigma**2))
    blobs = find_blobs(image)
    best = int(np.argmax(blobs.responses))
    np.testing.assert_allclose(blobs.pixels[best], [column, row], atol=0.15 * sigma)
    # The share of the blob is the same at every size. It is not one: a filter of side L has the
    # spread of a Gaussian of L / 6 along its lobes, and Bay calls that 1.2 L / 9.
    assert 0.6 * sigma < 1.2 / 9 * blobs.sides[best] < 0.9 * sigma
    assert blobs.signs[best] == -sign


def test_planes_have_no_blobs() -> None:
    y, x = np.mgrid[:90, :100]
    assert len(find_blobs(np.full((90, 100), 0.7)).sides) == 0
    assert len(find_blobs(0.1 + 0.003 * x - 0.002 * y).sides) == 0


def test_a_ramp_heads_uphill_and_says_so() -> None:
    y, x = np.mgrid[:200, :200]
    image = 0.01 * (x * np.cos(0.6) + y * np.sin(0.6))
    middle = np.array([[100.0, 97.0]])
    integral, sigmas = integral_image(image), np.array([3.0])
    heading = find_headings(integral, middle, sigmas)
    # A sixth of a turn holds all of a ramp's responses, which are alike.
    assert heading[0] == pytest.approx(0.6, abs=0.02)
    cells = describe(integral, middle, sigmas, heading).reshape(4, 4, 4)
    along, across, along_size, across_size = np.moveaxis(cells, -1, 0)
    np.testing.assert_allclose(along, along_size, atol=1e-4)
    assert np.abs(across).max() < 0.05 * along.max()
    assert across_size.max() < 0.05 * along.max()


def test_contrast_and_brightness_change_nothing(image: Array) -> None:
    a, b = detect_surf(image), detect_surf(5 + 40 * image)
    np.testing.assert_allclose(a.pixels, b.pixels, atol=1e-6)
    np.testing.assert_allclose(1600 * a.responses, b.responses, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(a.descriptors, b.descriptors, atol=1e-3)


def test_twice_the_size_is_the_same_descriptor(image: Array) -> None:
    size = (2 * image.shape[1] - 1, 2 * image.shape[0] - 1)
    y, x = np.mgrid[: size[1], : size[0]].astype(np.float32) / 2
    large = cv2.remap(image, x, y, cv2.INTER_CUBIC)
    blobs = find_blobs(image)
    inner = ((blobs.pixels > 70) & (blobs.pixels < image.shape[0] - 70)).all(axis=1)
    pixels, sigmas = blobs.pixels[inner], SIGMA_OF_SIDE * blobs.sides[inner]
    headings = find_headings(integral_image(image), pixels, sigmas)
    a = describe(integral_image(image), pixels, sigmas, headings)
    b = describe(integral_image(large), 2 * pixels, 2 * sigmas, headings)
    assert len(a) > 20
    assert np.median(np.linalg.norm(a - b, axis=1)) < 0.15


def test_bright_blobs_match_bright_ones_only(image: Array) -> None:
    a, b = detect_surf(image), detect_surf(-image)
    # The same places, all of the other sign.
    np.testing.assert_allclose(a.pixels, b.pixels, atol=1e-6)
    np.testing.assert_array_equal(a.descriptors[:, 64], -b.descriptors[:, 64])
    same, other = a.descriptors[:, 64] > 0, a.descriptors[:, 64] < 0
    apart = np.linalg.norm(a.descriptors[same][:, None] - a.descriptors[other], axis=2)
    within = np.linalg.norm(a.descriptors[same][:, None] - a.descriptors[same], axis=2)
    assert apart.min() >= SIGN_DISTANCE > 2.0 >= within.max()
