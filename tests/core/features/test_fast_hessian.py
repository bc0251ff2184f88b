"""Fast-Hessian: against mahotas, against filters spelled out, and on blobs of known place."""

import cv2
import numpy as np
import pytest
from mahotas.features import surf as mahotas_surf

from gpgrad_core.arrays import Array
from gpgrad_core.features import fast_hessian
from gpgrad_core.features.fast_hessian import filter_sides, find_blobs
from tests.core.features.maps import ground_turned_by


@pytest.fixture(scope="module")
def image() -> Array:
    return ground_turned_by(0)[0].gradient


def test_all_of_mahotas_points_are_found(image: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    # mahotas takes a weight of 0.6, keeps a far wider margin, and mixes up x and y when it
    # interpolates: so the cells and their responses are compared, not the last fraction.
    monkeypatch.setattr(fast_hessian, "XY_WEIGHT", 0.6)
    theirs = mahotas_surf.interest_points(image, 4, 4, 1, threshold=1e-6)
    assert len(theirs) > 50
    blobs = find_blobs(image)
    nearest = np.abs(blobs.responses[:, None] - theirs[:, 3]).argmin(axis=0)
    same = np.isclose(blobs.responses[nearest], theirs[:, 3], rtol=1e-6)
    # What is missing has its peak so far off that ours leaves it out.
    assert same.mean() > 0.9
    ours = nearest[same]
    offset = np.abs(blobs.pixels[ours] - theirs[same][:, [1, 0]]).max(axis=1)
    # Ours may lie a cell off the peak and theirs half a cell; a cell is at most a tenth of a side.
    assert (offset <= 1.5 * np.maximum(1.0, 0.1 * blobs.sides[ours])).all()
    assert (blobs.signs[ours] == theirs[same, 4]).all()


def test_filters_are_the_boxes_of_the_paper(image: Array) -> None:
    side, lobe = filter_sides(0)[1], 5
    across = np.repeat([1.0, -2.0, 1.0], lobe)[None] * np.ones((2 * lobe - 1, 1))
    edge = np.r_[np.ones(lobe), 0.0, -np.ones(lobe)]
    xx, yy, xy = (
        cv2.filter2D(image, cv2.CV_64F, kernel)[side:-side, side:-side] / side**2
        for kernel in (across, across.T.copy(), np.outer(edge, edge))
    )
    determinant, trace = np.zeros((2, *image.shape))
    integral = fast_hessian.integral_image(image)
    fast_hessian._fill_hessian(integral, side, 1, determinant, trace)  # pyright: ignore
    inside = (slice(side, -side), slice(side, -side))
    np.testing.assert_allclose(determinant[inside], xx * yy - 0.81 * xy**2, atol=1e-10)
    np.testing.assert_allclose(trace[inside], xx + yy, atol=1e-10)


@pytest.mark.parametrize("sigma", [2.5, 4.0, 8.0])
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


def test_contrast_changes_no_place(image: Array) -> None:
    a, b = find_blobs(image), find_blobs(100 + 1e3 * image)
    assert len(a.sides) > 100
    np.testing.assert_allclose(a.pixels, b.pixels, atol=1e-6)
    np.testing.assert_allclose(1e6 * a.responses, b.responses, rtol=1e-5, atol=1e-9)


def test_a_shifted_image_has_shifted_blobs(image: Array) -> None:
    # By a multiple of the coarsest octave's step, or other cells would be looked at.
    a, b = find_blobs(image[:160, :160]), find_blobs(image[16:176, 8:168])
    shifted = a.pixels - [8, 16]
    apart = np.abs(shifted[:, None] - b.pixels).max(axis=2).min(axis=1)
    inner = ((shifted > 80) & (shifted < 81)).any(axis=1) | ((shifted > 60) & (shifted < 80)).all(
        axis=1
    )
    small = a.sides < 40
    assert (inner & small).sum() > 3
    assert (apart[inner & small] < 1e-6).all()


@pytest.mark.parametrize("shape", [(1, 1), (8, 300), (30, 30), (40, 57)])
def test_small_images_have_few_blobs_or_none(shape: tuple[int, int]) -> None:
    noise = np.random.default_rng(0).random(shape)
    blobs = find_blobs(noise)
    if min(shape) < 22:
        assert len(blobs.sides) == 0
    assert blobs.pixels.shape == (len(blobs.sides), 2)


def test_planes_have_no_blobs() -> None:
    y, x = np.mgrid[:90, :100]
    assert len(find_blobs(np.full((90, 100), 0.7)).sides) == 0
    assert len(find_blobs(0.1 + 0.003 * x - 0.002 * y).sides) == 0
