"""The layers of gradient maps: of one, of two against each other, and as coloured surfels.

A surfel is a small square for a cell, which browsers update fast. A mesh would need its faces
rebuilt whenever the variance mask moves; surfels only become fewer.
"""

from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from app.viewer.scene.colors import (
    UNTRUSTED_GREY,
    Rgb,
    colorize,
    hillshade,
    lookup_table,
    shade,
    tinted,
)
from app.viewer.scene.placement import HeightFrame, Placement
from app.viewer.session.state import ColorMap, Layer, Role, Untrusted
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.registration import map_agreement
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, Grid

Values: TypeAlias = Float[NDArray[np.float32], "_rows _columns"]
Cells: TypeAlias = Bool[NDArray[np.bool_], "_rows _columns"]

MAX_SAMPLES = 20_000
"""Enough cells to tell a range by."""
OVERLAP = 1.6
"""Side of a surfel in cells: seen aslant, neighbours must still touch."""
SHADED_LAYERS: tuple[Layer, ...] = ("elevation", "gradient")
ORIGIN = np.zeros(3)
OWN_LEVEL = HeightFrame()
"""Of a submap that is told in its own frame."""
MAX_LIT = 2_000
"""Enough cells to tell by how ground is to be lit."""
STEEP, MOST_RELIEF = 0.5, 6.0
"""Slope as which the steepest twentieth of the ground is lit at least [m/m], and how many times
steeper than it is any ground is lit at most."""


@dataclass(frozen=True)
class LayerStyle:
    """Name, unit and default colours of a layer."""

    label: str
    unit: str
    color_map: ColorMap
    symmetric: bool = False  # ends at equal distance from zero
    from_zero: bool = False


STYLES: dict[Layer, LayerStyle] = {
    "elevation": LayerStyle("Elevation", "m", "viridis"),
    "std": LayerStyle("Standard deviation of the elevation", "m", "magma", from_zero=True),
    "gradient": LayerStyle("Gradient (steepness)", "m/m", "ember", from_zero=True),
    "slope_x": LayerStyle("Slope along x, dz/dx", "m/m", "blue-white-red", symmetric=True),
    "slope_y": LayerStyle("Slope along y, dz/dy", "m/m", "blue-white-red", symmetric=True),
    "mask": LayerStyle(
        "Variance mask: standard deviation / signal", "share", "cividis", from_zero=True
    ),
    "difference": LayerStyle(
        "Height difference, query minus database", "m", "blue-white-red", symmetric=True
    ),
    "agreement": LayerStyle(
        "Agreement on one terrain",
        "log ratio",
        "red-white-blue",
        symmetric=True,
    ),
}


@dataclass(frozen=True)
class Scale:
    """What the colours mean; the legend prints it."""

    label: str
    unit: str
    color_map: ColorMap
    low: float
    high: float
    tints: tuple[Rgb, ...] = ()  # hues that the colours are given, one for each map

    @property
    def bars(self) -> UInt8[NDArray[np.uint8], "bars 256 3"]:
        """Colours from low to high; one row for each tint, or the only one."""
        table = lookup_table(self.color_map)
        return np.stack([tinted(table, tint) for tint in self.tints] or [table])


@dataclass(frozen=True)
class Relief:
    """How ground is lit, so that its shape is seen on gentle and on steep slopes alike.

    Attributes:
        lean: Slope along the scene's x and y that is lit as if it were level [m/m].
        times: How many times steeper the ground is lit than it is.
    """

    lean: tuple[float, float] = (0.0, 0.0)
    times: float = 1.0


IDENTITY = Relief()


def layer_values(
    gradient_map: GradientMap, layer: Layer, level: HeightFrame = OWN_LEVEL
) -> Float[Array, "rows columns"]:
    """Give the field that a layer shows, in the unit of its style and in the frame of a level.

    One map alone has none of the layers that compare two (`compare`): those are NaN.
    """
    match layer:
        case "elevation":
            return _levelled(gradient_map, level)
        case "std":
            return gradient_map.std
        case "gradient" | "slope_x" | "slope_y":
            return _slope_layer(gradient_map, layer, level)
        case "mask":
            return gradient_map.std / gradient_map.signal_std
        case "difference" | "agreement":
            return np.full(gradient_map.grid.shape, np.nan)


def _levelled(gradient_map: GradientMap, level: HeightFrame) -> Float[Array, "rows columns"]:
    """Give the elevation [m] in the frame of a level."""
    grid = gradient_map.grid
    if level.tilt == OWN_LEVEL.tilt:
        return gradient_map.elevation + level.height if level.height else gradient_map.elevation
    return gradient_map.elevation + level.height_at(grid.x[None, :], grid.y[:, None])


def _slope_layer(
    gradient_map: GradientMap, layer: Layer, level: HeightFrame
) -> Float[Array, "rows columns"]:
    """Give steepness, or the slope along x or y [m/m], in the frame of a level."""
    if layer == "gradient" and level.tilt == OWN_LEVEL.tilt:
        return gradient_map.gradient
    slope = gradient_map.slope
    x, y = slope[..., 0] + level.tilt[0], slope[..., 1] + level.tilt[1]
    if layer == "gradient":
        return np.sqrt(x * x + y * y)
    c, s = np.cos(level.yaw), np.sin(level.yaw)
    return c * x - s * y if layer == "slope_x" else s * x + c * y


def relief_of(
    maps: tuple[GradientMap, ...], levels: tuple[HeightFrame, ...], max_std_ratio: float
) -> Relief:
    """Choose one light for all maps: their mean slope is lit as level, and gentle shapes steeper.

    A slope that faces away from the light would be dark all over, and gentle ground lit all alike.
    How steep the ground is, the colours say.
    """
    samples: list[NDArray[np.floating]] = []
    for gradient_map, level in zip(maps, levels, strict=True):
        stride = max(1, int(np.sqrt(gradient_map.grid.num_cells / MAX_LIT)))
        slope = gradient_map.slope[::stride, ::stride]
        known = gradient_map.trusted(max_std_ratio, stride)
        known &= np.isfinite(slope).all(axis=-1)
        samples.append(SE2(yaw=level.yaw).rotate(slope[known] + np.array(level.tilt)))
    return light_slopes(np.concatenate(samples))


def light_slopes(slopes: Float[NDArray[np.floating], "n 2"]) -> Relief:
    """Choose the light for ground of such slopes along the scene's x and y [m/m]."""
    if not len(slopes):
        return IDENTITY
    lean = np.median(slopes, axis=0)
    steep = float(np.percentile(np.hypot(*(slopes - lean).T), 95))
    times = float(np.clip(STEEP / max(steep, 1e-9), 1.0, MOST_RELIEF))
    return Relief((float(lean[0]), float(lean[1])), times)


def shared_scale(
    maps: tuple[GradientMap, ...],
    layer: Layer,
    color_map: ColorMap,
    max_std_ratio: float,
    levels: tuple[HeightFrame, ...],
    fields: tuple[Float[NDArray[np.floating], "_rows _columns"], ...] | None = None,
) -> Scale:
    """Choose one range for all maps, so that the same colour means the same in each.

    The ends leave out the outermost hundredth at either side, where a single stone or a badly
    seen cell would take half of the colours.

    Args:
        maps: What will be shown together.
        layer: Field to show.
        color_map: Colours, or "automatic" for the layer's own.
        max_std_ratio: The variance mask: only trusted cells count.
        levels: The frame in which each map's values are told.
        fields: What each map shows, where it is not the layer of that map alone; NaN is nothing.
    """
    style = STYLES[layer]
    chosen = style.color_map if color_map == "automatic" else color_map
    if layer == "mask":
        # Fixed ends: the threshold's place on the bar is what the user sets.
        return Scale(style.label, style.unit, chosen, 0.0, 1.0)
    samples: list[NDArray[np.floating]] = []
    shown = fields or tuple(
        layer_values(gradient_map, layer, level)
        for gradient_map, level in zip(maps, levels, strict=True)
    )
    for gradient_map, field in zip(maps, shown, strict=True):
        stride = max(1, int(np.sqrt(gradient_map.grid.num_cells / MAX_SAMPLES)))
        values = field[::stride, ::stride]
        trusted = gradient_map.trusted(max_std_ratio, stride)
        samples.append(values[trusted] if trusted.any() else values.ravel())
    pooled = np.concatenate(samples)
    pooled = pooled[np.isfinite(pooled)]
    ends = np.percentile(pooled, (1, 99)) if len(pooled) else (0.0, 1.0)
    low, high = (float(end) for end in ends)
    if style.symmetric:
        high = max(abs(low), abs(high))
        low = -high
    elif style.from_zero:
        low = 0.0
    return Scale(style.label, style.unit, chosen, low, high)


def pixel_motion(T_target_source: SE2, source: Grid, target: Grid) -> Float[Array, "2 3"]:
    """Turn a motion in metres into one from (column, row) of a grid to that of another."""
    turn = T_target_source.rotation
    shift = T_target_source.apply(np.array([source.origin]))[0] - np.asarray(target.origin)
    scale = source.resolution / target.resolution
    return np.column_stack([scale * turn, shift / target.resolution])


def resample(
    values: Values, grid: Grid, onto: Grid, T_grid_onto: SE2, *, beyond: float = np.nan
) -> Values:
    """Interpolate a field at the cells of another grid.

    Args:
        values: On ``grid``; what lies next to a cell that is NaN, or to the rim, becomes NaN.
        grid: Of the values.
        onto: Whose cells are wanted.
        T_grid_onto: Maps the frame of ``onto`` into that of ``grid``.
        beyond: What stands beyond the rim of ``grid``.
    """
    rows, columns = onto.shape
    moved = cv2.warpAffine(
        values,
        pixel_motion(T_grid_onto, onto, grid),
        (columns, rows),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=beyond,
    )
    return np.asarray(moved, dtype=np.float32)


def compare(
    layer: Layer,
    maps: tuple[GradientMap, GradientMap],
    T_database_query: SE2,
    z_offset: float,
    max_std_ratio: float,
) -> tuple[Values, Values]:
    """Compare two registered maps: by the height of the query above the database, or by evidence.

    Args:
        layer: One of `state.COMPARED`.
        maps: Of (query, database).
        T_database_query: The registration.
        z_offset: What is to be added to the query's heights [m].
        max_std_ratio: The variance mask.

    Returns:
        The same values twice: at the query's cells and at the database's. NaN where not both maps
        are trusted.
    """
    query_map, database_map = maps
    if layer == "agreement":
        grid, shown = map_agreement(query_map, database_map, T_database_query, max_std_ratio)
        return (
            resample(shown, grid, query_map.grid, T_database_query),
            resample(shown, grid, database_map.grid, SE2()),
        )
    query, database = (
        np.where(a_map.trusted(max_std_ratio), a_map.elevation, np.nan).astype(np.float32)
        for a_map in maps
    )
    query += np.float32(z_offset)
    grids = query_map.grid, database_map.grid
    at_query = query - resample(database, grids[1], grids[0], T_database_query)
    at_database = resample(query, grids[0], grids[1], T_database_query.inverse()) - database
    return at_query, at_database


def compared_cells(grid: Grid, placement: Placement, role: Role, swipe_at: float) -> Cells:
    """Say which cells of a registered map a swipe leaves to be seen.

    It stands at a place along the scene's x [m]: the query is seen left of it, the database right.
    """
    c, s = np.cos(placement.yaw), np.sin(placement.yaw)
    right = (c * grid.x)[None, :] - (s * grid.y)[:, None] + placement.x > swipe_at
    return right if role == "database" else ~right


@dataclass(frozen=True, eq=False)
class Surfels:
    """Squares that face the camera, about the submap's centre."""

    positions: Float[NDArray[np.float32], "n 3"]  # [m]
    colors: UInt8[NDArray[np.uint8], "n 3"]
    size: float  # side of a square [m]


def stride_for(num_cells: int, max_surfels: int) -> int:
    """Give the step in rows and columns that draws at most so many surfels."""
    return max(1, int(np.ceil(np.sqrt(num_cells / max_surfels))))


def make_surfels(
    gradient_map: GradientMap,
    scale: Scale,
    *,
    layer: Layer,
    max_std_ratio: float,
    untrusted: Untrusted = "hidden",
    hillshaded: bool = True,
    level: HeightFrame = OWN_LEVEL,
    relief: Relief = IDENTITY,
    stride: int = 1,
    tint: Rgb | None = None,
    hue: Rgb | None = None,
    values: Float[NDArray[np.floating], "rows columns"] | None = None,
    seen: Bool[NDArray[np.bool_], "rows columns"] | None = None,
    centre: Float[Array, "3"] = ORIGIN,
) -> Surfels:
    """Turn a gradient map into coloured squares.

    Args:
        gradient_map: What to draw.
        scale: What the colours mean.
        layer: Field that gives the colours; the height is always the elevation.
        max_std_ratio: The variance mask.
        untrusted: What becomes of cells that the mask rejects.
        hillshaded: Light the layers in `SHADED_LAYERS`.
        level: The frame in which the values are told, and the ground is lit.
        relief: How the ground is lit.
        stride: Draw every so many rows and columns.
        tint: One colour for all, in place of the layer's.
        hue: The hue that the layer's colours are given, to tell this map from another.
        values: What gives the colours, where it is not the layer of this map alone; NaN is grey.
        seen: Cells to draw at most; None for all.
        centre: What their positions are relative to, in the submap's frame [m].
    """
    grid = gradient_map.grid
    cells = (slice(None, None, stride), slice(None, None, stride))
    elevation = gradient_map.elevation[cells]
    trusted = gradient_map.trusted(max_std_ratio, stride)
    # Where nothing was seen for kilometres numbers may overflow; the browser must not see them.
    drawn = np.isfinite(elevation)
    if untrusted == "hidden":
        drawn &= trusted
    if seen is not None:
        drawn &= seen[cells]
    # Few and short passes over the cells: this is all that a mask or a colour costs.
    kept = np.flatnonzero(drawn)
    positions = np.empty((*elevation.shape, 3), dtype=np.float32)
    positions[..., 0] = grid.x[::stride] - centre[0]
    positions[..., 1] = grid.y[::stride, None] - centre[1]
    positions[..., 2] = elevation - centre[2]
    if tint is None:
        field = layer_values(gradient_map, layer, level) if values is None else values
        shown = field[cells].ravel().take(kept)
        unknown = np.isnan(shown)
        if unknown.any():
            shown[unknown] = 0.0
        colors = colorize(shown, scale.low, scale.high, scale.color_map)
        if unknown.any():
            colors[unknown] = UNTRUSTED_GREY
        if hue is not None:
            colors = tinted(colors, hue)
    else:
        colors = np.tile(np.array(tint, dtype=np.uint8), (len(kept), 1))
    if untrusted == "grey":
        colors[~trusted.ravel().take(kept)] = UNTRUSTED_GREY
    if hillshaded and (tint is not None or layer in SHADED_LAYERS):
        slope = gradient_map.slope[cells].reshape(-1, 2).take(kept, axis=0).astype(np.float32)
        lean = SE2(yaw=-level.yaw).rotate(np.array([relief.lean]))[0] - level.tilt
        slope -= lean.astype(np.float32)
        slope *= np.float32(relief.times)
        colors = shade(colors, hillshade(slope, level.yaw))
    return Surfels(
        positions.reshape(-1, 3).take(kept, axis=0), colors, OVERLAP * stride * grid.resolution
    )
