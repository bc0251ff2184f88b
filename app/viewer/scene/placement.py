"""Where the two submaps stand in the scene, and from where the camera sees both."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from math import atan, cos, hypot, sin, tan
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from app.viewer.session.layers import HeightFrame
from app.viewer.session.state import FIELD_OF_VIEW, PARALLEL, Camera, Layout
from gpgrad_core.arrays import Array
from gpgrad_core.registration.align import DRIFTED
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import GradientMap, Registration, Submap

Maps: TypeAlias = tuple[GradientMap, GradientMap]
"""Of (query, database)."""

GAP = 0.12
"""Room between submaps side by side, as a share of their width."""
BETWEEN = 0.22
"""Room between two pictures of a pair, as a share of the larger."""
ARC_HEIGHT = 0.12
"""How high a submap that glides into place goes, as a share of its width."""
MAX_OVERLAP_SAMPLES = 2_000
"""About as many cells of the query are compared with the database: a median needs no more."""
LEVEL_ROUNDS = 5
"""Of weighing what does not lie on the plane down."""
MIN_TILT, MAX_TILT = np.deg2rad(58.0), np.deg2rad(70.0)
"""How far the camera looks down."""
TALL = 0.85
"""Canvases whose width over height is less have the submaps one behind the other."""
SMALL, SMALL_MARKS = 480.0, 0.6
"""On canvases narrower than this [pixels] keypoints are marked by so much smaller, because their
marks would hide the ground."""
MARGINS = (24.0, 76.0, 24.0, 88.0)
"""Left, top, right and bottom of a canvas that stay free for names and scale [pixels]."""
MOST_MARGIN = 0.1
"""Of a canvas that any of these margins may take."""


@dataclass(frozen=True)
class Placement:
    """Pose of a submap's frame in the scene: tilted, turned about z, then moved.

    The tilt is how fast the submap's x and y rise in the scene [m/m]. The scene may be higher than
    the ground: then heights are exaggerated before all else.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    exaggeration: float = 1.0

    @property
    def position(self) -> tuple[float, float, float]:
        return self.x, self.y, self.z

    def at(self, position: Float[Array, "3"]) -> "Placement":
        x, y, z = position.tolist()
        return replace(self, x=x, y=y, z=z)

    @property
    def wxyz(self) -> tuple[float, float, float, float]:
        turn, tilt = self.yaw / 2, atan(hypot(*self.tilt)) / 2
        about_x, about_y = self._axis
        i, j = sin(tilt) * about_x, sin(tilt) * about_y
        c, s = cos(turn), sin(turn)
        return c * cos(tilt), c * i - s * j, c * j + s * i, s * cos(tilt)

    @property
    def _axis(self) -> tuple[float, float]:
        """Level unit vector that the tilt turns about, in the submap's frame."""
        steepness = hypot(*self.tilt) or 1.0
        return self.tilt[1] / steepness, -self.tilt[0] / steepness

    @cached_property
    def pose(self) -> Pose:
        w, x, y, z = self.wxyz
        return Pose(np.array(self.position), np.array([x, y, z, w]))

    def apply(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        return self.pose.apply(self.exaggerated(points))

    def exaggerated(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Exaggerate the heights of points or of directions [m]."""
        return points if self.exaggeration == 1.0 else points * (1.0, 1.0, self.exaggeration)


@dataclass(frozen=True)
class Box:
    """Box of a submap in its own frame [m]."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @classmethod
    def of(cls, submap: Submap) -> "Box":
        low, high = submap.bounds.tolist()
        return cls(tuple(low), tuple(high))

    def seen_from(self, origin: Float[Array, "3"]) -> "Box":
        """The box in a frame whose origin lies at another place of this one [m]."""
        (x0, y0, z0), (x1, y1, z1) = self.low - origin, self.high - origin
        return Box((x0, y0, z0), (x1, y1, z1))

    @property
    def center(self) -> Float[Array, "3"]:
        return (np.array(self.low) + np.array(self.high)) / 2

    @property
    def size(self) -> Float[Array, "3"]:
        return np.array(self.high) - np.array(self.low)

    @property
    def corners(self) -> Float[Array, "4 3"]:
        """Corners of its outline at mid height, in order round it."""
        (x0, y0, _), (x1, y1, _) = self.low, self.high
        z = self.center[2]
        return np.array([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)])

    @property
    def all_corners(self) -> Float[Array, "8 3"]:
        return np.array(list(product(*zip(self.low, self.high, strict=True))))


@dataclass(frozen=True)
class Canvas:
    """The canvas of a page, and what panels that float cover at each side [CSS pixels]."""

    width: float
    height: float
    left: float = 0.0
    top: float = 0.0
    right: float = 0.0
    bottom: float = 0.0

    @property
    def margins(self) -> tuple[float, float, float, float]:
        """What is left free at (left, top, right, bottom), where words stand [CSS pixels]."""
        return MARGINS

    @property
    def aspect(self) -> float:
        return self.width / self.height

    def focal_length(self, camera: Camera) -> float:
        """Distance from the eye at which a length has as many pixels on the screen [pixels]."""
        return self.height / (2.0 * tan(camera.field_of_view / 2))

    @property
    def free_aspect(self) -> float:
        """Width over height of the part that is to be filled."""
        (left, right), (bottom, top_edge) = self.free_bounds
        return self.aspect * (right - left) / (top_edge - bottom)

    @property
    def is_tall(self) -> bool:
        """Whether two submaps fill it better one behind the other than side by side."""
        return (self.width - self.left - self.right) / (self.height - self.top - self.bottom) < TALL

    @property
    def mark_scale(self) -> float:
        """How large the marks of keypoints are beside those of a wide canvas."""
        return SMALL_MARKS if self.width - self.left - self.right < SMALL else 1.0

    @property
    def free_bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """(left, right) and (bottom, top) of the area to fill; the edges are -1 and 1."""
        width = self.width - self.left - self.right
        height = self.height - self.top - self.bottom
        sizes = width, height, width, height
        left, top_edge, right, bottom = (
            margin + min(wanted, MOST_MARGIN * size)
            for margin, wanted, size in zip(
                (self.left, self.top, self.right, self.bottom), self.margins, sizes, strict=True
            )
        )
        return (
            (2 * left / self.width - 1, 1 - 2 * right / self.width),
            (2 * bottom / self.height - 1, 1 - 2 * top_edge / self.height),
        )


class BareCanvas(Canvas):
    """A canvas over which nothing is written."""

    @property
    def margins(self) -> tuple[float, float, float, float]:
        return 8.0, 8.0, 8.0, 8.0


UNKNOWN_CANVAS = Canvas(720.0, 800.0)
"""Stands for that of a page that is yet to come."""


def height_offset(maps: Maps, T_database_query: SE2, max_std_ratio: float) -> float:
    """How much higher the shared ground is in the database [m]: the median, or 0 without any."""
    _, difference, _ = _common_heights(maps, T_database_query, max_std_ratio)
    return float(np.median(difference)) if len(difference) else 0.0


def _common_heights(
    maps: Maps, T_database_query: SE2, max_std_ratio: float
) -> tuple[Float[Array, "n 2"], Float[Array, "n"], float]:
    """Places in the query [m], the database's height above its own there, and their step."""
    query_map, database_map = maps
    stride = max(1, int(np.sqrt(query_map.grid.num_cells / MAX_OVERLAP_SAMPLES)))
    trusted = query_map.trusted(max_std_ratio, stride).ravel()
    x, y = np.meshgrid(query_map.grid.x[::stride], query_map.grid.y[::stride])
    query_xy = np.column_stack([x.ravel(), y.ravel()])[trusted]
    query_z = query_map.elevation[::stride, ::stride].ravel()[trusted]
    row, column, inside = database_map.grid.nearest_cells(T_database_query.apply(query_xy))
    common = inside & database_map.trusted(max_std_ratio)[row, column]
    difference = database_map.elevation[row, column] - query_z
    return query_xy[common], difference[common], stride * query_map.grid.resolution


def level_of(
    query_map: GradientMap,
    database_map: GradientMap,
    registration: Registration,
    max_std_ratio: float,
) -> HeightFrame:
    """Estimate how the query stands level in the database's frame, for display.

    Each submap has its own zero of height, and measures gravity only so well. The plane through
    the height differences on common ground is fitted robustly, by Cauchy's weights. The tilt has
    the prior of the alignment in the registration, so that little ground tilts little.
    Without a motion each has its own level.
    """
    motion = registration.T_database_query
    if motion is None:
        return HeightFrame()
    xy, difference, step = _common_heights((query_map, database_map), motion, max_std_ratio)
    if not len(difference):
        return HeightFrame(registration.z_offset, yaw=motion.yaw)
    middle = xy.mean(axis=0)
    columns = np.column_stack([np.ones(len(xy)), xy - middle])
    # Cells nearer than the length-scale say the same.
    cells_a_patch = max(1.0, 2.0 * np.pi * (query_map.length_scale / step) ** 2)
    prior = np.diag([0.0, *[DRIFTED.tilt_std**-2] * 2])
    weights, plane = np.ones(len(xy)), np.array([np.median(difference), 0.0, 0.0])
    for _ in range(LEVEL_ROUNDS):
        left = difference - columns @ plane
        variance = float(np.median(left**2)) / 0.455 + 1e-12  # of a normal distribution
        weights = 1.0 / (1.0 + left**2 / variance)
        weighed = columns * weights[:, None]
        normal = weighed.T @ columns + prior * variance * cells_a_patch
        plane = np.linalg.solve(normal, weighed.T @ difference)
    height, a, b = (float(value) for value in plane)
    return HeightFrame(height, (a, b), motion.yaw, (float(middle[0]), float(middle[1])))


def z_offset_of(registration: Registration, maps: Maps, max_std_ratio: float) -> float:
    """The height to add to the query to lie on the database [m]; the alignment's, if that held."""
    if registration.T_database_query is None:
        return 0.0
    if registration.covariance is not None:
        return registration.z_offset
    return height_offset(maps, registration.T_database_query, max_std_ratio)


def place(
    query: Box,
    database: Box,
    layout: Layout,
    T_database_query: SE2 | None,
    dz: float,
    *,
    tilt: tuple[float, float] = (0.0, 0.0),
    tall: bool = False,
    exaggeration: float = 1.0,
) -> tuple[Placement, Placement]:
    """Place (query, database) in the scene, by the boxes of both.

    With a motion both stand in the database's frame, so that the same place looks the same: side by
    side, the query is turned and levelled, too. Without one, each has its own frame, and the two
    stand side by side. On a tall canvas that is the query behind the database.

    ``dz`` is how much higher the middle of the query's box stands in the database's frame [m], and
    the tilt is that of the query there, side by side [m/m].
    """
    times = exaggeration
    if layout == "registered" and T_database_query is not None:
        x, y, z = -database.center
        x_query, y_query = T_database_query.x + x, T_database_query.y + y
        return (
            Placement(x_query, y_query, times * (z + dz), T_database_query.yaw, exaggeration=times),
            Placement(x, y, times * z, exaggeration=times),
        )
    motion = T_database_query
    yaw, axis = 0.0 if motion is None else motion.yaw, 1 if tall else 0
    a, b = (0.0, 0.0) if motion is None else tilt
    turned = Placement(yaw=yaw, tilt=(times * a, times * b), exaggeration=times)
    flat = Placement(yaw=yaw).apply(query.corners)
    widths = float(np.ptp(flat[:, axis])), float(database.size[axis])
    gap = GAP * sum(widths) / 2
    side = 1 if tall else -1
    # Tilted about the middle of its box: the frame's origin may lie anywhere.
    still = Placement(exaggeration=times)
    at_query, at_database = (
        -turned.apply(query.center[None])[0],
        -still.apply(database.center[None])[0],
    )
    if motion is not None:
        at_query[2] += times * (query.center[2] + dz) + at_database[2]
    at_query[axis] += side * (widths[0] + gap) / 2
    at_database[axis] -= side * (widths[1] + gap) / 2
    return turned.at(at_query), still.at(at_database)


def beside(
    other: Float[Array, "n 3"], here: Float[Array, "k 3"], behind: bool
) -> tuple[float, float]:
    """The shift (x, y) that moves corners ``other`` behind those ``here``, or left, with room."""
    axis, side = (1, 1) if behind else (0, -1)
    ends = side * here[:, axis], side * other[:, axis]
    gap = BETWEEN * max(float(np.ptp(end)) for end in ends)
    way = side * (float(ends[0].max() - ends[1].min()) + gap)
    return (0.0, way) if behind else (way, 0.0)


def glide(
    box: Box,
    starts: tuple[Placement, Placement],
    ends: tuple[Placement, Placement],
    share: float,
) -> tuple[Placement, Placement]:
    """Place (query, database) a share of the way, in [0, 1]; the query goes over the ground."""
    (from_query, from_database), (to_query, to_database) = starts, ends
    rest, hop = 1 - share, ARC_HEIGHT * float(max(box.size[:2])) * 4 * share * (1 - share)
    # Round the middle of its box, which goes straight; its corner would swing.
    yaw = rest * from_query.yaw + share * to_query.yaw
    (a, b), (c, d) = from_query.tilt, to_query.tilt
    tilt = rest * a + share * c, rest * b + share * d
    turned = Placement(yaw=yaw, tilt=tilt, exaggeration=to_query.exaggeration)
    middle = box.center[None]
    way = rest * from_query.apply(middle)[0] + share * to_query.apply(middle)[0]
    query = way - turned.apply(middle)[0] + np.array([0.0, 0.0, hop])
    database = rest * np.array(from_database.position) + share * np.array(to_database.position)
    return turned.at(query), to_database.at(database)


def frame_camera(
    boxes: tuple[tuple[Box, Placement], ...],
    canvas: Canvas = UNKNOWN_CANVAS,
    *,
    forward: Float[Array, "3"] | None = None,
    parallel: bool = False,
) -> Camera:
    """Place the camera so that boxes fill the free part of a canvas.

    A corner c has its picture at (c - p)·r / (c - p)·f, for a camera at p that looks along f with r
    to its right. That it lies within the free part bounds p·r from both sides by numbers that are
    linear in p·f, and the same holds for what is up. So the nearest p follows in closed form. The
    camera looks at a point as far away as the middle of all boxes.

    The direction of sight is not straight down; None looks along +y, and down as steeply as fills
    the canvas best. A parallel camera looks from afar through a narrow field of view.
    """
    corners = np.concatenate([placement.apply(extent.all_corners) for extent, placement in boxes])
    low, high = corners.min(axis=0), corners.max(axis=0)
    if forward is None:
        width, depth = (max(float(size), 1e-9) for size in (high - low)[:2])
        steepest = np.sin(MAX_TILT)
        tilt = np.arcsin(np.clip(width / (canvas.free_aspect * depth), np.sin(MIN_TILT), steepest))
        forward = np.array([0.0, np.cos(tilt), -np.sin(tilt)])
    f, r, u = axes_of_view(forward)
    along, half = corners @ f, tan((PARALLEL if parallel else FIELD_OF_VIEW) / 2)
    (left, right), (bottom, top_edge) = canvas.free_bounds
    wide = half * canvas.aspect
    sides = (
        (corners @ r, wide * left, wide * right),
        (corners @ u, half * bottom, half * top_edge),
    )
    limits = [
        ((at - last * along).max(), (at - first * along).min(), first, last)
        for at, first, last in sides
    ]
    p_f = min((most - least) / (last - first) for least, most, first, last in limits)
    p_f = min(p_f, float(along.min()) - 1e-3)
    p_r, p_u = (
        (least + last * p_f + most + first * p_f) / 2 for least, most, first, last in limits
    )
    position = p_f * f + p_r * r + p_u * u
    distance = float((low + high) / 2 @ f) - p_f
    look_at = position + max(distance, 1e-3) * f
    return Camera.at(position, look_at, parallel=parallel)


def axes_of_view(
    forward: Float[Array, "3"],
) -> tuple[Float[Array, "3"], Float[Array, "3"], Float[Array, "3"]]:
    """The unit vectors (forward, right, up) of an upright camera; straight down, +y is up."""
    f = forward / np.linalg.norm(forward)
    level = np.cross(f, [0.0, 0.0, 1.0])
    length = float(np.linalg.norm(level))
    r = np.array([1.0, 0.0, 0.0]) if length < 1e-9 else level / length
    return f, r, np.cross(r, f)
