"""The layers of a gradient map: what each shows, in which unit, and between which ends."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from app.viewer.session.state import ColorMap, Layer
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.types import GradientMap

MAX_SAMPLES = 20_000
"""Enough cells to tell a range by."""


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
    "gradient": LayerStyle("Gradient (steepness)", "m/m", "magma", from_zero=True),
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
NO_RANGE = (0.0, 1.0)
"""Ends of the colours where no cell has a value."""


@dataclass(frozen=True)
class Scale:
    """What the colours mean; the legend prints it."""

    label: str
    unit: str
    color_map: ColorMap
    low: float
    high: float


def layer_values(gradient_map: GradientMap, layer: Layer) -> Float[Array, "rows columns"]:
    """Give the field that a layer shows, in the unit of its style.

    One map alone has none of the layers that compare two (`comparison.compare`): those are NaN.
    """
    match layer:
        case "elevation":
            return gradient_map.elevation
        case "std":
            return gradient_map.std
        case "gradient":
            return gradient_map.gradient
        case "slope_x" | "slope_y":
            return gradient_map.slope[..., 0 if layer == "slope_x" else 1]
        case "mask":
            return gradient_map.std / gradient_map.signal_std
        case "difference" | "agreement":
            return np.full(gradient_map.grid.shape, np.nan)


def shared_scale(
    maps: tuple[GradientMap, ...],
    layer: Layer,
    color_map: ColorMap,
    max_std_ratio: float,
    offsets: tuple[float, ...],
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
        offsets: Added to each map's values first, as its height in the scene asks.
        fields: What each map shows, where it is not the layer of that map alone; NaN is nothing.
    """
    style = STYLES[layer]
    chosen = style.color_map if color_map == "automatic" else color_map
    if layer == "mask":
        # Fixed ends: the threshold's place on the bar is what the user sets.
        return Scale(style.label, style.unit, chosen, 0.0, 1.0)
    samples: list[NDArray[np.floating]] = []
    shown = fields or tuple(layer_values(gradient_map, layer) for gradient_map in maps)
    for gradient_map, field, offset in zip(maps, shown, offsets, strict=True):
        stride = max(1, int(np.sqrt(gradient_map.grid.num_cells / MAX_SAMPLES)))
        values = field[::stride, ::stride]
        trusted = gradient_map.trusted(max_std_ratio)[::stride, ::stride]
        samples.append((values[trusted] if trusted.any() else values.ravel()) + offset)
    pooled = np.concatenate(samples)
    pooled = pooled[np.isfinite(pooled)]
    ends = np.percentile(pooled, (1, 99)) if len(pooled) else NO_RANGE
    low, high = (float(end) for end in ends)
    if style.symmetric:
        high = max(abs(low), abs(high))
        low = -high
    elif style.from_zero:
        low = 0.0
    return Scale(style.label, style.unit, chosen, low, high)
