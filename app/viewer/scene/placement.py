"""Where the two submaps stand in the scene, and from where the camera sees both."""

import weakref
from dataclasses import dataclass
from math import cos, sin, tan

import numpy as np
from jaxtyping import Float

from app.viewer.session.state import Camera, Layout
from gpgrad_core.arrays import Array
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, Registration, Submap

GAP = 0.12
"""Room between submaps side by side, as a share of their width."""
HOP = 0.12
"""How high a submap that glides into place goes, as a share of its width."""
MAX_OVERLAP_SAMPLES = 5_000
FIELD_OF_VIEW = np.deg2rad(45.0)
MIN_TILT, MAX_TILT = np.deg2rad(58.0), np.deg2rad(70.0)
"""How far the camera looks down."""
TALL = 0.85
"""Canvases whose width over height is less have the submaps one behind the other."""
MARGINS = (24.0, 76.0, 24.0, 68.0)
"""Left, top, right and bottom of a canvas that are kept free for names and scale [pixels]."""
MOST_MARGIN = 0.1
"""Of a canvas that any of these margins may take."""


@dataclass(frozen=True)
class Placement:
    """Pose of a submap's frame in the scene: turned about z, then moved."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0

    @property
    def position(self) -> tuple[float, float, float]:
        """Of the frame's origin [m]."""
        return self.x, self.y, self.z

    @property
    def wxyz(self) -> tuple[float, float, float, float]:
        """Turn of the frame as a quaternion."""
        return cos(self.yaw / 2), 0.0, 0.0, sin(self.yaw / 2)

    def apply(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Map points of the submap's frame [m] into the scene [m]."""
        flat = SE2(self.x, self.y, self.yaw).apply(points[:, :2])
        return np.column_stack([flat, points[:, 2] + self.z])


@dataclass(frozen=True)
class Extent:
    """Box of a submap in its own frame [m]."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @classmethod
    def of(cls, submap: Submap) -> "Extent":
        """Measure a submap, once: the cameras ask again and again."""
        extent = _measured.get(submap)
        if extent is None:
            low, high = submap.points.min(axis=0), submap.points.max(axis=0)
            extent = _measured[submap] = cls((low[0], low[1], low[2]), (high[0], high[1], high[2]))
        return extent

    @property
    def center(self) -> Float[Array, "3"]:
        """Middle of the box."""
        return (np.array(self.low) + np.array(self.high)) / 2

    @property
    def size(self) -> Float[Array, "3"]:
        """Sides of the box."""
        return np.array(self.high) - np.array(self.low)

    @property
    def corners(self) -> Float[Array, "4 3"]:
        """Corners of its outline at mid height, in order round it."""
        (x0, y0, _), (x1, y1, _) = self.low, self.high
        z = self.center[2]
        return np.array([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)])

    @property
    def all_corners(self) -> Float[Array, "8 3"]:
        """Corners of the box."""
        lows, highs = self.corners.copy(), self.corners.copy()
        lows[:, 2], highs[:, 2] = self.low[2], self.high[2]
        return np.concatenate([lows, highs])


_measured: weakref.WeakKeyDictionary[Submap, Extent] = weakref.WeakKeyDictionary()


@dataclass(frozen=True)
class Canvas:
    """The canvas of a page, and what of it is covered by panels that float.

    Attributes:
        width: In CSS pixels, as all of these.
        height: Of the whole canvas.
        left: Covered on this side.
        top: Covered on this side.
        right: Covered on this side.
        bottom: Covered on this side.
    """

    width: float
    height: float
    left: float = 0.0
    top: float = 0.0
    right: float = 0.0
    bottom: float = 0.0

    @property
    def aspect(self) -> float:
        """Width over height of the whole canvas."""
        return self.width / self.height

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
    def free_bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Give (left, right) and (bottom, top) of what is to be filled; the edges are -1 and 1."""
        width = self.width - self.left - self.right
        height = self.height - self.top - self.bottom
        sizes = width, height, width, height
        left, top_edge, right, bottom = (
            margin + min(wanted, MOST_MARGIN * size)
            for margin, wanted, size in zip(
                (self.left, self.top, self.right, self.bottom), MARGINS, sizes, strict=True
            )
        )
        return (
            (2 * left / self.width - 1, 1 - 2 * right / self.width),
            (2 * bottom / self.height - 1, 1 - 2 * top_edge / self.height),
        )


UNKNOWN_CANVAS = Canvas(720.0, 800.0)
"""Stands for that of a page that is yet to come."""


def height_offset(
    query_map: GradientMap,
    database_map: GradientMap,
    T_database_query: SE2,
    max_std_ratio: float,
) -> float:
    """Measure how far the shared ground lies higher in the database than in the query [m].

    The registration is planar; each submap has its own zero of height. The median over the
    common trusted cells is not moved by a few wrong ones. Zero if nothing is shared.
    """
    stride = max(1, int(np.sqrt(query_map.grid.num_cells / MAX_OVERLAP_SAMPLES)))
    trusted = query_map.trusted(max_std_ratio)[::stride, ::stride].ravel()
    x, y = np.meshgrid(query_map.grid.x[::stride], query_map.grid.y[::stride])
    query_xy = np.column_stack([x.ravel(), y.ravel()])[trusted]
    query_z = query_map.elevation[::stride, ::stride].ravel()[trusted]
    grid = database_map.grid
    pixels = np.rint(grid.to_pixel(T_database_query.apply(query_xy))).astype(np.intp)
    rows, columns = grid.shape
    inside = (
        (pixels[:, 0] >= 0) & (pixels[:, 0] < columns) & (pixels[:, 1] >= 0) & (pixels[:, 1] < rows)
    )
    column, row = pixels[inside].T
    common = database_map.trusted(max_std_ratio)[row, column]
    if not common.any():
        return 0.0
    difference = database_map.elevation[row, column] - query_z[inside]
    return float(np.median(difference[common]))


def z_offset_of(
    registration: Registration, maps: tuple[GradientMap, GradientMap], max_std_ratio: float
) -> float:
    """Give the height to add to the query so that it lies on the database [m].

    The registration's own, where the alignment held; else, as where there is little in common,
    the median difference.

    Args:
        registration: Of the pair; zero if it has no motion.
        maps: Of query and database.
        max_std_ratio: The variance mask.
    """
    if registration.T_database_query is None:
        return 0.0
    if registration.covariance is not None:
        return registration.z_offset
    return height_offset(*maps, registration.T_database_query, max_std_ratio)


def place(
    query: Extent,
    database: Extent,
    layout: Layout,
    T_database_query: SE2 | None,
    dz: float,
    *,
    tall: bool = False,
) -> tuple[Placement, Placement]:
    """Place (query, database) in the scene.

    Args:
        query: Box of the query submap.
        database: Box of the database submap.
        layout: Registered needs a motion; without one the submaps stand side by side.
        T_database_query: The registration.
        dz: Height of the query's zero in the database's frame [m].
        tall: For a tall canvas the query stands behind the database instead of to its left.
    """
    if layout == "registered" and T_database_query is not None:
        x, y, z = -database.center
        x_query, y_query = T_database_query.x + x, T_database_query.y + y
        return (
            Placement(x_query, y_query, z + dz, T_database_query.yaw),
            Placement(x, y, z),
        )
    query_x, query_y, query_z = (float(value) for value in -query.center)
    database_x, database_y, database_z = (float(value) for value in -database.center)
    if tall:
        gap = GAP * (query.size[1] + database.size[1]) / 2
        return (
            Placement(query_x, query_y + (query.size[1] + gap) / 2, query_z),
            Placement(database_x, database_y - (database.size[1] + gap) / 2, database_z),
        )
    gap = GAP * (query.size[0] + database.size[0]) / 2
    return (
        Placement(query_x - (query.size[0] + gap) / 2, query_y, query_z),
        Placement(database_x + (database.size[0] + gap) / 2, database_y, database_z),
    )


def glide(
    query: Extent,
    database: Extent,
    T_database_query: SE2,
    dz: float,
    share: float,
    *,
    tall: bool = False,
) -> tuple[Placement, Placement]:
    """Place (query, database) between side by side and registered.

    The query goes over the ground, not through it, and comes down on its place.

    Args:
        query: Box of the query submap.
        database: Box of the database submap.
        T_database_query: The registration.
        dz: Height of the query's zero in the database's frame [m].
        share: Of the way, in [0, 1].
        tall: As for `place`.
    """
    starts = place(query, database, "side by side", None, 0.0, tall=tall)
    ends = place(query, database, "registered", T_database_query, dz)
    hop = HOP * float(max(query.size[:2])) * 4 * share * (1 - share)
    (from_query, from_database), (to_query, to_database) = starts, ends
    # Round the middle of its box, which goes straight; its corner would swing.
    yaw = share * to_query.yaw
    middle = query.center[None]
    begin, end = from_query.apply(middle)[0], to_query.apply(middle)[0]
    x, y, z = (1 - share) * begin + share * end - Placement(yaw=yaw).apply(middle)[0]
    return (
        Placement(float(x), float(y), float(z) + hop, yaw),
        Placement(
            *(
                float((1 - share) * a + share * b)
                for a, b in zip(from_database.position, to_database.position, strict=True)
            )
        ),
    )


def frame_camera(
    boxes: tuple[tuple[Extent, Placement], ...],
    canvas: Canvas = UNKNOWN_CANVAS,
    *,
    forward: Float[Array, "3"] | None = None,
) -> Camera:
    """Place the camera so that boxes fill the free part of a canvas.

    A corner c has its picture at (c - p)·r / (c - p)·f, for a camera at p that looks along f with r
    to its right. That it lies within the free part bounds p·r from both sides by numbers that are
    linear in p·f, and the same holds for what is up. So the nearest p is found without trying.

    Args:
        boxes: Each submap's box and its place in the scene.
        canvas: The page's.
        forward: Direction of sight, not straight down; None looks along +y, and down as steeply as
            fills the canvas best.

    Returns:
        The camera; it looks at a point on its axis, as far away as the middle of all boxes.
    """
    corners = np.concatenate([placement.apply(extent.all_corners) for extent, placement in boxes])
    low, high = corners.min(axis=0), corners.max(axis=0)
    if forward is None:
        width, depth = (max(float(size), 1e-9) for size in (high - low)[:2])
        steepest = np.sin(MAX_TILT)
        tilt = np.arcsin(np.clip(width / (canvas.free_aspect * depth), np.sin(MIN_TILT), steepest))
        forward = np.array([0.0, np.cos(tilt), -np.sin(tilt)])
    f, r, u = axes_of_view(forward)
    along, half = corners @ f, tan(FIELD_OF_VIEW / 2)
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
    return Camera(_tuple(position), _tuple(look_at))


def axes_of_view(
    forward: Float[Array, "3"],
) -> tuple[Float[Array, "3"], Float[Array, "3"], Float[Array, "3"]]:
    """Give the unit vectors (forward, right, up) of a camera that is held upright.

    Args:
        forward: Direction of sight, of any length but zero. Straight down, +y is up.
    """
    f = forward / np.linalg.norm(forward)
    level = np.cross(f, [0.0, 0.0, 1.0])
    length = float(np.linalg.norm(level))
    r = np.array([1.0, 0.0, 0.0]) if length < 1e-9 else level / length
    return f, r, np.cross(r, f)


def _tuple(point: Float[Array, "3"]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in point)
    return x, y, z
