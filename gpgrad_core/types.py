"""The vocabulary: frozen, arrays read-only, metres and radians; pixels only inside `Grid`."""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.se2 import SE2, Pose

MAX_GRID_CELLS = 25_000_000
"""More cells than this are refused: four float64 fields of it fill 1 GB."""


def read_only(array: NDArray[np.generic]) -> None:
    """Make an array of a frozen type as frozen as the type."""
    array.flags.writeable = False


@dataclass(frozen=True, eq=False)
class Submap:
    """A gravity-aligned point cloud of the robot's vicinity, in its own local frame.

    Attributes:
        id: Its name: the cloud's file name without the ending.
        points: Positions [m], z up, finite.
        fingerprint: Hash of the points: the root key of all that is made from them.
        pose_true: Where it truly lies in the world, for evaluation and display only.
        pose_odometry: Where the robot believed it lay.
        num_dropped: Rows of the source that were not finite and were left out.
        colors: Red, green and blue of each point in [0, 1], for rivals that use them.
        images: Files of what a camera saw there, for rivals that use them.
        noise_std: Standard deviation of each point's height [m], where the source gives it.
        ranges: Distance that each point was seen from [m], where the source gives it.
    """

    id: str
    points: Float[Array, "n 3"]
    fingerprint: str
    pose_true: Pose | None = None
    pose_odometry: Pose | None = None
    num_dropped: int = 0
    colors: Float[Array, "n 3"] | None = None
    images: tuple[Path, ...] = ()
    noise_std: Float[Array, "n"] | None = None
    ranges: Float[Array, "n"] | None = None

    @classmethod
    def from_points(
        cls,
        points: Float[NDArray[np.floating], "n 3"],
        id: str = "cloud",
        *,
        pose_true: Pose | None = None,
        pose_odometry: Pose | None = None,
        colors: Float[NDArray[np.floating], "n 3"] | None = None,
        noise_std: Float[NDArray[np.floating], "n"] | None = None,
        ranges: Float[NDArray[np.floating], "n"] | None = None,
    ) -> "Submap":
        """Make a submap of points, dropping rows that are not finite.

        Args:
            points: Positions [m], z up.
            id: Its name, which error messages use.
            pose_true: See the class.
            pose_odometry: See the class.
            colors: See the class.
            noise_std: See the class.
            ranges: See the class.

        Raises:
            InputError: If there are fewer than three finite points, all lie on one line, a noise
                is not above zero, or a range is negative.
        """
        rows = np.asarray(points)
        if rows.ndim != 2 or rows.shape[1] != 3:
            raise InputError(f"{id}: points must be an (n, 3) array, got shape {rows.shape}")
        finite = np.isfinite(rows).all(axis=1)
        kept = np.array(rows[finite], dtype=np.float64)
        if len(kept) < 3:
            raise InputError(
                f"{id}: a terrain needs 3 or more finite points, found {len(kept)} "
                f"of {len(rows)}; give a fuller cloud"
            )
        centred = kept[:, :2] - kept[:, :2].mean(axis=0)
        spread = np.linalg.eigvalsh(centred.T @ centred / len(kept))
        if spread[0] <= 1e-12 * max(spread[1], 1e-12):
            raise InputError(
                f"{id}: all {len(kept)} points lie on one line seen from above; "
                "a terrain needs points that span an area"
            )
        read_only(kept)
        digest = hashlib.blake2b(kept.tobytes(), digest_size=16)
        seen = None
        if colors is not None:
            seen = np.array(colors[finite], dtype=np.float64)
            read_only(seen)
            digest.update(seen.tobytes())
        noise = None
        if noise_std is not None:
            noise = np.array(noise_std[finite], dtype=np.float64)
            wrong = np.flatnonzero(~(np.isfinite(noise) & (noise > 0)))
            if len(wrong):
                raise InputError(
                    f"{id}: noise_std must be above 0 m at every point, "
                    f"got {noise[wrong[0]]:g} at point {wrong[0]}"
                )
            read_only(noise)
            digest.update(noise.tobytes())
        seen_from = None
        if ranges is not None:
            seen_from = np.array(ranges[finite], dtype=np.float64)
            wrong = np.flatnonzero(~(np.isfinite(seen_from) & (seen_from >= 0)))
            if len(wrong):
                raise InputError(
                    f"{id}: range must be 0 m or more at every point, "
                    f"got {seen_from[wrong[0]]:g} at point {wrong[0]}"
                )
            read_only(seen_from)
            digest.update(b"ranges" + seen_from.tobytes())
        return cls(
            id,
            kept,
            digest.hexdigest(),
            pose_true,
            pose_odometry,
            num_dropped=int(np.sum(~finite)),
            colors=seen,
            noise_std=noise,
            ranges=seen_from,
        )


@dataclass(frozen=True, eq=False)
class Dataset:
    """Submaps of one or more traverses.

    Attributes:
        name: As shown to people.
        submaps: In the order of their numbers.
        description: What the terrain is, if the dataset says.
        preferred: Parameters that its `dataset.toml` recommends, as nested tables.
        notes: What loading left out or repaired, a line each; show them, nothing is silent.
        licence: Under which others may use it, if the dataset says.
        sensor_noise: Standard deviation of a point at range r [m], as far as the dataset says:
            ``constant`` [m] + ``quadratic`` [1/m] * r².
    """

    name: str
    submaps: tuple[Submap, ...]
    description: str = ""
    preferred: dict[str, object] = field(default_factory=dict[str, object])
    notes: tuple[str, ...] = ()
    licence: str = ""
    sensor_noise: dict[str, float] = field(default_factory=dict[str, float])

    def submap(self, submap_id: str) -> Submap:
        """Find a submap by its id.

        Raises:
            InputError: If there is none of that name.
        """
        for submap in self.submaps:
            if submap.id == submap_id:
                return submap
        raise InputError(f"{self.name} has no submap {submap_id!r}")


@dataclass(frozen=True)
class Grid:
    """A regular grid of cells; the only place where rows and columns meet x and y.

    Row 0 holds the lowest y, column 0 the lowest x.

    Attributes:
        origin: Centre (x, y) of cell (0, 0) [m].
        resolution: Side of a cell [m].
        shape: (rows, columns).
    """

    origin: tuple[float, float]
    resolution: float
    shape: tuple[int, int]

    @classmethod
    def covering(
        cls, points: Float[Array, "n 2"], resolution: float, *, name: str = "the cloud"
    ) -> "Grid":
        """Make the grid over the points' bounding box, as the paper's Sec. VI-B.

        Args:
            points: Positions [m].
            resolution: Side of a cell [m].
            name: What the points are, for the error message.

        Raises:
            InputError: If it would have more than `MAX_GRID_CELLS` cells.
        """
        low, high = points.min(axis=0), points.max(axis=0)
        columns, rows = (int(np.ceil(side / resolution)) + 1 for side in high - low)
        if rows * columns > MAX_GRID_CELLS:
            width, height = high - low
            fitting = np.sqrt(width * height / MAX_GRID_CELLS)
            raise InputError(
                f"{name} spans {width:,.0f} m x {height:,.0f} m: {rows * columns:,} cells at "
                f"{resolution:g} m, more than the {MAX_GRID_CELLS:,} allowed; raise the resolution "
                f"to {np.ceil(fitting * 100) / 100:g} m or more, or cut the cloud into submaps"
            )
        return cls((float(low[0]), float(low[1])), resolution, (rows, columns))

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
    def num_cells(self) -> int:
        """Number of cells."""
        return self.shape[0] * self.shape[1]

    def to_position(self, pixels: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """Turn (column, row), as image libraries give it, into (x, y) [m]."""
        return np.asarray(self.origin) + self.resolution * pixels

    def to_pixel(self, positions: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """Turn (x, y) [m] into fractional (column, row)."""
        return (positions - np.asarray(self.origin)) / self.resolution


@dataclass(frozen=True, eq=False)
class GradientMap:
    """Terrain of one submap on a regular grid; row 0 holds the lowest y."""

    grid: Grid
    elevation: Float[Array, "rows columns"]  # posterior mean [m], Eq. (2)
    variance: Float[Array, "rows columns"]  # posterior variance of it [m²], Eq. (3)
    slope: Float[Array, "rows columns 2"]  # (dz/dx, dz/dy) [m/m], Eqs. (4), (5)
    signal_std: float  # standard deviation of the terrain before any point is seen [m]
    length_scale: float  # distance over which its height stays alike [m]
    gradient: Float[Array, "rows columns"] = field(init=False)  # steepness [m/m]
    std: Float[Array, "rows columns"] = field(init=False)  # of the elevation [m]

    def __post_init__(self) -> None:
        """Derive the image that keypoints are drawn from, once."""
        along_x, along_y = self.slope[..., 0], self.slope[..., 1]
        # A seventh of the time of np.hypot, whose care for huge numbers no slope needs.
        object.__setattr__(self, "gradient", np.sqrt(along_x * along_x + along_y * along_y))
        object.__setattr__(self, "std", np.sqrt(self.variance))
        for field_of_grid in (
            self.elevation,
            self.variance,
            self.slope,
            self.gradient,
            self.std,
        ):
            read_only(field_of_grid)

    def trusted(self, max_std_ratio: float) -> Bool[NDArray[np.bool_], "rows columns"]:
        """Say which cells lie close enough to points: std / signal_std <= max_std_ratio.

        The ratio is in (0, 1], so one value means the same on every dataset.
        """
        return self.std <= max_std_ratio * self.signal_std


@dataclass(frozen=True, eq=False)
class Features:
    """Keypoints of one gradient map."""

    positions: Float[Array, "k 2"]  # [m]
    scales: Float[Array, "k"]  # diameter of the neighbourhood described [m]
    responses: Float[Array, "k"]  # strength, as the detector has it
    std_ratios: Float[Array, "k"]  # std / signal_std of the map there
    descriptors: Float[NDArray[np.float32], "k d"] | UInt8[NDArray[np.uint8], "k d"]
    # uint8 descriptors are strings of bits (Hamming), float32 ones vectors (L2)

    def __len__(self) -> int:
        """Number of keypoints."""
        return len(self.positions)

    def select(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> "Features":
        """Keep some keypoints, by mask or by index."""
        return Features(
            self.positions[chosen],
            self.scales[chosen],
            self.responses[chosen],
            self.std_ratios[chosen],
            self.descriptors[chosen],
        )


@dataclass(frozen=True, eq=False)
class Matches:
    """Associations between the keypoints of two maps: the paper's set A."""

    pairs: Int[NDArray[np.intp], "m 2"]  # indices (query, database)
    distances: Float[Array, "m"]  # between descriptors
    query_xy: Float[Array, "m 2"]  # [m], query frame
    database_xy: Float[Array, "m 2"]  # [m], database frame

    def __len__(self) -> int:
        """Number of associations."""
        return len(self.pairs)


@dataclass(frozen=True, eq=False)
class Registration:
    """What Algorithm 1 found for a pair of maps.

    Attributes:
        T_database_query: Maps the query's frame into the database's; None where no motion
            was supported by two associations.
        inliers: Which associations agree with it, one to one.
        dissimilarity: The paper's SSD metric h over the overlap.
        overlap_area: Trusted area that both maps share under it [m²].
        correlation: Of the two slope fields over that area, in [-1, 1].
        score: How likely the pair is a loop closure; what ranking uses.
        z_offset: What is to be added to the query's heights to lie on the database [m].
        covariance: Of x [m], y [m] and yaw [rad] of the motion; None where it is not known.
    """

    T_database_query: SE2 | None
    inliers: Bool[NDArray[np.bool_], "m"]
    dissimilarity: float
    overlap_area: float
    correlation: float
    score: float
    z_offset: float = 0.0
    covariance: Float[Array, "3 3"] | None = None

    @property
    def num_inliers(self) -> int:
        """The paper's n."""
        return int(np.sum(self.inliers))


@dataclass(frozen=True, eq=False)
class LoopClosure:
    """The verdict on one pair of submaps, and why."""

    query_id: str
    database_id: str
    registration: Registration
    accepted: bool
    reason: str


@runtime_checkable
class LoopDetector(Protocol):
    """Any way of registering a pair of submaps: the pipeline, and every baseline."""

    def __call__(self, query: Submap, database: Submap) -> Registration:
        """Register the query to the database."""
        ...


FieldName = Literal["elevation", "std", "gradient", "slope_x", "slope_y"]
