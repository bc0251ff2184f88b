from dataclasses import replace

import numpy as np
import pytest

from app.viewer.scene.thumbnails import GAP, PORTRAIT, SIDE, portrait, thumbnail
from tests.support.synthetic import T_DATABASE_QUERY, make_compared, make_map

COMPARED = make_compared()


def test_a_small_picture_lays_both_into_one_window() -> None:
    query, database = (make_map(COMPARED.dataset.submap(name)) for name in ("003", "000"))
    picture = thumbnail(query, database, T_DATABASE_QUERY, 0.9)
    left, right = picture[:, :SIDE], picture[:, -SIDE:]
    both = (left[..., 3] > 0) & (right[..., 3] > 0)
    assert both.mean() > 0.15
    difference = np.abs(left[both].astype(int) - right[both].astype(int)).mean()
    assert difference < 8  # the same ground
    apart = thumbnail(query, database, None, 0.9)
    both = (apart[:, :SIDE, 3] > 0) & (apart[:, -SIDE:, 3] > 0)
    unlike = apart[:, :SIDE][both].astype(int) - apart[:, -SIDE:][both].astype(int)
    assert np.abs(unlike).mean() > 2 * difference


def test_a_small_picture_cuts_neither_however_far_apart_they_lie() -> None:
    query, database = (make_map(COMPARED.dataset.submap(name)) for name in ("003", "000"))
    far = replace(T_DATABASE_QUERY, x=T_DATABASE_QUERY.x + 12.0)
    tiles = np.split(thumbnail(query, database, far, 0.9)[..., 3] > 0, [SIDE, SIDE + GAP], axis=1)
    left, right = float(tiles[0].mean()), float(tiles[2].mean())
    assert min(left, right) > 0.01
    assert left == pytest.approx(right, rel=0.4)  # of a size, so neither is cut


def test_a_portrait_shows_the_ground_of_a_submap_and_nothing_else() -> None:
    submap = COMPARED.dataset.submap("003")
    picture = portrait(submap)
    assert picture.shape == (PORTRAIT, PORTRAIT, 4)
    seen = picture[..., 3] > 0
    assert 0.3 < seen.mean() <= 1.0
    assert len(np.unique(picture[seen][:, :3], axis=0)) > 20
    # The widest submaps and the narrowest have grids as well.
    for factor in (1e-3, 1e3):
        scaled = replace(submap, points=submap.points * factor)
        assert (portrait(scaled)[..., 3] > 0).any()
