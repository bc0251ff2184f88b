"""Finds submaps on a larger elevation model, such as one that was made from orbit or from a drone.

Windows of the model become gradient maps, to which the pipeline registers submaps (locate.md).
"""

from collections.abc import Collection, Generator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from math import ceil, hypot, log10
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core import __version__
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection import ExtractedSubmap, MapDetector, PipelineParams, resolve_parameters
from gpgrad_core.detection.verdict import classify
from gpgrad_core.errors import InputError
from gpgrad_core.ground import submap_of_cloud
from gpgrad_core.io.clouds import voxel_means
from gpgrad_core.io.folder import index_of
from gpgrad_core.io.poses import read_poses
from gpgrad_core.io.rasters import Elevations
from gpgrad_core.io.records.closures import rounded, row_of
from gpgrad_core.io.records.files import write_json
from gpgrad_core.mapping.fitting import representative
from gpgrad_core.params import bounds_of
from gpgrad_core.registration import RegistrationParams
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import side_by_side
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import Dataset, LoopClosure, Registration, Submap

CELLS_A_VOXEL = 0.25
"""Side of the voxels of merged submaps [cells of the model]."""
CELLS_A_SCALE = 1.5
"""Smallest scale of comparison [cells of the model]; a Gaussian so wide leaves no waves that the
cells cannot hold."""
SCALE_IN_CELLS = 8.0
"""The scale of comparison is about this many cells of a gradient map, as on submaps."""
WIDTH = 2.0
"""Side of a window [widths of a submap]; neighbouring ones share a submap's width."""
MIN_HEIGHTS = 100
"""Windows with fewer known heights show no place."""
MOST_WINDOWS = 20_000
"""They take about an hour on two cores."""
WINDOWS_A_JOB = 4
QUERIES_TOGETHER = 32
"""Number of submaps that are compared with a window when it is made; for more, it is made again."""
SAME_PLACE = 0.5
"""Two motions within this share of a submap's width put it at the same place."""

LEAST_NOISE = 0.005
"""Smallest fitted noise of a model, relative to its signal. Interpolated models seem to have none,
and the GP of a window would not converge."""
MOST_SHOWN = 2_000_000
"""Largest number of the model's heights in the dataset that shows the places."""


@dataclass(frozen=True, eq=False)
class Window:
    """A part of the model."""

    name: str  # its number from the west and from the south
    # heights (rows, columns) [m], row 0 in the south; NaN where there is none
    heights: Float[NDArray[np.floating], "rows columns"]
    cell: tuple[float, float]  # width and height of a cell [m]
    middle: tuple[float, float]  # easting and northing of its middle [m]: the origin of its frame

    def load(self) -> Submap:
        """Its valid heights as points around its middle."""
        rows, columns = self.heights.shape
        x = (np.arange(columns) - 0.5 * (columns - 1)) * self.cell[0]
        y = (np.arange(rows) - 0.5 * (rows - 1)) * self.cell[1]
        measured = np.isfinite(self.heights)
        points = np.stack([*np.meshgrid(x, y), self.heights], axis=-1)[measured]
        return submap_of_cloud(points.astype(np.float64), self.name, ground="all")


@dataclass(frozen=True, eq=False)
class Location:
    """Where a submap was found on the model."""

    # The registration to the best window, in the model's coordinates, and the verdict on it. Its
    # score is that of the pair, less the logarithm of the number of windows: with more places to
    # choose from, chance finds a better one.
    verdict: LoopClosure
    pose: Pose | None  # ``T_model_submap``: easting, northing, height [m]; None without a motion
    runner_up: float  # score of the best other place; if it is close, the ground has look-alikes


def cut_windows(
    model: Elevations, width: float, near: tuple[float, float, float] | None = None
) -> list[Window]:
    """Cut a model into windows with some heights, so that one holds everything of this width [m].

    `near` is easting, northing and radius [m] of a circle that they reach.
    """
    sides = [_starts(n, cell, width) for n, cell in zip(model.heights.shape[::-1], model.cell,
                                                        strict=True)]  # fmt: skip
    (lefts, columns), (lows, rows) = sides
    chosen: list[Window] = []
    for j, low in enumerate(lows):
        for i, left in enumerate(lefts):
            heights = model.heights[low : low + rows, left : left + columns]
            middle = tuple(
                corner + cell * (start + 0.5 * (n - 1))
                for corner, cell, start, n in zip(
                    model.corner, model.cell, (left, low), heights.shape[::-1], strict=True
                )
            )
            half = [0.5 * n * cell for n, cell in zip(heights.shape[::-1], model.cell, strict=True)]
            if near is not None and not _reaches(middle, half, near):
                continue
            if np.count_nonzero(np.isfinite(heights)) >= MIN_HEIGHTS:
                chosen.append(Window(f"{i},{j}", heights, model.cell, (middle[0], middle[1])))
    if len(chosen) > MOST_WINDOWS:
        raise InputError(
            f"the model has {len(chosen):,} windows of {WIDTH * width:.0f} m to search, at most "
            f"{MOST_WINDOWS:,} are; crop it, or say where to search: --near E,N,RADIUS"
        )
    if not chosen:
        where = "" if near is None else f" within {near[2]:g} m of {near[0]:g}, {near[1]:g}"
        raise InputError(
            f"the model has no {MIN_HEIGHTS} heights together{where}; it reaches from "
            f"{model.corner[0]:.10g}, {model.corner[1]:.10g} to {_far_corner(model)}"
        )
    return chosen


def _far_corner(model: Elevations) -> str:
    rows, columns = model.heights.shape
    east = model.corner[0] + columns * model.cell[0]
    return f"{east:.10g}, {model.corner[1] + rows * model.cell[1]:.10g}"


def _starts(count: int, cell: float, width: float) -> tuple[list[int], int]:
    """The first cells of the windows along one side, and how many cells they have."""
    size = min(count, ceil(WIDTH * width / cell))
    step = max(1, size - ceil(width / cell))
    return [*range(0, max(count - size, 0), step), count - size], size


def _reaches(
    middle: Sequence[float], half: Sequence[float], near: tuple[float, float, float]
) -> bool:
    off = [max(abs(near[k] - middle[k]) - half[k], 0.0) for k in range(2)]
    return hypot(*off) <= near[2]


def width_of(submap: Submap) -> float:
    """Compute the width of a submap: twice the radius around its middle that holds its points."""
    low, high = submap.points[:, :2].min(axis=0), submap.points[:, :2].max(axis=0)
    return 2 * float(np.linalg.norm(submap.points[:, :2] - (low + high) / 2, axis=1).max())


def merge_submaps(submaps: Sequence[Submap], poses: Sequence[Pose], voxel: float) -> Submap:
    """Join submaps by ``T_world_submap`` in the first one's level frame, thinned by voxels [m]."""
    first = Pose.from_planar(poses[0].planar, float(poses[0].translation[2])).inverse()
    joined = [
        (first @ pose).apply(submap.points) for submap, pose in zip(submaps, poses, strict=True)
    ]
    return submap_of_cloud(voxel_means(np.concatenate(joined), voxel), "merged_000", ground="all")


def parameters_for(
    submaps: Sequence[Submap],
    windows: Sequence[Window],
    cell: float,
    requested: PipelineParams | None = None,
    noise_std: float | None = None,
    progress: Progress = silent,
) -> tuple[PipelineParams, PipelineParams]:
    """Choose the parameters of submaps and windows, with one scale of comparison for both."""
    requested = requested or PipelineParams()
    query_params = resolve_parameters(submaps, requested, progress=part(progress, 0.0, 0.5))
    most = sorted(windows, key=lambda window: -int(np.count_nonzero(np.isfinite(window.heights))))
    full = most[: max(1, len(most) // 2)]
    some = [full[k].load() for k in representative(len(full))]
    alone = PipelineParams(map=replace(PipelineParams().map, noise_std=noise_std))
    with _of_the_model():
        model_map = resolve_parameters(some, alone, progress=part(progress, 0.5, 1.0)).map
    fitted, signal = model_map.noise_std or 0.0, model_map.signal_std or 0.0
    if noise_std is None and fitted < LEAST_NOISE * signal:
        model_map = replace(model_map, noise_std=LEAST_NOISE * signal)
    scales = [one.scale for one in (query_params.map, model_map) if one.scale is not None]
    scale = (
        max(*scales, CELLS_A_SCALE * cell) if requested.map.scale is None else requested.map.scale
    )
    bounds = bounds_of(type(query_params.map))
    scale = min(scale, bounds["scale"].high)
    fine = max(query_params.map.resolution, scale / SCALE_IN_CELLS)
    both = {"scale": scale, "resolution": min(fine, bounds["resolution"].high)}
    radius = requested.registration.radius(scale)
    limit = bounds_of(RegistrationParams)["inlier_radius"].high
    registration = replace(requested.registration, inlier_radius=min(radius, limit))
    query_params = replace(query_params, registration=registration)
    return (
        replace(query_params, map=replace(query_params.map, **both)),
        replace(query_params, map=replace(model_map, **both)),
    )


def locate(
    submaps: Sequence[Submap],
    windows: Sequence[Window],
    params: tuple[PipelineParams, PipelineParams],
    *,
    nearby: Sequence[Collection[str]] | None = None,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> list[Location]:
    """Find submaps on the windows of a model; `nearby` names those for each submap."""
    locations: list[Location] = []
    names = [window.name for window in windows]
    every = [frozenset(names if nearby is None else nearby[k]) for k in range(len(submaps))]
    for first in range(0, len(submaps), QUERIES_TOGETHER):
        some = submaps[first : first + QUERIES_TOGETHER]
        low, high = first / len(submaps), (first + len(some)) / len(submaps)
        report = part(progress, low, high)
        extract = partial(_extract, params[0])
        extracted = side_by_side(extract, list(some), executor, part(report, 0.0, 0.1))
        candidates = every[first : first + QUERIES_TOGETHER]
        needed = frozenset[str]().union(*candidates)
        searched = [window for window in windows if window.name in needed]
        jobs = [searched[k : k + WINDOWS_A_JOB] for k in range(0, len(searched), WINDOWS_A_JOB)]
        compare = partial(_compare, params[1], extracted, candidates)
        compared = side_by_side(compare, jobs, executor, part(report, 0.1, 1.0))
        rows = [row for block in compared for row in block]
        for k, submap in enumerate(some):
            matches = [
                (registration, window)
                for window, row in zip(searched, rows, strict=True)
                if (registration := row[k]) is not None
            ]
            locations.append(_best(submap, matches, params[0]))
    return locations


@contextmanager
def _of_the_model() -> Generator[None]:
    """Let an error of a window's map name what changes its noise, which no map's parameter does."""
    try:
        yield
    except InputError as error:
        noise = "the model's noise (--map-noise, with --anchor it is --anchor-std)"
        raise type(error)(str(error).replace("noise_std", noise)) from None


def _extract(params: PipelineParams, submap: Submap, progress: Progress) -> ExtractedSubmap:
    detector = MapDetector(params, Memo())
    return detector.extract(detector.infer(submap, progress))


def _compare(
    params: PipelineParams,
    queries: Sequence[ExtractedSubmap],
    candidates: Sequence[frozenset[str]],
    windows: Sequence[Window],
    progress: Progress,
) -> list[list[Registration | None]]:
    """Make the maps of some windows, and register to each the queries that want it, by name."""
    rows: list[list[Registration | None]] = []
    for k, window in enumerate(windows):
        detector = MapDetector(params, Memo())
        with _of_the_model():
            extracted = detector.extract(detector.infer(window.load()))
        row: list[Registration | None] = []
        for query, names in zip(queries, candidates, strict=True):
            row.append(detector.compare(query, extracted) if window.name in names else None)
            progress((k + len(row) / len(queries)) / len(windows))
        rows.append(row)
    return rows


def _best(
    submap: Submap, matches: Sequence[tuple[Registration, Window]], params: PipelineParams
) -> Location:
    """Choose the best window, and judge it as the best of all."""
    tries = log10(len(matches))
    placed = [
        replace(_on_model(registration, window), score=max(0.0, registration.score - tries))
        for registration, window in matches
    ]
    first = max(range(len(placed)), key=lambda k: placed[k].score)
    best = placed[first]
    verdict = classify(best, params.closure, query_id=submap.id, database_id=matches[first][1].name)
    motion = best.T_database_query
    if motion is None:
        return Location(verdict, None, 0.0)
    middle = submap.points[:, :2].mean(axis=0)[None]
    apart = SAME_PLACE * width_of(submap)
    others = (
        registration.score
        for registration in placed
        if registration.T_database_query is not None
        and np.linalg.norm(registration.T_database_query.apply(middle) - motion.apply(middle))
        > apart
    )
    pose = Pose.from_planar(motion, best.z_offset)
    return Location(verdict, pose, max(others, default=0.0))


def _on_model(registration: Registration, window: Window) -> Registration:
    """Transform a registration from the window's coordinates to the model's."""
    motion = registration.T_database_query
    if motion is None:
        return registration
    middle = registration.overlap_middle
    if middle is not None:
        middle = middle[0] + window.middle[0], middle[1] + window.middle[1]
    placed = SE2(*window.middle) @ motion
    return replace(registration, T_database_query=placed, overlap_middle=middle)


def spread(location: Location) -> Float[Array, "2"] | None:
    """The standard deviations along the axes of the position's ellipse [m], if known."""
    covariance = location.verdict.registration.covariance
    if covariance is None or not np.isfinite(covariance).all():
        return None
    return np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[:2, :2]), 0.0))


@dataclass(frozen=True, eq=False)
class Search:
    """What is sought of a dataset, and where on an elevation model."""

    dataset: Dataset
    model: Elevations
    name: str  # of the model's file
    submaps: Sequence[Submap]  # the dataset's, or one of them all
    windows: Sequence[Window]

    @classmethod
    def of(
        cls,
        dataset: Dataset,
        model: Elevations,
        name: str,
        *,
        merged: bool = False,
        poses: Path | None = None,
        near: tuple[float, float, float] | None = None,
    ) -> "Search":
        """Seek each submap, or the traverse as one, joined by odometry or by a file of poses."""
        submaps = list(dataset.submaps)
        if merged:
            joined = _poses_of(dataset, poses)
            submaps = [merge_submaps(submaps, joined, CELLS_A_VOXEL * max(model.cell))]
        windows = cut_windows(model, max(map(width_of, submaps)), near)
        return cls(dataset, model, name, submaps, windows)

    def fit(
        self,
        requested: PipelineParams | None = None,
        noise_std: float | None = None,
        progress: Progress = silent,
    ) -> tuple[PipelineParams, PipelineParams]:
        """Choose the parameters, as `parameters_for` does."""
        cell = max(self.model.cell)
        return parameters_for(self.submaps, self.windows, cell, requested, noise_std, progress)

    def run(
        self,
        params: tuple[PipelineParams, PipelineParams],
        *,
        executor: Executor | None = None,
        progress: Progress = silent,
    ) -> "Located":
        places = locate(self.submaps, self.windows, params, executor=executor, progress=progress)
        return Located(**vars(self), places=places, params=params)


def _poses_of(dataset: Dataset, path: Path | None) -> list[Pose]:
    numbers = {submap.id: index_of(submap.id) for submap in dataset.submaps}
    names = {number: name for name, number in numbers.items() if number is not None}
    read = {} if path is None else read_poses(path, names)
    poses: list[Pose] = []
    for submap in dataset.submaps:
        number = numbers[submap.id]
        named = None if number is None else read.get(number)
        pose = submap.pose_odometry if path is None else named
        if pose is None:
            raise InputError(
                f"{path or dataset.name}: has no pose of submap {submap.id}, and the traverse "
                "is joined by its poses; add it, or find each submap alone, without --merged"
            )
        poses.append(pose)
    return poses


@dataclass(frozen=True, eq=False)
class Located(Search):
    """Where the submaps of a dataset, or its whole traverse, lie on an elevation model."""

    places: Sequence[Location]  # of each submap
    params: tuple[PipelineParams, PipelineParams]  # of the submaps, and of the windows

    @property
    def accepted(self) -> list[Location]:
        return [place for place in self.places if place.verdict.accepted]

    @property
    def precision(self) -> str:
        """The median standard deviation in the worst direction, in words; empty if unknown."""
        stds = [std.max() for std in map(spread, self.accepted) if std is not None]
        return f", to {np.median(stds):.2g} m (standard deviation)" if stds else ""

    def write(self, path: Path) -> None:
        """Write ``located.json``, whole or not at all; an empty system is unknown."""
        content = {
            "gpgrad": __version__,
            "dataset": self.dataset.name,
            "map": self.name,
            "system": self.model.system,
            "num_windows": len(self.windows),
            "parameters": asdict(self.params[0]),
            "parameters_of_map": asdict(self.params[1].map),
            "submaps": [_row(place) for place in self.places],
        }
        write_json(path, content)

    def shown(self) -> Dataset:
        """Make a dataset of the accepted submaps at their places; the model around is the last."""
        dataset = self.dataset
        placed = [
            submap_of_cloud(submap.points, submap.id, pose_odometry=place.pose,
                            colors=submap.colors, noise_std=submap.noise_std, ranges=submap.ranges,
                            ground="all")
            for submap, place in zip(self.submaps, self.places, strict=True)
            if place.verdict.accepted
        ]  # fmt: skip
        around = max(map(width_of, self.submaps))
        where = [
            submap.pose_odometry.apply(submap.centre[None])[0, :2]
            for submap in placed
            if submap.pose_odometry is not None
        ]
        ground = _around(self.model, np.array(where), around) if where else None
        numbers = [n for n in (index_of(submap.id) for submap in placed) if n is not None]
        query_map, model_map = self.params[0].map, self.params[1].map
        chosen = {"scale": query_map.scale, "resolution": query_map.resolution} | {
            key: max(getattr(query_map, key), getattr(model_map, key))
            for key in ("length_scale", "noise_std")
        }
        preferred: dict[str, object] = {"map": chosen}
        if ground is not None:
            title = f"map_{max(numbers, default=0) + 1:03d}"
            pose = Pose.from_planar(SE2(*ground.middle))
            placed.append(
                submap_of_cloud(ground.load().points, title, pose_odometry=pose, ground="all")
            )
            preferred |= {"query": placed[0].id, "database": placed[-1].id}
        return Dataset(
            f"{dataset.name} on {self.name}",
            tuple(placed),
            description=f"Submaps of {dataset.name} where they were found on {self.name}.",
            preferred=preferred,
            licence=dataset.licence,
        )


def _row(place: Location) -> dict[str, object]:
    pair, pose = row_of(rounded(place.verdict)), place.pose
    return {
        "submap": pair["query"],
        "accepted": pair["accepted"],
        "reason": pair["reason"],
        "score": pair["score"],
        "runner_up": place.runner_up,
        "T_map_submap": None
        if pose is None
        else dict(zip("xyz", pose.translation.tolist(), strict=True)) | {"yaw": pose.planar.yaw},
        "covariance": pair["covariance"],
        "overlap_middle": pair.get("overlap_middle"),
        "z_std": pair["z_std"],
        "num_inliers": pair["num_inliers"],
        "overlap_area": pair["overlap_area"],
        "scale": pair["scale"],
    }


def _around(model: Elevations, where: Float[Array, "n 2"], margin: float) -> Window:
    """Cut out the model around places (n, 2) [m], every n-th height if there are too many."""
    size = np.array(model.heights.shape[::-1])
    low = np.floor((where.min(axis=0) - margin - model.corner) / model.cell)
    high = np.ceil((where.max(axis=0) + margin - model.corner) / model.cell) + 1
    (left, down), (right, up) = (
        np.clip(corner_cell, 0, size).astype(int) for corner_cell in (low, high)
    )
    heights = model.heights[down:up, left:right]
    every = max(1, int(np.ceil(np.sqrt(heights.size / MOST_SHOWN))))
    heights = heights[::every, ::every]
    cell = (model.cell[0] * every, model.cell[1] * every)
    middle = [
        corner + old * start + 0.5 * new * (count - 1)
        for corner, old, new, start, count in zip(
            model.corner, model.cell, cell, (left, down), heights.shape[::-1], strict=True
        )
    ]
    return Window("around", heights, cell, (float(middle[0]), float(middle[1])))
