"""Where the two submaps stand in the scene, and from where the camera sees both."""

from dataclasses import dataclass
from math import cos, sin, tan

import numpy as np
from jaxtyping import Float

from app.viewer.state import Layout
from gpgrad_core.arrays import Array
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, Registration, Submap

GAP = 0.12
"""Room between submaps side by side, as a share of their width."""
HOP = 0.12
"""How high a submap that glides into place goes, as a share of its width."""
MAX_OVERLAP_SAMPLES = 5_000
FIELD_OF_VIEW = np.deg2rad(45.0)
CAMERA_TILT = np.deg2rad(55.0)
"""How far the camera looks down."""


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
        """Measure a submap."""
        low, high = submap.points.min(axis=0), submap.points.max(axis=0)
        return cls((low[0], low[1], low[2]), (high[0], high[1], high[2]))

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


@dataclass(frozen=True)
class Camera:
    """A view of the scene, z up."""

    position: tuple[float, float, float]
    look_at: tuple[float, float, float]


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
) -> tuple[Placement, Placement]:
    """Place (query, database) in the scene.

    Args:
        query: Box of the query submap.
        database: Box of the database submap.
        layout: Registered needs a motion; without one the submaps stand side by side.
        T_database_query: The registration.
        dz: Height of the query's zero in the database's frame [m].
    """
    if layout == "registered" and T_database_query is not None:
        x, y, z = -database.center
        x_query, y_query = T_database_query.x + x, T_database_query.y + y
        return (
            Placement(x_query, y_query, z + dz, T_database_query.yaw),
            Placement(x, y, z),
        )
    gap = GAP * (query.size[0] + database.size[0]) / 2
    query_x, query_y, query_z = -query.center
    database_x, database_y, database_z = -database.center
    return (
        Placement(query_x + (query.size[0] + gap) / 2, query_y, query_z),
        Placement(database_x - (database.size[0] + gap) / 2, database_y, database_z),
    )


def glide(
    query: Extent, database: Extent, T_database_query: SE2, dz: float, share: float
) -> tuple[Placement, Placement]:
    """Place (query, database) between side by side and registered.

    The query goes over the ground, not through it, and comes down on its place.

    Args:
        query: Box of the query submap.
        database: Box of the database submap.
        T_database_query: The registration.
        dz: Height of the query's zero in the database's frame [m].
        share: Of the way, in [0, 1].
    """
    starts = place(query, database, "side by side", None, 0.0)
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


def frame_camera(boxes: tuple[tuple[Extent, Placement], ...], aspect: float = 0.72) -> Camera:
    """Place the camera so that the submaps fill the view.

    Args:
        boxes: Each submap's box and its place in the scene.
        aspect: Width of the picture over its height; narrower windows see less.
    """
    corners = np.concatenate([placement.apply(extent.corners) for extent, placement in boxes])
    center = (corners.min(axis=0) + corners.max(axis=0)) / 2
    width, depth, _ = corners.max(axis=0) - corners.min(axis=0)
    half = tan(FIELD_OF_VIEW / 2)
    # The near edge is nearer than the centre, hence wider in the picture.
    near_edge = depth / 2 * cos(CAMERA_TILT)
    for_width = width / 2 / (half * aspect) + near_edge
    for_depth = depth / 2 * sin(CAMERA_TILT) / half + near_edge
    distance = 1.1 * max(for_width, for_depth, 1e-3)
    position = center + distance * np.array([0.0, -cos(CAMERA_TILT), sin(CAMERA_TILT)])
    return Camera(
        (float(position[0]), float(position[1]), float(position[2])),
        (float(center[0]), float(center[1]), float(center[2])),
    )
