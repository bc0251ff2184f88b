"""How layers of gradient maps are coloured and lit, and drawn as surfels.

A surfel is a small square for a cell, which browsers update fast. A mesh would need its faces
rebuilt whenever the variance mask moves; surfels only become fewer.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias
from weakref import WeakKeyDictionary

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from app.viewer.scene.colors import (
    UNTRUSTED_GREY,
    Rgb,
    colorize,
    faded,
    hillshade,
    lookup_table,
    shade,
    tinted,
)
from app.viewer.session.layers import (
    LAYERS,
    OWN_LEVEL,
    ColorMap,
    HeightFrame,
    Layer,
    LayerStyle,
    Values,
    resample,
)
from app.viewer.session.state import Untrusted
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.se2 import SE2
from gpgrad_core.types import MAX_STD_RATIO, GradientMap

Cells: TypeAlias = Bool[NDArray[np.bool_], "_rows _columns"]

MAX_SAMPLES = 20_000
"""Enough cells to tell a range by."""
ENDS = (1.0, 99.0)
"""Percentiles at the ends of a range."""
ROUND_ENDS = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Ends of ranges that begin at zero, but for a power of ten."""
RIM = 1.0
"""Width of the rim of trusted ground that makes no range, for slopes run off there [length-scales].
"""
NUM_BINS = 50
"""Of a histogram of what is shown."""
OVERLAP = 1.6
"""Side of a surfel in cells: from aslant, neighbours must still touch."""
HOLLOWS = ((1.0, 0.16), (4.0, 0.14))
"""How far about a cell ground is looked at [length-scales], and how much lighter a crest is there
than level ground, and how much darker a hollow."""
EDGE = (0.5, 0.68, 0.84)
"""How bright the outermost cells of a surface are, from its edge inwards."""
ORIGIN = np.zeros(3)
PALE = 0.85
"""Brightness of the white of no difference, so that its relief is visible."""
MAX_LIT = 2_000
"""Enough cells to tell by how ground is to be lit."""
STEEP, MOST_RELIEF = 0.5, 6.0
"""Slope as which the steepest twentieth of the ground is lit at least [m/m], and how many times
steeper than it is any ground is lit at most."""


@dataclass(frozen=True)
class Scale:
    """What the colours mean; the legend prints it."""

    label: str
    unit: str
    color_map: ColorMap
    low: float
    high: float
    tints: tuple[Rgb, ...] = ()  # hues of the colours, one for each map

    @property
    def bars(self) -> UInt8[NDArray[np.uint8], "bars 256 3"]:
        table = lookup_table(self.color_map)
        return np.stack([tinted(table, tint) for tint in self.tints] or [table])


@dataclass(frozen=True)
class Relief:
    """Light on the ground, which shows its shape on gentle and on steep slopes alike."""

    lean: tuple[float, float] = (0.0, 0.0)  # slope in the scene that is lit as level ground [m/m]
    times: float = 1.0  # how many times steeper the ground is lit than it is


def light_slopes(slopes: Float[NDArray[np.floating], "n 2"]) -> Relief:
    """Choose the light for ground of such slopes along the scene's x and y [m/m]."""
    if not len(slopes):
        return Relief()
    lean = np.median(slopes, axis=0)
    steep = float(np.percentile(np.hypot(*(slopes - lean).T), 95))
    times = float(np.clip(STEEP / max(steep, 1e-9), 1.0, MOST_RELIEF))
    return Relief((float(lean[0]), float(lean[1])), times)


def explained(
    maps: tuple[GradientMap, GradientMap], T_database_query: SE2
) -> tuple[Values, Values]:
    """One standard deviation of the height difference at the cells of both maps [m]."""
    (query, database), inverse = maps, T_database_query.inverse()
    stds = [a_map.std.astype(np.float32) for a_map in maps]
    at_query = resample(stds[1], database.grid, query.grid, T_database_query)
    at_database = resample(stds[0], query.grid, database.grid, inverse)
    return np.hypot(stds[0], at_query), np.hypot(at_database, stds[1])


@dataclass(frozen=True, eq=False)
class Histogram:
    """Cells by value, from the low end of the colours to the high one."""

    # cells that the mask lets pass; those beyond the ends count in the end bins, as they take the
    # end colours
    trusted: Float[NDArray[np.float64], "bins"]
    masked: Float[NDArray[np.float64], "bins"]  # cells that it rejects, within the ends only
    num_masked: int  # all cells that it rejects

    @property
    def num_trusted(self) -> int:
        return int(self.trusted.sum())


@dataclass(frozen=True)
class Paint:
    """What colours maps that are shown together, and how they are lit; equal ones look alike."""

    maps: tuple[GradientMap, ...]  # of a pair (query, database)
    layer: Layer
    max_std_ratio: float  # the variance mask: only trusted cells count
    color_map: ColorMap = "automatic"
    levels: tuple[HeightFrame, ...] = ()  # frames of each map's values; without any, their own
    motion: SE2 | None = None  # ``T_database_query``; None compares nothing
    z_offset: float = 0.0  # what is added to the query's heights to compare them [m]
    ends: tuple[float, float] | None = None  # of the range; None takes what suits the values
    beyond: float = 0.0  # so many standard deviations of a difference are drawn as none

    @property
    def style(self) -> LayerStyle:
        return LAYERS[self.layer]

    @property
    def levelled(self) -> tuple[tuple[GradientMap, HeightFrame], ...]:
        return tuple(zip(self.maps, self.levels or [OWN_LEVEL] * len(self.maps), strict=True))

    @cached_property
    def fields(self) -> tuple[Float[NDArray[np.floating], "_rows _columns"], ...]:
        """What the layer shows of each map; NaN is nothing."""
        if self.motion is not None and self.beyond:
            whole = zip(self._whole.fields, explained(self._both, self.motion), strict=True)
            return tuple(
                np.sign(field) * np.maximum(np.abs(field) - self.beyond * std, 0.0)
                for field, std in whole
            )
        if self.motion is not None:
            compare = self.style.compare
            assert compare is not None
            return compare(self._both, self.motion, self.z_offset, self.max_std_ratio)
        return tuple(self.style.of_map(a_map, level) for a_map, level in self.levelled)

    @property
    def _both(self) -> tuple[GradientMap, GradientMap]:
        query, database = self.maps
        return query, database

    @cached_property
    def _whole(self) -> "Paint":
        return replace(self, beyond=0.0)

    @cached_property
    def scale(self) -> Scale:
        """One range for all maps, so that the same colour means the same in each.

        The ends leave out the outermost values, where a single stone would take half of the
        colours, and the rim of the ground, whose slopes a slider of the mask lets in and out.
        """
        if self.beyond:
            scale = self._whole.scale
            return replace(scale, label=f"{scale.label}, beyond {self.beyond:g} std")
        style = self.style
        chosen = style.color_map if self.color_map == "automatic" else self.color_map
        if (ends := self.ends or style.ends) is not None:
            return Scale(style.label, style.unit, chosen, *ends)
        samples: list[NDArray[np.floating]] = []
        for gradient_map, field in zip(self.maps, self.fields, strict=True):
            stride = max(1, int(np.sqrt(gradient_map.grid.num_cells / MAX_SAMPLES)))
            values = field[::stride, ::stride]
            trusted = gradient_map.trusted(self.max_std_ratio, stride)
            if style.symmetric or style.from_zero:
                step = stride * gradient_map.grid.resolution
                inner = _inner(trusted, RIM * gradient_map.length_scale / step)
                trusted = inner if inner.any() else trusted
            samples.append(values[trusted] if trusted.any() else values.ravel())
        pooled = np.concatenate(samples)
        pooled = pooled[np.isfinite(pooled)]
        ends = np.percentile(pooled, ENDS) if len(pooled) else (0.0, 1.0)
        low, high = (float(end) for end in ends)
        if style.symmetric or style.from_zero:
            high = _round_up(max(abs(low), abs(high)))
            low = -high if style.symmetric else 0.0
        return Scale(style.label, style.unit, chosen, low, high)

    @cached_property
    def counted(self) -> Histogram:
        """Cells of all maps together by what the layer shows; NaN counts nowhere."""
        passed, rejected, num_masked = np.zeros(NUM_BINS), np.zeros(NUM_BINS), 0
        span = max(self.scale.high - self.scale.low, 1e-12)
        for gradient_map, values in zip(self.maps, self.fields, strict=True):
            finite, trusted = np.isfinite(values), gradient_map.trusted(self.max_std_ratio)
            places = (values - self.scale.low) * (NUM_BINS / span)
            inside = places[finite & trusted].clip(0, NUM_BINS - 1).astype(np.intp)
            passed += np.bincount(inside, minlength=NUM_BINS)
            outside = places[finite & ~trusted]
            num_masked += len(outside)
            outside = outside[(outside >= 0) & (outside < NUM_BINS)].astype(np.intp)
            rejected += np.bincount(outside, minlength=NUM_BINS)
        return Histogram(passed, rejected, num_masked)

    @cached_property
    def relief(self) -> Relief:
        """One light for all maps: their mean slope is lit as level, and gentle shapes steeper.

        A slope that faces away from the light would be dark all over, and gentle ground lit all
        alike. How steep the ground is, the colours say.
        """
        samples: list[NDArray[np.floating]] = []
        for gradient_map, level in self.levelled:
            stride = max(1, int(np.sqrt(gradient_map.grid.num_cells / MAX_LIT)))
            slope = gradient_map.slope[::stride, ::stride]
            # Not by what the slider of the mask leaves: each of its steps would change the light.
            known = gradient_map.trusted(MAX_STD_RATIO, stride)
            known &= np.isfinite(slope).all(axis=-1)
            samples.append(SE2(yaw=level.yaw).rotate(slope[known] + np.array(level.tilt)))
        return light_slopes(np.concatenate(samples))


def _inner(trusted: Cells, cells: float) -> Cells:
    """Remove trusted cells that are near to others."""
    side = 2 * max(1, round(cells)) + 1
    kernel = np.ones((side, side), np.uint8)
    edge = cv2.BORDER_CONSTANT
    return cv2.erode(trusted.astype(np.uint8), kernel, borderType=edge, borderValue=0) > 0


def _round_up(value: float) -> float:
    """The next of the round numbers that ranges end at."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-9)))
    share = next(end for end in ROUND_ENDS if end * power >= value * (1 - 1e-9))
    return float(f"{share * power:.6g}")


_shapes: WeakKeyDictionary[GradientMap, Values] = WeakKeyDictionary()


def shape_light(gradient_map: GradientMap) -> Values:
    """How much lighter crests are than level ground, and how much darker hollows: by their sky."""
    known = _shapes.get(gradient_map)
    if known is not None:
        return known
    elevation = np.nan_to_num(gradient_map.elevation.astype(np.float32), posinf=0.0, neginf=0.0)
    trusted = gradient_map.trusted(MAX_STD_RATIO)
    light = np.ones(elevation.shape, np.float32)
    for reach, most in HOLLOWS:
        cells = max(reach * gradient_map.length_scale / gradient_map.grid.resolution, 0.5)
        # A wide blur of a small picture costs little.
        every = max(1, int(cells / 4))
        small = cv2.resize(
            elevation, None, fx=1 / every, fy=1 / every, interpolation=cv2.INTER_AREA
        )
        small = cv2.GaussianBlur(small, (0, 0), cells / every)
        rows, columns = elevation.shape
        above = elevation - cv2.resize(small, (columns, rows), interpolation=cv2.INTER_LINEAR)
        some = np.abs(above[trusted][:: 1 + trusted.sum() // MAX_LIT])
        usual = float(np.percentile(some, 80)) if len(some) else 0.0
        light += most * np.tanh(above / max(usual, 1e-6))
    _shapes[gradient_map] = light
    return light


def _edge_light(drawn: Cells) -> Values:
    """Darken the edge of what is drawn, so that it stands out from a light and a dark page."""
    inside, light = drawn.astype(np.uint8), np.ones(drawn.shape, np.float32)
    square = np.ones((3, 3), np.uint8)
    for brightness in EDGE:
        smaller = cv2.erode(inside, square, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        light[inside != smaller] = brightness
        inside = smaller
    return light


@dataclass(frozen=True, eq=False)
class Surfels:
    """Squares that face the camera, about the submap's centre."""

    positions: Float[NDArray[np.float32], "n 3"]  # [m]
    colors: UInt8[NDArray[np.uint8], "n 3"]
    size: float  # side of a square [m]

    @property
    def properties(self) -> dict[str, Any]:
        return {"points": self.positions, "colors": self.colors, "point_size": self.size}


def stride_for(num_cells: int, max_surfels: int) -> int:
    """The step in rows and columns that draws at most so many surfels."""
    return max(1, int(np.ceil(np.sqrt(num_cells / max_surfels))))


def make_surfels(
    paint: Paint,
    index: int = 0,
    *,
    untrusted: Untrusted = "hidden",
    hillshaded: bool = True,
    stride: int = 1,
    hue: Rgb | None = None,
    seen: Cells | None = None,
    centre: Float[Array, "3"] = ORIGIN,
    exaggeration: float = 1.0,
    picked: tuple[float, float] | None = None,
) -> Surfels:
    """Turn a map of a paint into coloured squares, at the height of its elevation.

    Where the paint shows nothing, they are grey. Every so many rows and columns are drawn, and of
    them the cells that are ``seen``, or all. A hue marks this map. Values outside the picked ones
    are faint. Positions are relative to a centre in the submap's frame [m].
    """
    (gradient_map, level), scale = paint.levelled[index], paint.scale
    grid = gradient_map.grid
    cells = (slice(None, None, stride), slice(None, None, stride))
    elevation = gradient_map.elevation[cells]
    trusted = gradient_map.trusted(paint.max_std_ratio, stride)
    # Kilometres from all points numbers may overflow; the browser must not receive them.
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
    positions[..., 2] = exaggeration * (elevation - centre[2])
    shown = paint.fields[index][cells].ravel().take(kept)
    unknown = np.isnan(shown)
    if unknown.any():
        shown[unknown] = 0.0
    colors = colorize(shown, scale.low, scale.high, scale.color_map)
    if unknown.any():
        colors[unknown] = UNTRUSTED_GREY
    if hue is not None:
        colors = tinted(colors, hue)
    if untrusted == "grey":
        colors[~trusted.ravel().take(kept)] = UNTRUSTED_GREY
    if hillshaded and (paint.style.is_shaded or paint.beyond):
        slope = gradient_map.slope[cells].reshape(-1, 2).take(kept, axis=0).astype(np.float32)
        relief = paint.relief
        lean = SE2(yaw=-level.yaw).rotate(np.array([relief.lean]))[0] - level.tilt
        slope -= lean.astype(np.float32)
        slope *= np.float32(relief.times)
        bright = hillshade(slope, level.yaw) * (PALE if paint.beyond else 1.0)
        bright *= shape_light(gradient_map)[cells].ravel().take(kept)
        bright *= _edge_light(trusted).ravel().take(kept)
        colors = shade(colors, bright)
    if picked is not None:
        # Beyond a last bar lies what has its colour.
        low, high = (-np.inf if picked[0] <= scale.low else picked[0]), picked[1]
        others = (shown < low) | (shown > (np.inf if high >= scale.high else high))
        colors[others] = faded(colors[others])
    return Surfels(
        positions.reshape(-1, 3).take(kept, axis=0),
        colors,
        OVERLAP * exaggeration**0.5 * stride * grid.resolution,  # steeper, they lie farther apart
    )
