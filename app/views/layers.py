"""The layers of a gradient map: what each shows, in which unit, and between which ends."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from app.state import ColorMap, Layer
from gpgrad_core.types import GradientMap

Array = NDArray[np.float64]

MAX_SAMPLES = 20_000
"""Enough cells to tell a range by."""


@dataclass(frozen=True)
class LayerStyle:
    """How a layer is named and coloured unless the user chooses."""

    label: str
    unit: str
    color_map: ColorMap
    symmetric: bool = False  # ends at equal distance from zero
    from_zero: bool = False


STYLES: dict[Layer, LayerStyle] = {
    "elevation": LayerStyle("Elevation", "m", "viridis"),
    "std": LayerStyle("Standard deviation of the elevation", "m", "magma", from_zero=True),
    "gradient": LayerStyle("Gradient (steepness)", "m/m", "magma", from_zero=True),
    "slope_x": LayerStyle("Slope along x, dz/dx", "m/m", "blue-white-red", symmetric=True),
    "slope_y": LayerStyle("Slope along y, dz/dy", "m/m", "blue-white-red", symmetric=True),
    "mask": LayerStyle(
        "Variance mask: standard deviation / signal", "share", "cividis", from_zero=True
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


def layer_values(gradient_map: GradientMap, layer: Layer) -> Float[Array, "rows columns"]:
    """Give the field that a layer shows, in the unit of its style."""
    match layer:
        case "elevation":
            return gradient_map.elevation
        case "std":
            return gradient_map.std
        case "gradient":
            return gradient_map.gradient
        case "slope_x":
            return gradient_map.slope[..., 0]
        case "slope_y":
            return gradient_map.slope[..., 1]
        case "mask":
            return gradient_map.std / gradient_map.signal_std


def shared_scale(
    maps: tuple[GradientMap, ...],
    layer: Layer,
    color_map: ColorMap,
    max_std_ratio: float,
    offsets: tuple[float, ...],
) -> Scale:
    """Choose one range for all maps, so that the same colour means the same in each.

    The ends leave out the outermost hundredth at either side, where a single stone or a badly
    seen cell would take half of the colours.

    Args:
        maps: What will be shown together.
        layer: Field to show.
        color_map: Colours, or "automatic" for the layer's own.
        max_std_ratio: The variance mask: only trusted cells count.
        offsets: Added to each map's values first, as its height in the scene asks.
    """
    style = STYLES[layer]
    chosen = style.color_map if color_map == "automatic" else color_map
    if layer == "mask":
        # Fixed ends: the threshold's place on the bar is what the user sets.
        return Scale(style.label, style.unit, chosen, 0.0, 1.0)
    samples: list[Array] = []
    for gradient_map, offset in zip(maps, offsets, strict=True):
        stride = max(1, int(np.sqrt(gradient_map.grid.num_cells / MAX_SAMPLES)))
        values = layer_values(gradient_map, layer)[::stride, ::stride]
        trusted = gradient_map.trusted(max_std_ratio)[::stride, ::stride]
        samples.append((values[trusted] if trusted.any() else values.ravel()) + offset)
    low, high = (float(end) for end in np.percentile(np.concatenate(samples), (1, 99)))
    if style.symmetric:
        high = max(abs(low), abs(high))
        low = -high
    elif style.from_zero:
        low = 0.0
    return Scale(style.label, style.unit, chosen, low, high)
