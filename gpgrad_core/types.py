"""The types that all stages share.

They are frozen and their arrays are read-only. All lengths are in metres and all angles in
radians; only `Grid` knows pixels.
"""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from msgspec import Meta

from gpgrad_core.arrays import Array, Floats, Indices, Mask, NDArray, Singles
from gpgrad_core.display import card, picture, shaded
from gpgrad_core.errors import InputError, NoTerrainError, score_in_words
from gpgrad_core.reading.records import Count, Finite, NotNegative
from gpgrad_core.scale import std_at_scale
from gpgrad_core.se2 import SE2, Pose, move_covariance

Descriptors = Singles | NDArray[np.uint8]
"""Vectors of float32, compared by L2 distance, or strings of bits, by Hamming distance."""

Pair: TypeAlias = tuple[int, int]
"""Indices (query, database) of two submaps in their order; the database is the earlier one."""
PairOfIds: TypeAlias = tuple[str, str]
"""Ids of two submaps (query, database); the database is the earlier one."""

MAX_GRID_CELLS = 25_000_000
"""Largest number of cells of a submap's map; four float64 fields of this size take 0.8 GB."""

MAX_COORDINATE = 1e9
"""Of a point [m]. Map projections stay below 1e8; damaged files have coordinates of 1e30."""

Coordinate: TypeAlias = Annotated[float, Meta(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]

MOST_ASSOCIATIONS = 10_000_000
"""Of a pair in a file; each becomes a truth value in memory."""
Associations: TypeAlias = Annotated[int, Meta(ge=0, le=MOST_ASSOCIATIONS)]

GroundChoice: TypeAlias = Literal["automatic", "filtered", "all"]
"""Whether to leave out what is not ground: where the cloud shows it, always, or never."""

MAX_STD_RATIO = 0.3
"""Default threshold of the variance mask; see `GradientMap.trusted`."""


def read_only(*arrays: NDArray[np.generic]) -> None:
    """Mark arrays as read-only, because they belong to a frozen dataclass."""
    for array in arrays:
        array.flags.writeable = False


@dataclass(frozen=True, eq=False)
class Extent:
    """Where the points of a submap lie in its frame, whose origin may lie anywhere.

    Attributes:
        centre: Mean of the points (3,) [m].
        spread: Root mean square distance from it, seen from above [m].
    """

    centre: Float[Array, "3"] = field(default_factory=lambda: np.zeros(3))
    spread: float = 0.0

    def __post_init__(self) -> None:
        read_only(self.centre)

    @classmethod
    def of(cls, points: Float[Array, "n 3"]) -> "Extent":
        """Measure points, without losing digits of national grids."""
        centre = points[0] + (points - points[0]).mean(axis=0)
        squares = np.sum((points[:, :2] - centre[:2]) ** 2, axis=1)
        return cls(centre, float(np.sqrt(squares.mean())))


@dataclass(frozen=True, eq=False)
class Submap:
    """A gravity-aligned point cloud of the robot's vicinity, in its own local frame.

    Make one with `from_points`, which checks the points. Lengths are in metres.

    Attributes:
        id: The submap's name: the cloud's file name without the ending.
        points: Positions (n, 3) [m], all finite; z points up.
        fingerprint: Hash of the points and of everything given for each point. The `Memo`
            identifies the submap by it.
        pose_true: The true pose in the world, ``T_world_submap``. Only the evaluation and the
            viewer use it.
        pose_odometry: The pose in the world according to the robot's odometry.
        num_dropped: Number of rows that were dropped because they were not finite.
        num_outliers: Number of points that were left out because no ground around them could
            explain them; see `gpgrad_core.outliers`.
        num_non_ground: Number of points that were left out because they stand on the ground, such
            as bushes and walls; see `gpgrad_core.ground`.
        left_out: Positions (k, 3) [m] of the outliers and of the points that stand on the ground,
            which only the viewer shows; None if there are none.
        colors: Red, green and blue of each point (n, 3) in [0, 1], for methods that use them.
        images: Image files that a camera took there, for methods that use them.
        noise_std: Standard deviation of each point's height (n,) [m], if the source gives it.
        ranges: Distance from the sensor to each point (n,) [m], if the source gives it.
        extent: Where its points lie; zero for a submap that never had points.
    """

    id: str
    points: Float[Array, "n 3"]
    fingerprint: str
    pose_true: Pose | None = None
    pose_odometry: Pose | None = None
    num_dropped: int = 0
    num_outliers: int = 0
    num_non_ground: int = 0
    left_out: Float[Array, "k 3"] | None = None
    colors: Float[Array, "n 3"] | None = None
    images: tuple[Path, ...] = ()
    noise_std: Float[Array, "n"] | None = None
    ranges: Float[Array, "n"] | None = None
    extent: Extent = field(default_factory=Extent)

    @property
    def centre(self) -> Float[Array, "3"]:
        """Mean of the points (3,) [m], about which motions are judged: it lies on the ground."""
        return self.extent.centre

    @property
    def num_points(self) -> int:
        """Number of points."""
        return len(self.points)

    num_wild = property(attrgetter("num_outliers"), doc="The former name of `num_outliers`.")
    num_standing = property(attrgetter("num_non_ground"), doc="That of `num_non_ground`.")

    @cached_property
    def bounds(self) -> Float[Array, "2 3"]:
        """Lowest and highest coordinates of the points [m]."""
        return np.stack([self.points.min(axis=0), self.points.max(axis=0)])

    @property
    def corners(self) -> Float[Array, "2 2"]:
        """Lowest and highest x and y of the points [m]."""
        return self.bounds[:, :2]

    def load(self) -> "Submap":
        """Return itself, because it is loaded: a submap is its own `SubmapSource`."""
        return self

    @property
    def centred(self) -> "Submap":
        """The same submap in a frame whose origin is its centre."""
        there = Pose(self.centre, np.array([0.0, 0.0, 0.0, 1.0]))
        points, left_out = self.points - self.centre, self.left_out
        read_only(points)
        return replace(
            self,
            points=points,
            fingerprint=f"{self.fingerprint}-centred",
            pose_true=self.pose_true and self.pose_true @ there,
            pose_odometry=self.pose_odometry and self.pose_odometry @ there,
            left_out=None if left_out is None else left_out - self.centre,
            extent=Extent(spread=self.extent.spread),
        )

    def refilled(
        self,
        points: Float[Array, "n 3"],
        colors: Float[Array, "n 3"] | None = None,
        noise_std: Float[Array, "n"] | None = None,
        ranges: Float[Array, "n"] | None = None,
    ) -> "Submap":
        """Replace its points: they are checked, become read-only, and none is dropped.

        Raises:
            InputError: If a value is out of its bounds, or no surface fits, as in `from_points`.
        """
        num_left_out = self.num_dropped + self.num_outliers + self.num_non_ground
        _check_spans_area(points, len(points) + num_left_out, self.id)
        _check_measured(noise_std, ranges, self.id)
        read_only(points, *(array for array in (colors, noise_std, ranges) if array is not None))
        return replace(
            self,
            points=points,
            extent=Extent.of(points),
            fingerprint=_hash_points(points, colors, noise_std, ranges),
            colors=colors,
            noise_std=noise_std,
            ranges=ranges,
        )

    @classmethod
    def from_points(
        cls,
        points: Float[Floats, "n 3"],
        id: str = "cloud",
        *,
        pose_true: Pose | None = None,
        pose_odometry: Pose | None = None,
        colors: Float[Floats, "n 3"] | None = None,
        noise_std: Float[Floats, "n"] | None = None,
        ranges: Float[Floats, "n"] | None = None,
        ground: GroundChoice | None = "automatic",
    ) -> "Submap":
        """Make a submap of a cloud: of its points, those that are finite, no outliers, and ground.

        Args:
            points: Positions (n, 3) [m]; z points up.
            id: The submap's name, which error messages use.
            pose_true: The true pose in the world, ``T_world_submap``.
            pose_odometry: The pose in the world according to odometry.
            colors: Red, green and blue of each point (n, 3) in [0, 1].
            noise_std: Standard deviation of each point's height (n,) [m].
            ranges: Distance from the sensor to each point (n,) [m].
            ground: Whether to leave out what stands on the ground: ``automatic`` where the points
                show it, ``filtered`` always, or ``all`` never. None if all points are known to be
                ground, as when they are read a second time: outliers are not looked for either.

        Raises:
            InputError: If the points are not an (n, 3) array, if fewer than three of them are
                finite, if all of them lie on one line, if a coordinate is beyond
                `MAX_COORDINATE`, if a noise is not above zero, or if a range is negative.
        """
        # It is for users, and above this module: which points are terrain is no question of types.
        from gpgrad_core.ground import submap_of_cloud  # noqa: PLC0415

        return submap_of_cloud(
            points,
            id,
            pose_true=pose_true,
            pose_odometry=pose_odometry,
            colors=colors,
            noise_std=noise_std,
            ranges=ranges,
            ground=ground,
        )


def _hash_points(
    points: Array, colors: Array | None, noise_std: Array | None, ranges: Array | None
) -> str:
    digest = hashlib.blake2b(points.tobytes(), digest_size=16)
    if colors is not None:
        digest.update(colors.tobytes())
    if noise_std is not None:
        digest.update(noise_std.tobytes())
    if ranges is not None:
        digest.update(b"ranges" + ranges.tobytes())
    return digest.hexdigest()


def check_coordinates(points: Float[Floats, "n 3"], where: str) -> None:
    """Refuse coordinates that no terrain has; rows that are not finite are passed over."""
    # The negated comparison is false for infinity and NaN too, so these are looked at again.
    far = ~(np.abs(points) <= MAX_COORDINATE)
    if not far.any():
        return
    wrong = np.flatnonzero(far.any(axis=1) & np.isfinite(points).all(axis=1))
    if len(wrong):
        worst = float(np.abs(points[wrong[0]]).max())
        raise InputError(
            f"{where}: point {wrong[0]} has a coordinate of {worst:.3g} m; {MAX_COORDINATE:g} m is "
            "the most, so the file is damaged, or its units are not metres"
        )


def _check_spans_area(points: Float[Array, "n 3"], num_rows: int, name: str) -> None:
    """Refuse points to which no surface can be fitted."""
    if len(points) < 3:
        raise NoTerrainError(
            f"{name}: a terrain needs 3 or more finite points, found {len(points)} "
            f"of {num_rows}; give a fuller cloud"
        )
    centred = points[:, :2] - points[:, :2].mean(axis=0)
    spread = np.linalg.eigvalsh(centred.T @ centred / len(points))
    if spread[0] <= 1e-12 * max(spread[1], 1e-12):
        raise NoTerrainError(
            f"{name}: all {len(points)} points lie on one line seen from above; "
            "a terrain needs points that span an area"
        )


def _check_measured(
    noise_std: Float[Array, "n"] | None, ranges: Float[Array, "n"] | None, name: str
) -> None:
    """Refuse what no sensor measures."""
    if noise_std is not None:
        allowed = (noise_std > 0) & (noise_std <= MAX_COORDINATE)
        _check_each(noise_std, allowed, f"{name}: noise_std must be above 0 m")
    if ranges is not None:
        allowed = (ranges >= 0) & (ranges <= MAX_COORDINATE)
        _check_each(ranges, allowed, f"{name}: range must be 0 m or more")


def _check_each(values: Float[Array, "n"], allowed: Bool[Mask, "n"], rule: str) -> None:
    """Raise an error for the first value that is not finite or breaks the rule."""
    wrong = np.flatnonzero(~(np.isfinite(values) & allowed))
    if len(wrong):
        raise InputError(f"{rule} at every point, got {values[wrong[0]]:g} at point {wrong[0]}")


@runtime_checkable
class SubmapSource(Protocol):
    """Where a submap comes from: a file, or the submap itself.

    A source is small, so that many of them fit into memory and travel between processes.
    """

    @property
    def id(self) -> str:
        """The submap's name."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hash of the points, as that of the submap."""
        ...

    @property
    def num_points(self) -> int:
        """Number of points."""
        ...

    def load(self) -> Submap:
        """Load the submap."""
        ...


@dataclass(frozen=True, eq=False)
class Dataset:
    """Submaps of one or more traverses.

    Attributes:
        name: The name that people see.
        submaps: The submaps, in the order of their numbers.
        description: A description of the terrain, if the dataset gives one.
        preferred: Parameters that its ``dataset.toml`` recommends, as nested tables.
        notes: What was left out or repaired while loading, one line each. Show them to the user.
        licence: The licence of the data, if the dataset names one.
        sensor_noise: Standard deviation of a point at range r [m], if the dataset gives it:
            ``constant`` [m] + ``quadratic`` [1/m] * r².
        ground: Whether what stands on the ground was left out of the submaps; see
            `Submap.from_points`.
        positions_only: Whether only the positions of the true poses were measured, and their
            headings are those of odometry, turned onto the positions nearby.
        origin: Latitude, longitude [degrees] and height above the ellipsoid [m] of the frame of
            the true poses, or else of odometry, whose x points east and y north; None if unknown.
    """

    name: str
    submaps: tuple[Submap, ...]
    description: str = ""
    preferred: dict[str, object] = field(default_factory=dict[str, object])
    notes: tuple[str, ...] = ()
    licence: str = ""
    sensor_noise: dict[str, float] = field(default_factory=dict[str, float])
    ground: GroundChoice = "automatic"
    positions_only: bool = False
    origin: tuple[float, float, float] | None = None

    @property
    def index(self) -> dict[str, int]:
        """Place of each submap in their order, by id."""
        return {submap.id: k for k, submap in enumerate(self.submaps)}

    @property
    def true_poses(self) -> dict[str, Pose]:
        """``T_world_submap`` of the submaps whose true poses are known, by id."""
        return {s.id: s.pose_true for s in self.submaps if s.pose_true is not None}

    @property
    def odometry(self) -> dict[str, Pose]:
        """Poses of the submaps that have one by odometry, by id."""
        return {s.id: s.pose_odometry for s in self.submaps if s.pose_odometry is not None}

    @property
    def centres(self) -> dict[str, Float[Array, "3"]]:
        """`Submap.centre` by id."""
        return {submap.id: submap.centre for submap in self.submaps}

    def submap(self, submap_id: str) -> Submap:
        """Find a submap by its id.

        Raises:
            InputError: If no submap has that id.
        """
        for submap in self.submaps:
            if submap.id == submap_id:
                return submap
        raise InputError(f"{self.name} has no submap {submap_id!r}")


@dataclass(frozen=True)
class Grid:
    """A regular grid of cells; only this class converts between (row, column) and (x, y).

    Row 0 has the lowest y, column 0 the lowest x.

    Attributes:
        origin: Centre (x, y) of cell (0, 0) [m].
        resolution: Side of a cell [m].
        shape: Number of rows and columns.
    """

    origin: tuple[float, float]
    resolution: float
    shape: tuple[int, int]

    @classmethod
    def covering(
        cls,
        points: Float[Array, "n 2"],
        resolution: float,
        *,
        name: str = "the cloud",
        max_cells: int = MAX_GRID_CELLS,
        on_multiples: bool = False,
    ) -> "Grid":
        """Make a grid that covers the points' bounding box (the paper's Sec. VI-B).

        Args:
            points: Positions (n, 2) [m].
            resolution: Side of a cell [m].
            name: What the points are, for the error message.
            max_cells: The largest number of cells allowed.
            on_multiples: Whether the cells' centres lie on whole multiples of the resolution;
                otherwise the first one lies at the lowest x and y.

        Raises:
            InputError: If the grid would have more than `max_cells` cells.
        """
        low, high = points.min(axis=0), points.max(axis=0)
        origin, steps = low, np.ceil((high - low) / resolution)
        if on_multiples:
            first = np.floor(low / resolution)
            origin, steps = first * resolution, np.ceil(high / resolution) - first
        columns, rows = (int(count) + 1 for count in steps)
        if rows * columns > max_cells:
            width, height = high - low
            # The resolution r at which (width / r + 2) (height / r + 2) is the largest number.
            edge, most = float(width + height), max_cells - 4
            fitting = (edge + np.sqrt(edge**2 + most * width * height)) / most
            raise InputError(
                f"{name} spans {width:,.0f} m x {height:,.0f} m: {rows * columns:,} cells at "
                f"{resolution:g} m, more than the {max_cells:,} allowed; raise the resolution "
                f"to {np.ceil(fitting * 1000) / 1000:g} m or more, or map less ground at once"
            )
        return cls((float(origin[0]), float(origin[1])), resolution, (rows, columns))

    @property
    def x(self) -> Float[Array, "columns"]:
        """Centres of the columns [m]."""
        return self.origin[0] + self.resolution * np.arange(self.shape[1], dtype=np.float64)

    @property
    def y(self) -> Float[Array, "rows"]:
        """Centres of the rows [m]."""
        return self.origin[1] + self.resolution * np.arange(self.shape[0], dtype=np.float64)

    @property
    def positions(self) -> Float[Array, "cells 2"]:
        """Centres of all cells [m], row by row."""
        x, y = np.meshgrid(self.x, self.y)
        return np.column_stack([x.ravel(), y.ravel()])

    @property
    def corners(self) -> Float[Array, "4 2"]:
        """Centres of the cells at the corners [m], in order round the grid."""
        x0, x1, y0, y1 = self.x[0], self.x[-1], self.y[0], self.y[-1]
        return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])

    @property
    def num_cells(self) -> int:
        """Number of cells."""
        return self.shape[0] * self.shape[1]

    def to_position(self, pixels: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """Convert fractional (column, row), the order of image libraries, to (x, y) [m]."""
        return np.asarray(self.origin) + self.resolution * pixels

    def to_pixel(self, positions: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """Convert (x, y) [m] to fractional (column, row)."""
        return (positions - np.asarray(self.origin)) / self.resolution

    def nearest_cells(
        self, positions: Float[Array, "n 2"]
    ) -> tuple[Int[Indices, "n"], Int[Indices, "n"], Bool[Mask, "n"]]:
        """Find the row and column nearest to each position [m], and whether the grid reaches there.

        Beyond the rim it is the cell of the rim.
        """
        column, row = np.rint(self.to_pixel(positions)).astype(np.intp).T
        rows, columns = self.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        return row.clip(0, rows - 1), column.clip(0, columns - 1), inside


@dataclass(frozen=True, eq=False)
class GradientMap:
    """Terrain of one submap on a regular grid; row 0 holds the lowest y.

    Attributes:
        grid: Position and size of the cells.
        elevation: Posterior mean of the height (rows, columns) [m], Eq. (2).
        variance: Posterior variance of the height (rows, columns) [m²], Eq. (3).
        slope: dz/dx and dz/dy (rows, columns, 2) [m/m], Eqs. (4) and (5).
        signal_std: Prior standard deviation of the terrain's height [m].
        length_scale: Length-scale of the kernel [m], Eq. (6).
        scale: The scale of comparison [m]: the finest detail that the points resolve. With 0 it
            becomes the length-scale.
        gradient: Steepness (rows, columns) [m/m], the length of the slope vector: the paper's
            image I_g.
        std: Posterior standard deviation of the height (rows, columns) [m].
    """

    grid: Grid
    elevation: Float[Array, "rows columns"]
    variance: Float[Array, "rows columns"]
    slope: Float[Array, "rows columns 2"]
    signal_std: float
    length_scale: float
    scale: float = 0.0
    gradient: Float[Array, "rows columns"] = field(init=False)
    std: Float[Array, "rows columns"] = field(init=False)

    def __post_init__(self) -> None:
        if self.scale == 0:
            object.__setattr__(self, "scale", self.length_scale)
        along_x, along_y = self.slope[..., 0], self.slope[..., 1]
        # This takes a seventh of the time of np.hypot, which also guards against overflow.
        object.__setattr__(self, "gradient", np.sqrt(along_x * along_x + along_y * along_y))
        object.__setattr__(self, "std", np.sqrt(self.variance))
        read_only(self.elevation, self.variance, self.slope, self.gradient, self.std)

    @property
    def detail_std(self) -> float:
        """Typical change of the height over the scale of comparison [m]; see `std_at_scale`."""
        return std_at_scale(self.signal_std, self.length_scale, self.scale)

    def trusted(self, max_std_ratio: float, every: int = 1) -> Bool[Mask, "_rows _columns"]:
        """Find the cells that lie close enough to points: the paper's variance mask.

        A cell is trusted if ``std / detail_std <= max_std_ratio``. The maps are compared by their
        detail, so the standard deviation is measured relative to that. The ratio has no unit, so
        one value means the same on every dataset.

        Args:
            max_std_ratio: The threshold, in (0, 1]; 1 trusts all cells.
            every: Looks at every so many rows and columns.

        Returns:
            Which cells are trusted: (rows, columns), or those that are looked at.
        """
        std = self.std[::every, ::every]
        if max_std_ratio >= 1:
            return np.ones(std.shape, dtype=np.bool_)
        return std <= max_std_ratio * self.detail_std

    def pictures(self, name: str = "") -> list[tuple[str, str]]:
        """Draw the terrain and its gradient for a notebook, each with its caption."""
        trusted, of = self.trusted(MAX_STD_RATIO), f" of {name}" if name else ""
        return [
            (f"terrain{of}, shaded", picture(shaded(self.slope), trusted)),
            (f"gradient{of}", picture(self.gradient, trusted)),
        ]

    def _repr_html_(self) -> str:
        trusted, (rows, columns) = self.trusted(MAX_STD_RATIO), self.grid.shape
        heights = self.elevation[trusted] if trusted.any() else self.elevation
        return card(
            "Gradient map",
            [
                ("cells", f"{columns} x {rows} of {self.grid.resolution:g} m"),
                ("heights", f"{heights.min():.2f} m to {heights.max():.2f} m"),
                ("length-scale", f"{self.length_scale:.3g} m"),
                ("trusted", f"{100 * trusted.mean():.0f} % of the cells"),
            ],
            pictures=self.pictures(),
        )


@dataclass(frozen=True, eq=False)
class Features:
    """Keypoints of one gradient map.

    Attributes:
        positions: (k, 2) [m] in the submap's frame.
        scales: Diameter of the neighbourhood that the descriptor covers (k,) [m].
        responses: Strength of each keypoint (k,), in the detector's own unit.
        std_ratios: ``std / detail_std`` of the map at each keypoint (k,), at most 1; see
            `GradientMap.trusted`.
        descriptors: (k, d). Descriptors of uint8 are strings of bits, compared by Hamming
            distance; descriptors of float32 are vectors, compared by L2 distance.
    """

    positions: Float[Array, "k 2"]
    scales: Float[Array, "k"]
    responses: Float[Array, "k"]
    std_ratios: Float[Array, "k"]
    descriptors: Float[Singles, "k d"] | UInt8[NDArray[np.uint8], "k d"]

    def __len__(self) -> int:
        return len(self.positions)

    def select(self, chosen: Mask | Indices) -> "Features":
        """Return the chosen keypoints.

        Args:
            chosen: A mask (k,) or indices.
        """
        return Features(
            self.positions[chosen],
            self.scales[chosen],
            self.responses[chosen],
            self.std_ratios[chosen],
            self.descriptors[chosen],
        )


def as_vectors(descriptors: Descriptors) -> Float[Singles, "k n"]:
    """Descriptors as vectors; strings of bits become zeros and ones."""
    if descriptors.dtype == np.uint8:
        return np.unpackbits(descriptors.view(np.uint8), axis=1).astype(np.float32)
    return descriptors.astype(np.float32, copy=False)


@dataclass(frozen=True, eq=False)
class Matches:
    """Associations between the keypoints of two maps: the paper's set A.

    Attributes:
        pairs: Indices (m, 2) of the keypoint in the query and in the database.
        distances: Distance between the two descriptors (m,), L2 or the root of the Hamming
            distance.
        query_xy: Positions of the keypoints in the query's frame (m, 2) [m].
        database_xy: Positions of the keypoints in the database's frame (m, 2) [m].
    """

    pairs: Int[Indices, "m 2"]
    distances: Float[Array, "m"]
    query_xy: Float[Array, "m 2"]
    database_xy: Float[Array, "m 2"]

    def __len__(self) -> int:
        return len(self.pairs)


@dataclass(frozen=True)
class Agreement:
    """How well the heights of two maps agree over their overlap, in the compared wavelengths.

    Attributes:
        difference: Standard deviation of the difference of the heights [m], estimated from its
            median, so that single rocks do not count.
        possible: Standard deviation that the uncertainty of both maps can explain [m].
        relief: Standard deviation of the terrain itself [m].
    """

    difference: NotNegative
    possible: NotNegative
    relief: NotNegative


@dataclass(frozen=True, eq=False)
class Registration:
    """The result of registering a pair of maps (Algorithm 1).

    Attributes:
        T_database_query: Motion from the query's frame to the database's; None if no motion was
            found.
        inliers: Which associations agree with the motion (m,). A keypoint counts in one inlier
            at most.
        dissimilarity: The paper's SSD metric h over the overlap [1/m⁴]; infinite if there is none.
        overlap_area: Area of the cells that both maps trust under the motion [m²].
        correlation: Correlation of the two slope fields over that area, in [-1, 1].
        score: How likely the pair is a loop closure. Pairs are ranked by it.
        z_offset: Height to add to the query so that it lies on the database [m].
        covariance: Covariance (3, 3) of the query's x [m], y [m] and yaw [rad] in the database's
            frame, at the overlap's middle; None if it is not known.
        overlap_middle: That middle (x, y) in the database's frame [m]; None if it is not known, and
            the covariance is that at the query's origin.
        z_std: Standard deviation of ``z_offset`` [m]; None if it is not known.
        scale: The scale at which the maps were compared [m]; None if they were not compared.
        agreement: How well the heights agree; None if the overlap is too small.
        nothing_trusted: Whether the variance mask trusts no cell of one of the maps, so that
            the pair cannot be judged.
        evidence: What was added up to give the score: for the inliers, and for each band of
            wavelengths from the shortest. What is below 0 speaks against the motion. Empty if
            the terrain was not compared.
        mean_dissimilarity: The dissimilarity divided by the number of common cells [1/m⁴];
            infinite if there is none.
    """

    T_database_query: SE2 | None
    inliers: Bool[Mask, "m"]
    dissimilarity: float
    overlap_area: float
    correlation: float
    score: float
    z_offset: float = 0.0
    covariance: Float[Array, "3 3"] | None = None
    z_std: float | None = None
    scale: float | None = None
    agreement: Agreement | None = None
    nothing_trusted: bool = False
    evidence: tuple[float, ...] = ()
    mean_dissimilarity: float = math.inf
    overlap_middle: tuple[float, float] | None = None

    @property
    def num_inliers(self) -> int:
        """Number of inliers: the paper's n."""
        return int(np.sum(self.inliers))

    @property
    def position_std(self) -> float | None:
        """Standard deviation [m] of the position in its least certain direction.

        It is that of the overlap's middle, because a frame's origin may lie anywhere.
        """
        if self.covariance is None or not np.isfinite(self.covariance).all():
            return None
        return math.sqrt(max(float(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]), 0.0))

    def covariance_at(self, point: Float[Array, "2"]) -> Float[Array, "3 3"]:
        """The covariance at another point of the query.

        Args:
            point: Where it lies in the query's frame (2,) [m].

        Raises:
            ValueError: If the covariance is not known.
        """
        motion, covariance = self.T_database_query, self.covariance
        if motion is None or covariance is None:
            raise ValueError("the covariance of this registration is not known")
        middle = self.overlap_middle or motion.translation
        return move_covariance(covariance, motion.apply(point[None])[0] - middle)

    @property
    def in_words(self) -> list[tuple[str, str]]:
        """What was found, as names and values."""
        motion = self.T_database_query
        return [
            ("score", score_in_words(self.score)),
            ("inliers", f"{self.num_inliers:,} of {len(self.inliers):,} associations"),
            ("offset", "none found" if motion is None else f"{motion.x:.2f} m, {motion.y:.2f} m"),
            ("turn", "none found" if motion is None else f"{math.degrees(motion.yaw):.1f}°"),
            ("overlap", f"{self.overlap_area:.1f} m²"),
        ]

    def _repr_html_(self) -> str:
        return card("Registration", self.in_words)


ImageSays = Literal["confirmed", "contradicted", "silent"]
"""What images say of a motion."""


@dataclass(frozen=True)
class ImageVerdict:
    """What camera images say of a motion that the terrain found."""

    verdict: ImageSays  # whether they confirm it, contradict it, or are silent
    reason: str  # why, in one line
    num_associations: Associations  # number of associations of the two images that agree best
    num_inliers: Associations  # number of those that fit one geometry of two views


@dataclass(frozen=True)
class Context:
    """What the other pairs of a dataset say about one; see `detection.consistency`.

    Attributes:
        own_score: Score of the pair alone.
        score: Score with what the others say.
        misfit: How many times more the heights differ than they do on one terrain elsewhere in the
            dataset, both relative to the uncertainty of the maps.
        support: What the cycles of closures say: above 0 if others lead to the same motion, below 0
            if better ones lead elsewhere. It is a logarithm to base 10, as the scores are.
        places: Number of places at which motions put one of the two submaps; with more than one,
            the ground repeats.
        variance_factor: How many times larger the variances of the dataset's motions are than
            their registrations say, as its triangles of closures show; at least 1.
    """

    own_score: NotNegative
    score: NotNegative
    misfit: NotNegative
    support: Finite
    places: Count
    variance_factor: NotNegative = 1.0


RefusalKind: TypeAlias = Literal[
    "nothing trusted",
    "no motion",
    "few inliers",
    "dissimilar",
    "dissimilar cells",
    "no common ground",
    "too little ground",
    "heights differ",
    "small overlap",
    "smooth ground",
    "chance",
    "repeated ground",
    "another motion",
    "common mistake",
    "unusual heights",
    "uncertain position",
    "images contradict",
    "images do not confirm",
]


@dataclass(frozen=True)
class Refusal:
    """Why a registration is no loop closure; `detection.verdict` has the words for it."""

    kind: RefusalKind  # the rule that it breaks; of a low score, what explains it
    # what the rule compares, by name
    numbers: Mapping[str, float] = field(default_factory=dict[str, float])
    detail: str = ""  # what images say of it, in one line


@dataclass(frozen=True, eq=False)
class LoopClosure:
    """The verdict on one pair of submaps.

    Attributes:
        query_id: Name of the query submap.
        database_id: Name of the database submap.
        registration: The registration that was judged; its score is the one that counts.
        accepted: Whether the pair is a loop closure.
        reason: Why the pair was accepted or refused, in one line.
        images: What camera images say of the motion; None if they were not asked.
        context: What the other pairs of the dataset say; None if the pair was judged alone.
        undecided: Whether a pair that is not accepted shares too little ground, or too smooth a
            ground, to tell. A file of closures says so in its reason.
        refusal: What `reason` says, as data; None if the pair is accepted, or comes from a file.
        by_hand: Whether a person decided it.
    """

    query_id: str
    database_id: str
    registration: Registration
    accepted: bool
    reason: str
    images: ImageVerdict | None = None
    context: Context | None = None
    undecided: bool = False
    refusal: Refusal | None = None
    by_hand: bool = False

    @property
    def pair(self) -> PairOfIds:
        """Id of the query and of the database."""
        return self.query_id, self.database_id

    @property
    def headline(self) -> str:
        """The verdict in a word or two."""
        if self.registration.nothing_trusted:
            return "Cannot judge"
        verdict = "Loop closure" if self.accepted else "No loop closure"
        return "Undecided" if self.undecided and not self.accepted else verdict

    @property
    def title(self) -> str:
        """The verdict in a few words."""
        return f"{self.headline}: {self.query_id} on {self.database_id}"

    def _repr_html_(self) -> str:
        return card(self.title, self.registration.in_words, note=self.reason)


@runtime_checkable
class LoopDetector(Protocol):
    """A callable that registers a pair of submaps, like the pipeline and all other methods."""

    def __call__(self, query: Submap, database: Submap) -> Registration:
        """Register the query to the database.

        Args:
            query: The submap to be placed.
            database: The submap on which it is placed.
        """
        ...
