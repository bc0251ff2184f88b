import base64
from typing import get_args

import cv2
import numpy as np
import pytest

from app.viewer.scene.colors import (
    INLIER,
    colorize,
    for_line_ends,
    for_lines,
    hillshade,
    legend_uri,
    lookup_table,
    shade,
)
from app.viewer.session.state import ColorMap
from gpgrad_core.errors import InputError

NAMED = [name for name in get_args(ColorMap) if name != "automatic"]


@pytest.mark.parametrize("name", NAMED)
def test_every_colour_map_has_256_colours_that_change(name: str) -> None:
    table = lookup_table(name)
    assert table.shape == (256, 3)
    assert table.dtype == np.uint8
    assert len(np.unique(table, axis=0)) > 200


def test_viridis_runs_from_purple_to_yellow_in_rgb() -> None:
    table = lookup_table("viridis")
    np.testing.assert_allclose(table[0], (68, 1, 84), atol=3)
    np.testing.assert_allclose(table[-1], (253, 231, 37), atol=3)


def test_blue_white_red_is_white_in_the_middle() -> None:
    low, middle, high = lookup_table("blue-white-red")[[0, 127, 255]]
    assert low[2] > low[0]
    assert high[0] > high[2]
    assert middle.min() > 220


def test_a_choice_that_is_no_colour_map_is_refused() -> None:
    with pytest.raises(InputError, match="no colour map is named 'automatic'"):
        lookup_table("automatic")


def test_values_beyond_the_ends_take_the_end_colours() -> None:
    colors = colorize(np.array([-9.0, 0.0, 0.5, 1.0, 9.0]), 0.0, 1.0, "grey")
    assert (colors[0] == colors[1]).all()
    assert (colors[3] == colors[4]).all()
    assert colors[0, 0] < colors[2, 0] < colors[4, 0]


def test_an_empty_range_is_no_division_by_zero() -> None:
    assert colorize(np.full(3, 2.0), 2.0, 2.0, "grey").shape == (3, 3)


def test_level_ground_keeps_its_colour_and_slopes_to_the_light_are_brighter() -> None:
    towards, level, away = hillshade(np.array([[0.5, -0.5], [0.0, 0.0], [-0.5, 0.5]]))
    assert level == pytest.approx(1.0)
    assert towards > 1.0 > away > 0.0


def test_the_light_stays_with_the_scene_when_a_submap_is_turned() -> None:
    yaw = 0.7
    world = np.array([[0.4, -0.1]])
    c, s = np.cos(yaw), np.sin(yaw)
    local = np.array([[c * 0.4 + s * -0.1, -s * 0.4 + c * -0.1]])
    np.testing.assert_allclose(hillshade(local, yaw), hillshade(world))


def test_shading_goes_to_white_and_to_black() -> None:
    colors = np.full((2, 3), 250, dtype=np.uint8)
    np.testing.assert_array_equal(
        shade(colors, np.array([1.4, 0.5])), [[252, 252, 252], [125, 125, 125]]
    )


def decoded(color: tuple[int, int, int]) -> np.ndarray:
    """Do what the browser does to the one colour of all lines of a node."""
    srgb = np.array(color) / 255
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def tone_map(linear: np.ndarray) -> np.ndarray:
    """Do to linear light what the browser does: three's ACESFilmicToneMapping."""
    into = np.array(
        [[0.59719, 0.35458, 0.04823], [0.076, 0.90834, 0.01566], [0.0284, 0.13383, 0.83777]]
    )
    out = np.array(
        [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.076]]
    )
    v = into @ (linear / 0.6)
    v = (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.432951) + 0.238081)
    shown = np.clip(out @ v, 0, 1)
    encoded = np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055)
    return np.round(255 * encoded)


def test_the_model_of_the_browser_agrees_with_what_was_measured() -> None:
    np.testing.assert_allclose(tone_map(decoded((40, 200, 60))), (96, 205, 82), atol=1)


@pytest.mark.parametrize("color", [INLIER, (214, 69, 65), (120, 120, 120), (31, 119, 200)])
def test_lines_come_out_in_the_wanted_colour(color: tuple[int, int, int]) -> None:
    np.testing.assert_allclose(tone_map(decoded(for_lines(color))), color, atol=2)
    # Eight bits of linear light are coarse where it is dark.
    np.testing.assert_allclose(
        tone_map(for_line_ends(np.array([color], np.uint8))[0, 1] / 255), color, atol=6
    )


def test_the_legend_is_a_png_of_the_colour_map() -> None:
    uri = legend_uri(lookup_table("viridis")[None])
    head, _, body = uri.partition(",")
    assert head == "data:image/png;base64"
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(body), np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(picture[0, :, ::-1], lookup_table("viridis"))
