"""Anchors a solved traverse on an elevation model: a GeoTIFF of the ground, such as one from orbit.

A *place* is where a submap was found on it, by the stages that find loop closures; its *surface*
gives heights and tilts. Both depend on the poses, so the graph is solved in a few rounds.
"""

from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float, Integer
from scipy import ndimage
from scipy.spatial.transform import Rotation
from typing_extensions import Doc

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError, count
from gpgrad_core.ground import submap_of_cloud
from gpgrad_core.io.folder import Outline
from gpgrad_core.io.rasters import Elevations
from gpgrad_core.locating import Location, Window, cut_windows, locate, parameters_for, width_of
from gpgrad_core.mapping.fitting import representative
from gpgrad_core.params import Bounds, check_bounds
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam.errors import positions
from gpgrad_core.slam.graph import Anchor, PoseGraph
from gpgrad_core.slam.optimise import (
    OptimisedGraph,
    SolverParams,
    centres_of,
    measure_pose_covariances,
    optimise_pose_graph,
    shifted_rows,
)
from gpgrad_core.types import Submap

LOOSENED = (8.0, 4.0, 2.0, 1.0, 1.0, 1.0, 1.0)
"""By how much the model's error is enlarged in each round of solving and looking up; refusals wait
for the last ones. The surface is not plane: trusted too early, it holds a submap on the wrong side
of a ridge."""
CONVERGED = 0.02
"""The rounds end when no submap moved by more [m]."""
FEWEST_ACROSS = 12.0
"""Cells of the model across a submap from which on places are searched; fewer do not identify
it."""
FEWEST_FOR_TILT = 6
"""Cells under a submap from which on they give its tilt."""
INDEPENDENT = 4.0
"""So many cells under a submap count as independent at most: a model's errors are smooth."""
OWN_STD, OWN_TILT_STD = 0.01, 0.003
"""Standard deviation of the height [m] and the tilt [rad] of a submap's own ground."""
LEAST_STD = 0.01
"""Smallest standard deviation of a model's heights that is estimated [m]."""
MOST_TAKEN = 0.9
"""Largest share of a model's error that the heights are taken to follow."""
SPLINE_REACH = 12
"""Cells beyond which a cubic spline forgets: its influence falls to a quarter from cell to cell."""
ACROSS = 24
"""A submap's ground is reduced to the means of about so many squares across."""
SEARCH_STDS = 3.0
"""Places are searched so many standard deviations around the estimate."""
FIRST_HEIGHT_STD = 10.0
"""Standard deviation of the heights before the surface is looked up [m]."""
PLACE_FLOOR = 0.08
"""Standard deviation of a place beyond its registration's [cells]: neighbouring cells share half of
a model's error, and a registration takes errors to be independent."""


@dataclass(frozen=True)
class AnchorParams:
    """How well it is known where the drive starts on the model."""

    start_std: Annotated[
        float,
        Bounds(0.001, 10_000.0, 0.1, "m", slider=(0.1, 20.0)),
        Doc("Standard deviation of the place where the drive starts, along each axis."),
    ] = 1.0
    start_yaw_std: Annotated[
        float,
        Bounds(0.0001, 3.2, 0.001, "rad", slider=(0.001, 0.2)),
        Doc("Standard deviation of the heading with which the drive starts."),
    ] = 0.02

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, eq=False)
class AnchorModel:
    """An elevation model in the frame of the map to be made."""

    name: str  # of its file
    elevations: Elevations  # its heights, with the corner in the map's frame
    origin: tuple[float, float]  # easting, northing of the map's origin [m]; axes are the model's
    std: float | None = None  # standard deviation of the heights [m]; None if it is not known
    start: SE2 | None = None  # where the first submap is in the map's frame; None: to be found
    params: AnchorParams = AnchorParams()  # how well that is known

    @property
    def cell(self) -> float:
        """The longer side of a cell [m]."""
        return max(self.elevations.cell)

    def heights(self, places: Float[Array, "n 2"]) -> Float[Array, "n"]:
        """Interpolate the heights [m] at places (n, 2) [m] by a cubic spline; NaN beside gaps."""
        cells = ((places - self.elevations.corner) / self.elevations.cell)[:, ::-1]
        # What lies so far away does not change a cubic spline.
        low = np.maximum(np.floor(cells.min(axis=0)).astype(int) - SPLINE_REACH, 0)
        high = np.ceil(cells.max(axis=0)).astype(int) + SPLINE_REACH + 1
        heights = self.elevations.heights[low[0] : max(high[0], 0), low[1] : max(high[1], 0)]
        finite = np.isfinite(heights)
        if not finite.any():
            return np.full(len(places), np.nan)
        if not finite.all():
            nearest = ndimage.distance_transform_edt(
                ~finite, return_distances=False, return_indices=True
            )
            heights = heights[tuple(nearest)]
        at = (cells - low).T
        interpolated = ndimage.map_coordinates(heights, at, np.float64, order=3, mode="mirror")
        # Linear interpolation, because it asks the cells around alone.
        beside = ndimage.map_coordinates(finite.astype(float), at, order=1, cval=0.0)
        return np.where(beside > 1 - 1e-6, interpolated, np.nan)


@dataclass(frozen=True, eq=False)
class ThinnedGround:
    """A submap's ground, thinned: means (n, 3) [m] in its frame; and its width [m]."""

    points: Float[Array, "n 3"]
    width: float

    @property
    def middle(self) -> Float[Array, "3"]:
        return self.points.mean(axis=0)


@dataclass(frozen=True, eq=False)
class Lookup:
    """What the model says of the ground under a submap at one pose."""

    offset: float  # how much higher the model is, on average [m]
    # how much the submap's ground rises above the model's for each unit of the pose's x, y, z [m]
    # and turn about x, y, z [rad]
    by_pose: Float[Array, "6"]
    slopes: Float[Array, "2"] | None  # of the difference along x and y; None: too few cells
    slopes_shape: Float[Array, "2 2"]  # covariance of the slopes for heights of variance 1 [1/m²]
    arm: Float[Array, "2"]  # from the submap's centre to where the offset is measured [m]
    unseen: float  # variance of what the model's cells, and planes through them, cannot hold [m²]


@dataclass(frozen=True, eq=False)
class Anchored:
    """A graph that is anchored on an elevation model."""

    model: AnchorModel
    graph: PoseGraph  # with its anchors; its poses are those of odometry, in the model's frame
    result: OptimisedGraph
    std: float  # standard deviation of the model's heights [m], as stated or as estimated
    outside: tuple[str, ...]  # ids of the submaps without a height of the model under them

    def count(self, kind: str) -> tuple[int, int]:
        """Count the anchors of a kind that were used, and those that were refused."""
        used = [fit.weight >= 0.5 for fit in self.result.anchors if fit.anchor.kind == kind]
        return sum(used), len(used) - sum(used)

    def __str__(self) -> str:
        """What fixes the map to the model, in words."""
        surfaces, wrong = self.count("surface")
        places, refused = self.count("place")
        stated = "as stated" if self.model.std is not None else "estimated"
        return (
            f"anchored on {self.model.name}: {count(surfaces, 'height')} of its surface and "
            f"{count(places, 'place')} used, {wrong + refused} refused as wrong; error of its "
            f"heights {self.std:.2g} m, {stated}"
        )

    @property
    def outside_note(self) -> str:
        """Which submaps have no height of the model under them, in a line."""
        names, total = self.outside, len(self.graph.poses)
        which = ", ".join(names[:5]) + (", …" if len(names) > 5 else "")
        return (
            f"{self.model.name}: has no height under {len(names)} of {count(total, 'submap')} "
            f"({which}); odometry and closures alone hold these"
        )


def thin_ground(submap: Submap, cell: float) -> ThinnedGround:
    """Thin a submap's ground for a model with cells of this side [m]."""
    width = width_of(submap)
    size = min(width / ACROSS, cell / 2)
    squares = np.floor(submap.points[:, :2] / size).astype(np.int64)
    _, owner, counts = np.unique(squares, axis=0, return_inverse=True, return_counts=True)
    sums = [np.bincount(owner.ravel(), submap.points[:, axis]) for axis in range(3)]
    return ThinnedGround(np.column_stack(sums) / counts[:, None], width)


def look_up(
    model: AnchorModel, ground: ThinnedGround, pose: Pose, covariance: Float[Array, "2 2"]
) -> Lookup | None:
    """Compare a submap's ground at its pose with the model's cells, like with like.

    The submap's heights are averaged over each cell and compared with the model at the mean of
    their places, which is the cell's own height where the submap covers the cell. On a slope, the
    height tells of the place too. So the slope is that between points as far away as the submap may
    be by the covariance (2, 2) [m²] of the pose's x and y, and what a plane cannot hold is noise.
    It gives None if the model has no height there.
    """
    points = pose.apply(ground.points)
    cells = np.round((points[:, :2] - model.elevations.corner) / model.elevations.cell)
    _, owner, counts = np.unique(
        cells.astype(np.int64), axis=0, return_inverse=True, return_counts=True
    )
    means = np.column_stack(
        [np.bincount(owner.ravel(), points[:, axis]) for axis in range(3)]
    ) / counts[:, None]  # fmt: skip
    there = model.heights(means[:, :2])
    finite = np.isfinite(there)
    if counts[finite].sum() < 0.5 * counts.sum():
        return None
    means, there, weight = means[finite], there[finite], counts[finite] / counts[finite].sum()
    above, middle = there - means[:, 2], (weight @ means)[:2]
    offset = float(weight @ above)
    way = means[:, :2] - middle
    spread = (way * weight[:, None]).T @ way
    slopes, shape = None, np.eye(2)
    if len(above) >= FEWEST_FOR_TILT and np.linalg.eigvalsh(spread)[0] > (model.cell / 2) ** 2:
        shape = np.linalg.inv(spread)
        slopes = shape @ (way * weight[:, None]).T @ (above - offset)
        shape = shape / INDEPENDENT
    variances, axes = np.linalg.eigh(covariance)
    fall, unseen = np.zeros(2), 0.0
    for variance, axis in zip(variances, axes.T, strict=True):
        reach = max(float(np.sqrt(max(variance, 0.0))), 0.5 * model.cell)
        moved = [model.heights(means[:, :2] + step * axis) for step in (-reach, reach)]
        ends = [float(weight @ np.where(np.isfinite(end), end, there)) for end in moved]
        fall += axis * (ends[1] - ends[0]) / (2 * reach)
        bend = (ends[1] + ends[0] - 2 * float(weight @ there)) / reach**2
        # Of a parabola over a normal distribution; and an eighth of it between two cells.
        unseen += 0.75 * (bend * variance) ** 2
        unseen += (bend * model.cell**2 / 8) ** 2 / len(above)
    unseen += _relief_within(points, owner.ravel(), counts, ground.width, model.cell)
    arm = middle - pose.translation[:2]
    by_yaw = float(fall @ np.array([arm[1], -arm[0]]))
    by_pose = np.array([-fall[0], -fall[1], 1.0, arm[1], -arm[0], by_yaw])
    return Lookup(offset, by_pose, slopes, shape, arm, unseen)


def _relief_within(
    points: Float[Array, "n 3"],
    owner: Integer[NDArray[np.integer], "n"],
    counts: Integer[NDArray[np.integer], "cells"],
    width: float,
    cell: float,
) -> float:
    """Measure the variance of a submap's mean height [m²] by relief within these cells."""
    columns = np.column_stack([np.ones(len(points)), points[:, :2] - points[:, :2].mean(axis=0)])
    left = points[:, 2] - columns @ np.linalg.lstsq(columns, points[:, 2], rcond=None)[0]
    if 2 * cell < width:
        left = left - (np.bincount(owner, left) / counts)[owner]
    return float(np.mean(left**2)) / max(1.0, (width / cell) ** 2)


def surface_anchor(name: str, lookup: Lookup, pose: Pose, std: float, shared: float) -> Anchor:
    """Make an anchor of the model under a submap."""
    variance = OWN_STD**2 + shared * std**2 + lookup.unseen
    information = np.outer(lookup.by_pose, lookup.by_pose) / variance
    turn = Rotation.identity()
    lift = lookup.offset
    if lookup.slopes is not None:
        # The slope along y is a turn about x, and that along x one against y.
        by_slopes = np.array([[0.0, 0.0, 0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
        noise = shared * std**2 * lookup.slopes_shape + OWN_TILT_STD**2 * np.eye(2)
        information = information + by_slopes.T @ np.linalg.inv(noise) @ by_slopes
        turn = Rotation.from_rotvec([lookup.slopes[1], -lookup.slopes[0], 0.0])
        lift -= float(lookup.slopes @ lookup.arm)
    measured = Pose(
        pose.translation + np.array([0.0, 0.0, lift]),
        (turn * Rotation.from_quat(pose.quaternion)).as_quat(canonical=True),
    )
    return Anchor(name, "surface", measured, _in_submap(information, measured))


def place_anchor(
    location: Location, cell: float, pose: Pose, kind: Literal["place", "start"] = "place"
) -> Anchor:
    """Make an anchor of where a submap was found; its height is left to the model's surface."""
    registration, located = location.verdict.registration, location.pose
    assert located is not None
    assert registration.covariance is not None
    covariance = registration.covariance_at(np.zeros(2))
    covariance = covariance + (PLACE_FLOOR * cell) ** 2 * np.diag([1.0, 1.0, 0.0])
    height = float(pose.translation[2])
    planar = np.linalg.inv(covariance)
    return _planar_anchor(location.verdict.query_id, kind, located.planar, height, planar)


def start_anchor(name: str, start: SE2, params: AnchorParams) -> Anchor:
    """Make an anchor of where the drive starts."""
    stds = np.array([params.start_std, params.start_std, params.start_yaw_std])
    return _planar_anchor(name, "start", start, 0.0, np.diag(stds**-2))


def _planar_anchor(
    name: str,
    kind: Literal["place", "start"],
    pose: SE2,
    height: float,
    planar: Float[NDArray[np.floating], "3 3"],
) -> Anchor:
    """Make an anchor of x, y [m] and yaw [rad], with the information of these in the world."""
    measured = Pose.from_planar(pose, height)
    information = np.zeros((6, 6))
    information[np.ix_([0, 1, 5], [0, 1, 5])] = planar
    return Anchor(name, kind, measured, _in_submap(information, measured), trusted=kind == "start")


def _in_submap(information: Float[Array, "6 6"], pose: Pose) -> Float[Array, "6 6"]:
    """Turn the information of an offset and a small turn in the world into a submap's frame."""
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = pose.rotation
    return both.T @ information @ both


def anchor_graph(
    graph: PoseGraph,
    outline: Outline,
    model: AnchorModel,
    params: PipelineParams,
    solver: SolverParams | None = None,
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Anchored:
    """Anchor a graph, all traverses in one frame, on an elevation model, and solve it.

    An executor of processes shares the search for places.

    Raises:
        InputError: If the model does not cover the drive, or nothing says where it starts and no
            submap is found on the model.
    """
    # Between the submaps' centres, because a place on the model is one of ground.
    uncentred, graph = graph, graph.centred
    result = optimise_pose_graph(graph, solver)
    names = list(graph.poses)
    submaps = (outline.load(k)[0].centred for k in range(len(names)))
    grounds = {submap.id: thin_ground(submap, model.cell) for submap in submaps}
    search = _ModelSearch(outline, names, grounds, model, params, executor)
    progress(0.1)
    if model.start is None:
        first = search.first(result.poses, part(progress, 0.1, 0.3))
        T_model_world = (
            first[0].T_world_submap.planar @ result.poses[first[0].submap].planar.inverse()
        )
    else:
        x, y, _ = uncentred.centres.get(names[0], np.zeros(3)).tolist()
        start = model.start @ SE2(x, y)
        T_model_world = start @ result.poses[names[0]].planar.inverse()
        first = [start_anchor(names[0], start, model.params)]
    to_model = Pose.from_planar(T_model_world)
    lookups = [
        look_up(model, grounds[name], to_model @ pose, np.zeros((2, 2)))
        for name, pose in result.poses.items()
    ]
    rise = [lookup.offset for lookup in lookups if lookup is not None]
    if not rise:
        raise InputError(_not_covered(model, [to_model @ pose for pose in result.poses.values()]))
    to_model = Pose.from_planar(T_model_world, float(np.median(rise)))
    graph = replace(graph, poses={name: to_model @ pose for name, pose in graph.poses.items()})
    poses = {name: to_model @ pose for name, pose in result.poses.items()}
    held = [replace(anchor, T_world_submap=Pose(
        np.array([*anchor.T_world_submap.translation[:2], poses[anchor.submap].translation[2]]),
        anchor.T_world_submap.quaternion)) for anchor in first]  # fmt: skip
    anchored = _settle(graph, poses, held, grounds, search, model, solver, part(progress, 0.3, 1.0))
    return _at_origins(anchored, uncentred)


def _at_origins(anchored: Anchored, uncentred: PoseGraph) -> Anchored:
    """Move a solution between the centres of submaps back to the origins of their frames."""
    graph, result = anchored.graph, anchored.result

    def back(poses: Mapping[str, Pose]) -> dict[str, Pose]:
        return {name: uncentred.at_origin(name, pose) for name, pose in poses.items()}

    anchors = tuple(
        replace(one, T_world_submap=uncentred.at_origin(one.submap, one.T_world_submap))
        for one in graph.anchors
    )
    result = OptimisedGraph(
        back(result.poses),
        tuple(
            replace(fit, edge=edge) for fit, edge in zip(result.edges, uncentred.edges, strict=True)
        ),
        shifted_rows(result.history, -centres_of(uncentred.centres, uncentred.poses)),
        tuple(replace(fit, anchor=one) for fit, one in zip(result.anchors, anchors, strict=True)),
        centres=uncentred.centres,
    )
    graph = replace(uncentred, poses=back(graph.poses), anchors=anchors)
    return replace(anchored, graph=graph, result=result)


def _settle(
    graph: PoseGraph,
    poses: Mapping[str, Pose],
    held: Sequence[Anchor],
    grounds: Mapping[str, ThinnedGround],
    search: "_ModelSearch",
    model: AnchorModel,
    solver: SolverParams | None,
    progress: Progress,
) -> Anchored:
    """Look up and solve until nothing moves any more; held anchors hold the graph in the plane."""
    std = model.std
    starts = [anchor for anchor in held if anchor.kind == "start"]
    places = {anchor.submap: anchor for anchor in held if anchor.kind == "place"}
    # Odometry, closures and the start tell how far off the first look-up may be.
    # As long as no surface holds the height, these do.
    height = np.diag([0.0, 0.0, FIRST_HEIGHT_STD**-2, 0.0, 0.0, 0.0])
    lifted = [replace(anchor, information=anchor.information + height) for anchor in held]
    anchored, result, covariances = _solve(graph, lifted, poses, solver)
    lookups: dict[str, Lookup] = {}
    searches = 0 if search.possible else 2
    for k, loosened in enumerate(LOOSENED):
        before = result.poses
        lookups = {
            name: lookup
            for (name, pose), covariance in zip(before.items(), covariances, strict=True)
            if (lookup := look_up(model, grounds[name], pose, covariance[:2, :2])) is not None
        }
        if not lookups:
            raise InputError(_not_covered(model, list(before.values())))
        if model.std is None and (std is None or LOOSENED[k - 1] == 1):
            std = _estimate(lookups, dict(zip(before, covariances, strict=True)), std)
        assert std is not None
        shared = _shared(lookups, before, grounds, model.cell)
        surfaces = [
            replace(
                surface_anchor(name, lookup, before[name], loosened * std, by),
                trusted=loosened > 1,
            )
            for (name, lookup), by in zip(lookups.items(), shared, strict=True)
        ]
        held = [*starts, *places.values(), *surfaces]
        anchored, result, covariances = _solve(graph, held, before, solver)
        progress(0.9 * (k + 1) / len(LOOSENED))
        if loosened > 1:
            continue
        if searches < 2:
            used = {
                fit.anchor.submap
                for fit in result.anchors
                if fit.anchor.kind == "place" and fit.weight >= 0.5
            }
            lookup = search.near(result.poses, covariances, used, progress)
            searches = searches + 1 if lookup else 2
            places |= {anchor.submap: anchor for anchor in lookup}
            if lookup:
                continue
        moved = np.subtract(*(positions(before, poses) for poses in (result.poses, before)))
        if np.linalg.norm(moved, axis=1).max() < CONVERGED:
            break
    assert std is not None
    outside = tuple(name for name in graph.poses if name not in lookups)
    progress(1.0)
    return Anchored(model, anchored, result, std, outside)


def _solve(
    graph: PoseGraph,
    anchors: Sequence[Anchor],
    start: Mapping[str, Pose],
    solver: SolverParams | None,
) -> tuple[PoseGraph, OptimisedGraph, Float[Array, "n 6 6"]]:
    anchored = replace(graph, anchors=tuple(anchors))
    result = optimise_pose_graph(anchored, solver, start=start)
    return anchored, result, measure_pose_covariances(anchored, result)


def _estimate(
    lookups: Mapping[str, Lookup],
    covariances: Mapping[str, Float[Array, "6 6"]],
    before: float | None,
) -> float:
    """Estimate the standard deviation of the model's heights [m] from the residuals.

    First from how the differences change between submaps, less odometry's drift. Then from what is
    left, less other causes, plus the share of the variance that the heights have taken up
    themselves: as large as they are uncertain.
    """
    offsets = np.array([lookup.offset for lookup in lookups.values()])
    if before is None:
        steps = np.abs(np.diff(offsets))
        whole = (1.4826 * float(np.median(steps))) ** 2 if len(steps) else 0.0
        # By odometry, from each to the next.
        driven = np.maximum(np.diff([one[2, 2] for one in covariances.values()]), 0.0)
        own = whole - float(np.median(driven)) if len(driven) else whole
        # Odometry may be better than it says.
        return float(np.sqrt(max(0.5 * own, whole / 16, LEAST_STD**2)))
    doubt = [
        lookup.by_pose @ covariances[name] @ lookup.by_pose for name, lookup in lookups.items()
    ]
    other = [lookup.unseen + OWN_STD**2 for lookup in lookups.values()]
    left = (1.4826 * float(np.median(np.abs(offsets)))) ** 2
    # Adding the doubt itself (expectation maximisation) ends at the same, many rounds later.
    taken = min(float(np.median(doubt)) / (before**2 + float(np.median(other))), MOST_TAKEN)
    return float(np.sqrt(max(left / (1.0 - taken) - float(np.median(other)), LEAST_STD**2)))


def _shared(
    lookups: Mapping[str, Lookup],
    poses: Mapping[str, Pose],
    grounds: Mapping[str, ThinnedGround],
    cell: float,
) -> list[float]:
    """Count the submaps that stand on the same cells as each, by how much they share."""
    middles = np.array(
        [poses[name].translation[:2] + lookup.arm for name, lookup in lookups.items()]
    )
    counts: list[float] = []
    for name, middle in zip(lookups, middles, strict=True):
        apart = np.linalg.norm(middles - middle, axis=1)
        counts.append(float(np.maximum(1.0 - apart / max(cell, grounds[name].width), 0.0).sum()))
    return counts


def _not_covered(model: AnchorModel, poses: Sequence[Pose]) -> str:
    places = np.array([pose.translation[:2] for pose in poses]) + model.origin
    low, high = places.min(axis=0), places.max(axis=0)
    corner = np.add(model.elevations.corner, model.origin)
    rows, columns = model.elevations.heights.shape
    far = corner + np.array(model.elevations.cell) * (columns - 1, rows - 1)
    return (
        f"{model.name}: has no height under any of the {len(poses)} submaps; it reaches from "
        f"{corner[0]:.10g}, {corner[1]:.10g} to {far[0]:.10g}, {far[1]:.10g}, the drive from "
        f"{low[0]:.10g}, {low[1]:.10g} to {high[0]:.10g}, {high[1]:.10g}; name the model of this "
        "ground, or where the drive starts: --anchor-start E,N,YAW"
    )


class _ModelSearch:
    """Searches submaps on the model by the stages that find loop closures."""

    def __init__(
        self,
        outline: Outline,
        names: Sequence[str],
        grounds: Mapping[str, ThinnedGround],
        model: AnchorModel,
        params: PipelineParams,
        executor: Executor | None,
    ) -> None:
        self._outline, self._names, self._grounds = outline, list(names), grounds
        self._model, self._params, self._executor = model, params, executor
        self._width = max(ground.width for ground in grounds.values())
        self._chosen: tuple[PipelineParams, PipelineParams] | None = None
        # Of the model alone; what its errors have in common does not blur a place.
        self._noise = model.std

    @property
    def possible(self) -> bool:
        """Whether the model is fine enough to find one submap."""
        return self._width >= FEWEST_ACROSS * self._model.cell

    def first(self, poses: Mapping[str, Pose], progress: Progress) -> list[Anchor]:
        """Find the traverse on the whole model; poses are in its own frame."""
        locations: list[Location] = []
        if self.possible:
            windows = cut_windows(self._model.elevations, self._width)
            some = [self._load(self._names[k]) for k in representative(len(self._names))]
            locations = self._locate(some, windows, progress=progress)
        if locations:
            return self._most_agreed(locations, poses)
        whole = np.concatenate(
            [poses[name].apply(ground.points) for name, ground in self._grounds.items()]
        )
        middle = Pose.from_planar(SE2(*whole[:, :2].mean(axis=0).tolist()))
        merged = submap_of_cloud(
            thin_ground(
                submap_of_cloud(middle.inverse().apply(whole), ground="all"), self._model.cell
            ).points,
            self._names[0],
            ground="all",
        )  # fmt: skip
        if width_of(merged) >= FEWEST_ACROSS * self._model.cell:
            windows = cut_windows(self._model.elevations, width_of(merged))
            chosen = parameters_for([merged], windows, self._model.cell, None, self._noise)
            place = locate([merged], windows, chosen, executor=self._executor)[0]
            if place.verdict.accepted and place.pose is not None:
                T_middle_first = middle.inverse().planar @ poses[self._names[0]].planar
                first = Pose.from_planar(place.pose.planar @ T_middle_first)
                return [place_anchor(_moved(place, first), self._model.cell, first, "start")]
        raise InputError(
            f"{self._model.name}: neither a submap nor the whole drive was found on it for sure; "
            "say where the drive starts: --anchor-start E,N,YAW"
        )

    def near(
        self,
        poses: Mapping[str, Pose],
        covariances: Float[Array, "n 6 6"],
        earlier: Collection[str],
        progress: Progress,
    ) -> list[Anchor]:
        """Search submaps without a place near their estimated poses."""
        missing, nearby, windows = list[str](), list[list[str]](), dict[str, Window]()
        for name, covariance in zip(self._names, covariances, strict=True):
            if name in earlier:
                continue
            x, y, _ = poses[name].apply(self._grounds[name].middle[None])[0]
            radius = SEARCH_STDS * float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
            try:
                around = cut_windows(
                    self._model.elevations, self._width, (x, y, radius + self._model.cell)
                )
            except InputError:
                continue  # the model ends there
            windows |= {window.name: window for window in around}
            missing.append(name)
            nearby.append([window.name for window in around])
        if not missing:
            return []
        some = set(representative(len(missing)))
        locations: list[Location] = []
        for chosen in (sorted(some), [k for k in range(len(missing)) if k not in some]):
            if chosen and (locations or chosen[0] in some):
                locations += self._locate(
                    [self._load(missing[k]) for k in chosen],
                    list(windows.values()),
                    [nearby[k] for k in chosen],
                    progress,
                )
        return [
            place_anchor(place, self._model.cell, poses[place.verdict.query_id])
            for place in locations
        ]

    def _load(self, name: str) -> Submap:
        return self._outline.load(self._names.index(name))[0].centred

    def _locate(
        self,
        submaps: Sequence[Submap],
        windows: Sequence[Window],
        nearby: Sequence[Sequence[str]] | None = None,
        progress: Progress = silent,
    ) -> list[Location]:
        if self._chosen is None:
            some = [submaps[k] for k in representative(len(submaps))]
            self._chosen = parameters_for(
                some, windows, self._model.cell, self._params, self._noise, part(progress, 0.0, 0.1)
            )
        located = locate(
            submaps, windows, self._chosen, nearby=nearby, executor=self._executor,
            progress=part(progress, 0.1, 1.0),
        )  # fmt: skip
        return [
            place
            for place in located
            if place.verdict.accepted and place.verdict.registration.covariance is not None
        ]

    def _most_agreed(
        self, locations: Sequence[Location], poses: Mapping[str, Pose]
    ) -> list[Anchor]:
        frames = [
            place.pose.planar @ poses[place.verdict.query_id].planar.inverse()
            for place in locations
            if place.pose is not None
        ]

        def rank(k: int) -> tuple[int, float]:
            agreeing = 0
            for other in locations:
                assert other.pose is not None
                there = (frames[k] @ poses[other.verdict.query_id].planar).translation
                agreeing += bool(np.hypot(*(there - other.pose.translation[:2])) < self._width)
            return -agreeing, -locations[k].verdict.registration.score

        return [
            place_anchor(locations[k], self._model.cell, poses[locations[k].verdict.query_id])
            for k in sorted(range(len(locations)), key=rank)
        ]


def _moved(place: Location, pose: Pose) -> Location:
    """Move a location to another pose, which is rigidly attached to it."""
    registration = replace(place.verdict.registration, T_database_query=pose.planar)
    verdict = replace(place.verdict, registration=registration)
    return replace(place, verdict=verdict, pose=pose)
