"""Draws a scene without a browser: surfaces as squares, then marks and lines of chosen widths.

A pixel shows the nearest square over it. Squares of one size are splat by a trick: each pixel gets
the rank of the nearest centre in it, and the largest rank around is what a square of that size
would have painted there.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from app.viewer.scene.cameras import place_on_screen
from app.viewer.scene.placement import Canvas
from app.viewer.session.state import Camera
from gpgrad_core.arrays import NDArray

SHARPER = 2
"""Squares are drawn so much finer than requested: their edges are smooth."""
LARGEST_FINE = 2000
"""Pixels along a side of a picture that is drawn so."""
BITS = 4
"""Of fractions of a pixel at which lines begin and end."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Coloured squares that face the camera."""

    points: Float[NDArray[np.float64], "n 3"]  # in the scene [m]
    colors: UInt8[NDArray[np.uint8], "n 3"]
    size: float  # [m]


@dataclass(frozen=True, eq=False)
class Strokes:
    """Lines of one colour; a line without length is a disc."""

    ends: Float[NDArray[np.floating], "n 2 3"]  # in the scene [m]
    color: tuple[int, int, int]
    width: float  # [pixels of the page]


@dataclass(frozen=True, eq=False)
class Drawing:
    """What is drawn: lines below the ground, the ground, and lines on it."""

    under: tuple[Strokes, ...]
    clouds: tuple[Cloud, ...]
    over: tuple[Strokes, ...] = ()

    @cached_property
    def colors(self) -> UInt8[NDArray[np.uint8], "n 3"]:
        return np.concatenate([cloud.colors for cloud in self.clouds])


def rasterise(
    drawing: Drawing, camera: Camera, canvas: Canvas, ground: tuple[int, int, int], times: float = 1
) -> UInt8[NDArray[np.uint8], "rows columns 3"]:
    """Draw what a camera sees on a canvas of so many pixels; lines are so many times as wide."""
    rows, columns = round(canvas.height), round(canvas.width)
    picture = np.full((rows, columns, 3), ground, np.uint8)
    _stroke(picture, drawing.under, camera, canvas, times)
    finer = SHARPER if max(rows, columns) <= LARGEST_FINE else 1
    large = replace(canvas, width=columns * finer, height=rows * finer)
    ranks, order = _splat(drawing.clouds, camera, large)
    if len(order):
        palette = np.zeros((len(order) + 1, 4), np.uint8)  # what shows nothing lets all through
        palette[1:, :3], palette[1:, 3] = drawing.colors[order], 255
        packed = palette.view(np.uint32).ravel().take(ranks + 1)
        painted = packed.view(np.uint8).reshape(*ranks.shape, 4)
        if finer > 1:
            painted = cv2.resize(painted, (columns, rows), interpolation=cv2.INTER_AREA)
        through = 1.0 - painted[..., 3:].astype(np.float32) / 255.0
        picture = (picture * through + painted[..., :3] + 0.5).clip(0, 255).astype(np.uint8)
    _stroke(picture, drawing.over, camera, canvas, times)
    return picture


def _splat(
    clouds: tuple[Cloud, ...], camera: Camera, canvas: Canvas
) -> tuple[NDArray[np.int32], NDArray[np.intp]]:
    """Which square each pixel shows, counted from the farthest, or -1; and their order."""
    rows, columns = int(canvas.height), int(canvas.width)
    forward = camera.sight / max(camera.distance, 1e-9)
    depths = [(cloud.points - np.array(camera.position)) @ forward for cloud in clouds]
    order = np.argsort(-np.concatenate(depths, dtype=np.float32)) if clouds else np.zeros(0, int)
    rank = np.empty(len(order), np.float32)
    rank[order] = np.arange(len(order), dtype=np.float32)
    found = np.full((rows, columns), -1.0, np.float32)
    start = 0
    for cloud, depth in zip(clouds, depths, strict=True):
        own = rank[start : start + len(depth)]
        start += len(depth)
        spots = np.nan_to_num(place_on_screen(camera, canvas, cloud.points), nan=-1.0)
        x, y = np.floor(np.clip(spots, -1.0, 1e6)).astype(np.intp).T
        inside = np.flatnonzero((x >= 0) & (x < columns) & (y >= 0) & (y < rows))
        if not len(inside):
            continue
        inside = inside[np.argsort(own[inside])]  # what is nearer is written later, and stays
        layer = np.full((rows, columns), -1.0, np.float32)
        layer[y[inside], x[inside]] = own[inside]
        side = canvas.focal_length(camera) * cloud.size / float(np.median(depth[inside]))
        square = np.ones((max(1, round(side)),) * 2, np.uint8)
        found = np.maximum(found, cv2.dilate(layer, square, borderValue=-1.0))
    return found.astype(np.int32), order


def _stroke(
    picture: NDArray[np.uint8],
    strokes: tuple[Strokes, ...],
    camera: Camera,
    canvas: Canvas,
    times: float,
) -> None:
    for some in strokes:
        ends = some.ends.reshape(-1, 3).astype(np.float64)
        spots = place_on_screen(camera, canvas, ends).reshape(-1, 2, 2)
        spots = spots[np.isfinite(spots).all(axis=(1, 2))]
        spots = np.clip(spots, -1e5, 1e5) * 2**BITS
        width = some.width * times
        for start, end in spots.round().astype(int).tolist():
            if start == end:
                radius = round(width / 2 * 2**BITS)
                cv2.circle(picture, start, radius, some.color, -1, cv2.LINE_AA, BITS)
            else:
                thick = max(1, round(width))
                cv2.line(picture, start, end, some.color, thick, cv2.LINE_AA, BITS)
