"""Where a line of sight meets a surface, so that a click finds a place on the ground."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from app.viewer.scene.placement import Placement
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap

Drawn: TypeAlias = Bool[NDArray[np.bool_], "rows columns"]

STEPS_PER_CELL = 2.0
"""Samples of the line of sight: a ridge narrower than half a cell is not in the map either."""
MAX_STEPS = 40_000
NEAR_RIM = 0.8
"""How far beyond the centres of the outermost cells their squares still reach [cells]."""


@dataclass(frozen=True, eq=False)
class Ray:
    """A line of sight in the scene, z up."""

    origin: Float[Array, "3"]  # [m]
    direction: Float[Array, "3"]  # of any length but zero

    def into(self, placement: Placement) -> "Ray":
        """Transform the line into the frame of a submap that stands there."""
        T_scene_submap = SE2(placement.x, placement.y, placement.yaw)
        T_submap_scene = T_scene_submap.inverse()
        xy = T_submap_scene.apply(self.origin[None, :2])[0]
        along = T_submap_scene.rotate(self.direction[None, :2])[0]
        return Ray(np.append(xy, self.origin[2] - placement.z), np.append(along, self.direction[2]))


@dataclass(frozen=True)
class Hit:
    """Where a line of sight first meets a surface."""

    distance: float  # from the eye, in lengths of the ray's direction
    x: float  # [m], submap frame
    y: float


def first_hit(
    ray: Ray, gradient_map: GradientMap, placement: Placement, drawn: Drawn
) -> Hit | None:
    """Find where a line of sight first meets the drawn cells of a map.

    Args:
        ray: In the scene.
        gradient_map: Whose elevation is the surface.
        placement: Where the map stands in the scene.
        drawn: Cells that can be seen; the line passes through the others.

    Returns:
        None where it meets none.
    """
    if not drawn.any():
        return None
    local = ray.into(placement)
    span = _within(local, _box(gradient_map, drawn))
    if span is None:
        return None
    length = float(np.linalg.norm(local.direction)) * (span[1] - span[0])
    count = int(np.ceil(STEPS_PER_CELL * length / gradient_map.grid.resolution)) + 2
    distances = np.linspace(*span, min(count, MAX_STEPS))
    points = local.origin + distances[:, None] * local.direction
    pixels = gradient_map.grid.to_pixel(points[:, :2])
    above = points[:, 2] - height_at(gradient_map, pixels)
    nearest = np.rint(pixels).astype(np.intp)
    rows, columns = drawn.shape
    row, column = nearest[:, 1].clip(0, rows - 1), nearest[:, 0].clip(0, columns - 1)
    crossed = (above[:-1] > 0) != (above[1:] > 0)
    met = np.flatnonzero(crossed & drawn[row, column][1:])
    if len(met) == 0:
        return None
    k = int(met[0])
    share = above[k] / (above[k] - above[k + 1])
    distance = float(distances[k] + share * (distances[k + 1] - distances[k]))
    x, y, _ = local.origin + distance * local.direction
    return Hit(distance, float(x), float(y))


def height_at(gradient_map: GradientMap, pixels: Float[Array, "n 2"]) -> Float[Array, "n"]:
    """Read the elevation [m] between cells, at fractional (column, row)."""
    return sample(gradient_map.elevation, pixels)


def sample(values: Float[Array, "rows columns"], pixels: Float[Array, "n 2"]) -> Float[Array, "n"]:
    """Read a field between cells, at fractional (column, row); beyond its rim, as at the rim."""
    return ndimage.map_coordinates(values, pixels.T[::-1], order=1, mode="nearest")


def _box(gradient_map: GradientMap, drawn: Drawn) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Give the corners of the box round all drawn cells [m]."""
    heights = gradient_map.elevation[drawn]
    rim = NEAR_RIM * gradient_map.grid.resolution
    low_x, low_y = gradient_map.grid.x[0] - rim, gradient_map.grid.y[0] - rim
    high_x, high_y = gradient_map.grid.x[-1] + rim, gradient_map.grid.y[-1] + rim
    margin = max(1e-6, rim)  # level ground is a box, too
    return (
        np.array([low_x, low_y, heights.min() - margin]),
        np.array([high_x, high_y, heights.max() + margin]),
    )


def _within(
    ray: Ray, box: tuple[Float[Array, "3"], Float[Array, "3"]]
) -> tuple[float, float] | None:
    """Give the stretch of a line, from its eye on, that lies in a box: the slab method."""
    with np.errstate(divide="ignore", invalid="ignore"):
        to_low, to_high = ((corner - ray.origin) / ray.direction for corner in box)
    # A line along a slab's face gives 0/0: it is inside that slab.
    near = np.fmin(to_low, to_high)
    far = np.fmax(to_low, to_high)
    enters, leaves = float(np.nanmax(near, initial=0.0)), float(np.nanmin(far, initial=np.inf))
    return (enters, leaves) if enters < leaves and np.isfinite(leaves) else None
