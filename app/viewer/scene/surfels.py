"""Gradient map -> coloured surfels: one small square per cell, which browsers update fast.

A mesh would need its faces rebuilt whenever the variance mask moves; surfels only become fewer.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from app.viewer.scene.colors import UNTRUSTED_GREY, Rgb, colorize, hillshade, shade
from app.viewer.scene.layers import Scale, layer_values
from app.viewer.session.state import Layer, Untrusted
from gpgrad_core.arrays import NDArray
from gpgrad_core.types import GradientMap

OVERLAP = 1.6
"""Side of a surfel in cells: seen aslant, neighbours must still touch."""

SHADED_LAYERS: tuple[Layer, ...] = ("elevation",)


@dataclass(frozen=True, eq=False)
class Surfels:
    """Squares that face the camera, in the submap's frame."""

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
    yaw: float = 0.0,
    offset: float = 0.0,
    stride: int = 1,
    tint: Rgb | None = None,
    values: Float[NDArray[np.floating], "rows columns"] | None = None,
    seen: Bool[NDArray[np.bool_], "rows columns"] | None = None,
) -> Surfels:
    """Turn a gradient map into coloured squares.

    Args:
        gradient_map: What to draw.
        scale: What the colours mean.
        layer: Field that gives the colours; the height is always the elevation.
        max_std_ratio: The variance mask.
        untrusted: What becomes of cells that the mask rejects.
        hillshaded: Light the layers in `SHADED_LAYERS`.
        yaw: Of the map in the scene [rad], for the light.
        offset: Added to the values before they are coloured.
        stride: Draw every so many rows and columns.
        tint: One colour for all, in place of the layer's.
        values: What gives the colours, where it is not the layer of this map alone; NaN is grey.
        seen: Cells to draw at most; None for all.
    """
    grid = gradient_map.grid
    cells = (slice(None, None, stride), slice(None, None, stride))
    elevation = gradient_map.elevation[cells]
    trusted = gradient_map.trusted(max_std_ratio)[cells]
    # Where nothing was seen for kilometres numbers may overflow; the browser must not see them.
    drawn = np.isfinite(elevation)
    if untrusted == "hidden":
        drawn &= trusted
    if seen is not None:
        drawn &= seen[cells]
    # Few and short passes over the cells: this is all that a mask or a colour costs.
    kept = np.flatnonzero(drawn)
    positions = np.empty((*elevation.shape, 3), dtype=np.float32)
    positions[..., 0] = grid.x[::stride]
    positions[..., 1] = grid.y[::stride, None]
    positions[..., 2] = elevation
    if tint is None:
        field = layer_values(gradient_map, layer) if values is None else values
        shown = field[cells].ravel().take(kept)
        unknown = np.isnan(shown)
        if unknown.any():
            shown[unknown] = 0.0
        colors = colorize(shown + offset, scale.low, scale.high, scale.color_map)
        if unknown.any():
            colors[unknown] = UNTRUSTED_GREY
    else:
        colors = np.tile(np.array(tint, dtype=np.uint8), (len(kept), 1))
    if untrusted == "grey":
        colors[~trusted.ravel().take(kept)] = UNTRUSTED_GREY
    if hillshaded and (tint is not None or layer in SHADED_LAYERS):
        slope = gradient_map.slope[cells].reshape(-1, 2).astype(np.float32).take(kept, axis=0)
        colors = shade(colors, hillshade(slope, yaw))
    return Surfels(
        positions.reshape(-1, 3).take(kept, axis=0), colors, OVERLAP * stride * grid.resolution
    )
