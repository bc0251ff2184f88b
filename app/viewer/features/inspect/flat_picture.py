"""The pair as a flat picture: gradient images, keypoints and associations, drawn by OpenCV.

It is drawn from the same state and result as the scene. Side by side, the query's image stands
above the database's; registered, both lie on each other in the database's frame.
"""

from dataclasses import dataclass
from functools import cache
from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from app.viewer.scene.associations import (
    KINDS,
    inlier_color,
    keypoint_colors,
    keypoint_kinds,
    shown_kinds,
    shown_matches,
)
from app.viewer.scene.colors import CHOSEN, DATABASE, OUTLIER, QUERY, Rgb, colorize
from app.viewer.scene.layers import Paint, resample
from app.viewer.scene.placement import z_offset_of
from app.viewer.session.state import COMPARED, ViewState
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Grid

Image: TypeAlias = UInt8[NDArray[np.uint8], "rows columns 3"]
Table: TypeAlias = UInt8[NDArray[np.uint8], "256 3"]

WIDTH = 520
"""Of the picture [pixels]: twice the panel's, for when it is opened by itself."""
GAP = 8
HALF = 128
"""Shades of trusted ground in a table of colours; as many follow for masked ground."""
MASKED: Rgb = (58, 44, 98)
NOTHING: Rgb = (38, 38, 42)
SUBPIXEL_BITS = 4
FAINT, CLEAR = 0.35, 0.75
"""How opaque lines are: beside one that is pointed at, and where there is none."""


@dataclass(frozen=True, eq=False)
class _Sheet:
    """A part of the picture with ground on it."""

    grid: Grid  # its pixels in the frame that it is drawn in; row 0 is the lowest there
    left: int = 0  # column of the picture where it begins
    top: int = 0  # row of the picture where it begins

    def place(self, positions: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """Turn positions [m] into fractional (column, row) of the picture, whose row 0 is up."""
        pixels = self.grid.to_pixel(positions)
        return np.column_stack(
            [self.left + pixels[:, 0], self.top + self.grid.shape[0] - 1 - pixels[:, 1]]
        )

    @property
    def cells(self) -> tuple[slice, slice]:
        rows, columns = self.grid.shape
        return slice(self.top, self.top + rows), slice(self.left, self.left + columns)


def draw_pane(state: ViewState, result: PairResult) -> Image:
    """Draw the picture as the state asks: in its layout, with its lines and the association."""
    motion, still = result.registration.T_database_query, SE2()
    registered = motion is not None and state.options.layout == "registered"
    if registered and motion is not None:
        sheet = _common_sheet(result, motion)
        image = _registered_ground(state, result, motion, sheet)[::-1].copy()
        sheets, turns = (sheet, sheet), (motion, still)
    else:
        (sheets, image), turns = _stacked_ground(state, result), (still, still)

    def place(index: int, positions: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        return sheets[index].place(turns[index].apply(positions))

    ends = place(0, result.matches.query_xy), place(1, result.matches.database_xy)
    _draw_lines(image, state, result, *ends)
    kinds = [KINDS.index(kind) for kind in shown_kinds(state.options)]
    for index in (0, 1):
        shown = np.isin(keypoint_kinds(result, index), kinds)
        places = place(index, result.features[index].positions[shown])
        colors = keypoint_colors(result, index)[shown]
        if registered and state.options.compare == "swipe":
            right = places[:, 0] > state.options.swipe * (WIDTH - 1)
            kept = right if index else ~right
            places, colors = places[kept], colors[kept]
        _draw_dots(image, places, colors)
    if 1 <= state.match <= len(result.matches):
        _draw_chosen(image, result, state.match - 1, sheets, ends)
    return image


# The ground.


def _sheet_of(grid: Grid, *, top: int = 0) -> _Sheet:
    rows, columns = grid.shape
    width, height = (grid.resolution * max(count - 1, 1) for count in (columns, rows))
    resolution = width / (WIDTH - 1)
    return _Sheet(Grid(grid.origin, resolution, (int(height / resolution) + 1, WIDTH)), 0, top)


def _common_sheet(result: PairResult, motion: SE2) -> _Sheet:
    query, database = (gradient_map.grid.corners for gradient_map in result.maps)
    corners = np.concatenate([motion.apply(query), database])
    low, high = corners.min(axis=0), corners.max(axis=0)
    resolution = float(high[0] - low[0]) / (WIDTH - 1)
    rows = int((high[1] - low[1]) / resolution) + 1
    return _Sheet(Grid((float(low[0]), float(low[1])), resolution, (rows, WIDTH)))


def _stacked_ground(state: ViewState, result: PairResult) -> tuple[tuple[_Sheet, _Sheet], Image]:
    """Draw the query's image above the database's, each within its submap's colour."""
    above = _sheet_of(result.query_map.grid)
    below = _sheet_of(result.database_map.grid, top=above.grid.shape[0] + GAP)
    image = np.full((below.top + below.grid.shape[0], WIDTH, 3), NOTHING, dtype=np.uint8)
    paint = Paint(result.maps, "gradient", state.params.features.max_std_ratio)
    for index, (sheet, color) in enumerate(((above, QUERY), (below, DATABASE))):
        ground = _ground(paint, index, _greys(), sheet.grid, SE2(), NOTHING)
        image[sheet.cells] = ground[::-1]
        rows, columns = sheet.grid.shape
        last = columns - 1, sheet.top + rows - 1
        cv2.rectangle(image, (0, sheet.top), last, color, 3)
    return (above, below), image


def _registered_ground(state: ViewState, result: PairResult, motion: SE2, sheet: _Sheet) -> Image:
    """Draw both maps in one frame as the comparison asks; row 0 is the lowest y."""
    options, grid = state.options, sheet.grid
    if options.layer in COMPARED:
        return _compared_ground(state, result, motion, grid)
    paint = Paint(result.maps, "gradient", state.params.features.max_std_ratio)
    both = options.compare in ("both", "blink")
    beyond = (0, 0, 0) if both else NOTHING
    query, database = (
        _ground(paint, index, _tints(color) if both else _greys(), grid, T_map_sheet, beyond)
        for index, (T_map_sheet, color) in enumerate(((motion.inverse(), QUERY), (SE2(), DATABASE)))
    )
    match options.compare:
        case "query":
            return query
        case "database":
            return database
        case "swipe":
            column = int(options.swipe * (WIDTH - 1))
            query[:, column:] = database[:, column:]
            query[:, max(column - 1, 0) : column + 1] = 255
            return query
        case "both" | "blink":
            # The two colours add up to grey where both maps are alike.
            return np.maximum(cv2.add(query, database), np.array(NOTHING, np.uint8))


def _compared_ground(state: ViewState, result: PairResult, motion: SE2, grid: Grid) -> Image:
    options, ratio = state.options, state.params.features.max_std_ratio
    z_offset = z_offset_of(result.registration, result.maps, ratio)
    paint = Paint(
        result.maps, options.layer, ratio, options.color_map, motion=motion, z_offset=z_offset
    )
    seen = resample(paint.fields[1], result.database_map.grid, grid, SE2())
    image = np.full((*grid.shape, 3), NOTHING, dtype=np.uint8)
    finite, scale = np.isfinite(seen), paint.scale
    image[finite] = colorize(seen[finite], scale.low, scale.high, scale.color_map)
    return image


def _ground(
    paint: Paint, index: int, table: Table, onto: Grid, T_map_sheet: SE2, beyond: Rgb
) -> Image:
    """Lay a map's gradient onto a sheet, in the table's first half, and its second if masked.

    A map far finer than the picture is thinned first. Beyond the map there is one colour.
    """
    gradient_map, scale = paint.maps[index], paint.scale
    grid = gradient_map.grid
    step = max(1, grid.shape[1] // WIDTH)
    thin = slice(None, None, step), slice(None, None, step)
    values = paint.fields[index][thin]
    span = max(scale.high - scale.low, 1e-12)
    shades = ((values - scale.low) * (HALF / span)).clip(0, HALF - 1).astype(np.uint8)
    shades[~gradient_map.trusted(paint.max_std_ratio)[thin]] += HALF
    thinned = Grid(grid.origin, grid.resolution * step, values.shape)
    return resample(table[shades], thinned, onto, T_map_sheet, beyond=beyond)


@cache
def _greys() -> Table:
    """Give steep ground light greys, and masked ground a violet."""
    ramp = np.linspace(30, 240, HALF)[:, None].repeat(3, axis=1)
    return np.concatenate([ramp, ramp / 6 + MASKED]).astype(np.uint8)


@cache
def _tints(color: Rgb) -> Table:
    """Give steep ground light tints of a colour, and masked ground black."""
    ramp = np.linspace(0.12, 1.0, HALF)[:, None] * np.array(color)
    return np.concatenate([ramp, np.zeros_like(ramp)]).astype(np.uint8)


# What lies on it.


def _draw_lines(
    image: Image,
    state: ViewState,
    result: PairResult,
    start: Float[Array, "m 2"],
    end: Float[Array, "m 2"],
) -> None:
    options, over = state.options, image.copy()
    for wanted, inliers, color in (
        (options.outlier_lines, False, OUTLIER),
        (options.inlier_lines, True, inlier_color(result)),
    ):
        chosen = shown_matches(result, inliers=inliers, everything=options.all_lines)
        if wanted and chosen.any():
            lines = _fixed(np.stack([start[chosen], end[chosen]], axis=1))
            cv2.polylines(over, list(lines), False, color, 1, cv2.LINE_AA, SUBPIXEL_BITS)
    opacity = FAINT if state.match else CLEAR
    cv2.addWeighted(over, opacity, image, 1.0 - opacity, 0.0, dst=image)


def _draw_dots(
    image: Image, places: Float[Array, "k 2"], colors: UInt8[NDArray[np.uint8], "k 3"]
) -> None:
    for (x, y), color in zip(_fixed(places).tolist(), colors.tolist(), strict=True):
        cv2.circle(image, (x, y), 2 << SUBPIXEL_BITS, color, -1, cv2.LINE_AA, SUBPIXEL_BITS)


def _draw_chosen(
    image: Image,
    result: PairResult,
    index: int,
    sheets: tuple[_Sheet, _Sheet],
    ends: tuple[Float[Array, "m 2"], Float[Array, "m 2"]],
) -> None:
    """Draw one association boldly: its line, and round each end what its keypoint describes."""
    line = _fixed(np.stack([places[index] for places in ends]))
    for color, thickness in (((0, 0, 0), 5), (CHOSEN, 2)):
        cv2.polylines(image, [line], False, color, thickness, cv2.LINE_AA, SUBPIXEL_BITS)
    pair = result.matches.pairs[index]
    for sheet, place, features, keypoint in zip(sheets, line, result.features, pair, strict=True):
        radius = features.scales[keypoint] / 2 / sheet.grid.resolution
        fixed_radius = int(max(radius, 6.0) * (1 << SUBPIXEL_BITS))
        for color, thickness in (((0, 0, 0), 4), (CHOSEN, 2)):
            center = int(place[0]), int(place[1])
            cv2.circle(image, center, fixed_radius, color, thickness, cv2.LINE_AA, SUBPIXEL_BITS)


def _fixed(places: Float[Array, "*n 2"]) -> Int[NDArray[np.int32], "*n 2"]:
    """Turn pixels into the fixed-point numbers that OpenCV draws between pixels with."""
    return np.rint(places * (1 << SUBPIXEL_BITS)).astype(np.int32)
