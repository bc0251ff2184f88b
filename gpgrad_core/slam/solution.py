"""Datasets put into one map, and the files of it: poses, graph, errors, figures, cloud and map."""

from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TypedDict

import numpy as np
from typing_extensions import Unpack

from gpgrad_core import __version__
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError, count
from gpgrad_core.evaluation.report import check_directory
from gpgrad_core.io.clouds.ply import write_ply_pieces
from gpgrad_core.io.georeference import Georeference
from gpgrad_core.io.poses import write_pose_covariances, write_poses
from gpgrad_core.io.records.files import replacing, write_json
from gpgrad_core.io.records.georeferenced import write_cloud_optimised, write_laz
from gpgrad_core.io.records.maps import write_arrays, write_raster
from gpgrad_core.mapping.gradient_map import TerrainParams
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam.anchoring import Anchored, AnchorModel, anchor_graph
from gpgrad_core.slam.coordinates import MapCoordinates, find_coordinates, write_track
from gpgrad_core.slam.errors import (
    HeightDifferences,
    TrajectoryError,
    align_points,
    measure_consistency,
    positions,
    trajectory_error,
)
from gpgrad_core.slam.graph import (
    GraphParams,
    PoseGraph,
    build_pose_graph,
    judged_poses,
    vertex_numbers,
    write_graph,
)
from gpgrad_core.slam.merged_map import MergeParams, gather, merge_clouds, merge_maps
from gpgrad_core.slam.optimise import (
    OptimisedGraph,
    SolverParams,
    measure_pose_covariances,
    optimise_pose_graph,
)
from gpgrad_core.slam.traverses import JoinedDatasets, PlacedGraph, place_traverses
from gpgrad_core.types import LoopClosure, Submap

SOLUTION_FILES = (
    *("trajectory.png", "errors.png", "cloud.ply", "cloud.laz", "map.npz", "map.tif"),
    *("poses.geojson", "poses.kml"),
    *("graph.g2o", "report.json"),
)
"""Names of the files of a map, apart from its poses."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Datasets in one map."""

    joined: JoinedDatasets  # the datasets
    placed: PlacedGraph  # their pose graph before it was solved
    result: OptimisedGraph  # the solved graph
    anchored: Anchored | None = None  # what holds it on an elevation model

    @property
    def before(self) -> dict[str, Pose]:
        return self.placed.graph.poses

    def shown(self, poses: Mapping[str, Pose]) -> Mapping[str, Pose]:
        """Move poses by id to where errors are measured and tracks are drawn."""
        return judged_poses(self.joined.outline.measured, poses)

    def submaps(self) -> Iterator[Submap]:
        outline = self.joined.outline
        return outline.terrains(range(len(outline.clouds)))


class Anchoring(TypedDict, total=False):
    """What an elevation model is searched with; see `anchor_graph`."""

    anchor: AnchorModel | None
    params: PipelineParams | None
    executor: Executor | None


def solve_datasets(
    joined: JoinedDatasets,
    closures: Iterable[LoopClosure],
    graph: GraphParams | None = None,
    solver: SolverParams | None = None,
    *,
    trusted: Iterable[tuple[str, str]] = (),
    progress: Progress = silent,
    **anchoring: Unpack[Anchoring],
) -> Solution:
    """Merge datasets into one map by their closures, on an elevation model if there is one.

    Refused closures are left out. Trusted pairs (query id, database id), which a person has
    confirmed, never count as wrong. Submaps are searched on the model with the parameters of their
    maps; see `anchor_graph`.

    Raises:
        InputError: If a submap has no odometry, a closure names an unknown submap, no closure
            joins a dataset to the others, or the drive cannot be placed on the model.
    """
    dataset = joined.outline.measured
    placed = place_traverses(
        build_pose_graph(dataset, closures, graph, trusted=trusted, starts=joined.starts)
    )
    if placed.alone:
        name = placed.alone[0].split(":")[0]
        raise InputError(
            f"{name}: no loop closure joins it to {next(iter(joined.traverses))}, so they cannot "
            "be put into one map; accept more closures (--closure.min-score), or leave it out"
        )
    anchor = anchoring.get("anchor")
    if anchor is None:
        return Solution(joined, placed, optimise_pose_graph(placed.graph, solver))
    params, executor = anchoring.get("params") or PipelineParams(), anchoring.get("executor")
    anchored = anchor_graph(
        placed.graph, joined.outline, anchor, params, solver, executor=executor, progress=progress
    )
    return Solution(joined, replace(placed, graph=anchored.graph), anchored.result, anchored)


@dataclass(frozen=True)
class MapErrors:
    """Errors of a map, before and after the correction."""

    # of each dataset with true poses, by its name
    trajectories: Mapping[str, tuple[TrajectoryError, TrajectoryError]]
    overlaps: tuple[
        HeightDifferences, HeightDifferences
    ]  # height differences of overlapping submaps


def measure_errors(solution: Solution, progress: Progress = silent) -> MapErrors:
    """Measure trajectories by the true poses, and overlaps of submaps; loads the clouds twice."""
    dataset, both = solution.joined.outline.dataset, (solution.before, solution.result.poses)
    true = dataset.true_poses
    trajectories: dict[str, tuple[TrajectoryError, TrajectoryError]] = {}
    for session, names in solution.joined.traverses.items():
        truth = {name: true[name] for name in names if name in true}
        if len(truth) >= 2:
            judged = solution.shown(truth)
            before, after = (
                trajectory_error(
                    judged, solution.shown(poses), positions_only=dataset.positions_only
                )
                for poses in both
            )
            trajectories[session] = before, after
    overlaps: list[HeightDifferences] = []
    for k, poses in enumerate(both):
        overlaps.append(measure_consistency(solution.submaps(), poses))
        progress((k + 1) / 2)
    return MapErrors(trajectories, (overlaps[0], overlaps[1]))


def describe_map(solution: Solution, errors: MapErrors) -> list[str]:
    """Describe how good a corrected map is: a line for each traverse, and one for the overlaps."""
    loops, refused = len(solution.result.loops), len(solution.result.refused)
    lines = [
        f"{count(len(solution.result.poses), 'submap')}, "
        f"{count(loops - refused, 'loop closure')} used, {refused} refused as wrong"
    ]
    if solution.result.height_note:
        lines.append(solution.result.height_note)
    if solution.anchored is not None:
        lines.append(str(solution.anchored))
    for session, (before, after) in errors.trajectories.items():
        only = " (of positions only)" if before.relative_turn is None else ""
        lines.append(
            f"{session}: trajectory error{only} {before.absolute:.3f} m -> {after.absolute:.3f} m, "
            f"from submap to submap {before.relative:.3f} m -> {after.relative:.3f} m"
        )
    first, last = errors.overlaps
    if first.median is not None and last.median is not None:
        lines.append(
            f"median height difference where submaps overlap: {100 * first.median:.1f} cm "
            f"({first.count} pairs) -> {100 * last.median:.1f} cm ({last.count} pairs)"
        )
    return lines


def coordinates_of(solution: Solution, georeference: Georeference) -> MapCoordinates:
    """Find the coordinates of a solved map; those of an anchored one are its model's."""
    if solution.anchored is not None:
        return MapCoordinates(georeference, Pose.from_planar(SE2()), by_truth=False, by_anchor=True)
    # The origin is the first dataset's; the truth of others may have another frame.
    first = set(next(iter(solution.joined.traverses.values())))
    truth = solution.joined.outline.dataset.true_poses
    true = {name: pose for name, pose in truth.items() if name in first}
    poses = solution.shown(solution.result.poses)
    return find_coordinates(poses, solution.shown(true), georeference)


def write_solution(
    directory: Path | str,
    solution: Solution,
    errors: MapErrors,
    progress: Progress = silent,
    *,
    coordinates: MapCoordinates | None = None,
) -> None:
    """Write poses, graph, errors and figures into a folder, and the track if the map is placed."""
    from gpgrad_core.slam.plots import draw_errors, draw_trajectories  # noqa: PLC0415 - matplotlib takes half a second

    directory = check_directory(directory)
    directory.mkdir(exist_ok=True)
    joined, result = solution.joined, solution.result
    measured = measure_pose_covariances(solution.placed.graph, result)
    covariances = dict(zip(result.poses, measured, strict=True))
    for session, names in joined.traverses.items():
        with replacing(directory / poses_file(joined, session)) as unfinished:
            write_poses(unfinished, {joined.numbers[name]: result.poses[name] for name in names})
        certain = {joined.numbers[name]: covariances[name] for name in names}
        with replacing(directory / covariances_file(joined, session)) as unfinished:
            write_pose_covariances(unfinished, certain)
    if coordinates is not None:
        write_track(directory, joined.traverses, solution.shown(result.poses), coordinates)
    write_graph(directory / "graph.g2o", used_graph(solution), result.poses)
    progress(0.3)
    true = joined.outline.dataset.true_poses
    name = joined.outline.dataset.name
    figures = {
        "trajectory": draw_trajectories(
            name,
            list(joined.traverses.values()),
            solution.shown(solution.before),
            replace(result, poses=dict(solution.shown(result.poses))),
            solution.shown(true),
        )
    }
    distances = [_distances(solution, poses, true) for poses in (solution.before, result.poses)]
    if distances[0]:
        figures["errors"] = draw_errors(name, *distances)
    for figure_name, figure in figures.items():
        with replacing(directory / f"{figure_name}.png") as unfinished:
            figure.savefig(unfinished)
    progress(0.9)
    write_json(directory / "report.json", _content(solution, errors, coordinates))
    progress(1.0)


def solution_files(joined: JoinedDatasets) -> tuple[str, ...]:
    """Name the files that `write_solution` and `write_merged` may write; the report is the last."""
    poses = (poses_file(joined, session) for session in joined.traverses)
    covariances = (covariances_file(joined, session) for session in joined.traverses)
    return (*poses, *covariances, *SOLUTION_FILES)


def poses_file(joined: JoinedDatasets, session: str) -> str:
    """Name the file of a dataset's corrected poses."""
    if len(joined.traverses) == 1:
        return "poses_corrected.txt"
    return f"poses_corrected_{''.join(c if c.isalnum() or c in '-_' else '_' for c in session)}.txt"


def covariances_file(joined: JoinedDatasets, session: str) -> str:
    """Name the file of the covariances of a dataset's corrected poses."""
    return poses_file(joined, session).replace("poses_corrected", "covariances_corrected")


def used_graph(solution: Solution) -> PoseGraph:
    """The graph without the refused closures, for other tools to solve."""
    graph = solution.placed.graph
    used = tuple(fit.edge for fit in solution.result.edges if fit.weight >= 0.5)
    return replace(graph, edges=used, anchors=())


def write_merged(
    directory: Path | str,
    solution: Solution,
    terrain: TerrainParams,
    params: MergeParams | None = None,
    progress: Progress = silent,
    *,
    coordinates: MapCoordinates | None = None,
) -> tuple[str, ...]:
    """Write all submaps as one cloud and one elevation map, in bounded memory.

    Writes ``cloud.ply``, ``map.npz`` and ``map.tif``; and ``cloud.laz`` if the map is placed. The
    submaps are loaded one by one. With coordinates, cloud and map are made in these, and
    ``map.tif`` is cloud-optimised and names their system.

    Raises:
        InputError: If the map would be too large, or the noise of a point is not known.
    """
    directory, params = Path(directory), params or MergeParams()
    # Beside the results, because the temporary files can be as large as they are.
    with TemporaryFolder(".merging-", directory) as folder:
        tiles, layers = Path(folder, "tiles"), Path(folder, "layers")
        tiles.mkdir()
        layers.mkdir()
        gathered = gather(
            solution.submaps(),
            solution.result.poses,
            terrain,
            tiles,
            count=len(solution.result.poses),
            voxel=params.voxel,
            georeference=None if coordinates is None else coordinates.apply,
            progress=part(progress, 0.0, 0.15),
        )
        with replacing(directory / "cloud.ply") as unfinished:
            pieces = merge_clouds(gathered, params.voxel, part(progress, 0.15, 0.25))
            write_ply_pieces(unfinished, pieces)
        if coordinates is not None:
            pieces = merge_clouds(gathered, params.voxel)
            write_laz(directory / "cloud.laz", pieces, coordinates.georeference)
        merged = merge_maps(gathered, terrain, params, layers, part(progress, 0.25, 0.9))
        with replacing(directory / "map.npz") as unfinished:
            write_arrays(unfinished, merged.grid, merged.layers)
        progress(0.95)
        if coordinates is None:
            with replacing(directory / "map.tif") as unfinished:
                write_raster(unfinished, merged.grid, merged.layers)
        else:
            write_cloud_optimised(
                directory / "map.tif", merged.grid, merged.layers, coordinates.georeference
            )
        progress(1.0)
        return merged.notes


def _distances(
    solution: Solution, poses: Mapping[str, Pose], true: Mapping[str, Pose]
) -> dict[str, float]:
    """Measure each submap's distance [m] from its true position, each dataset aligned by itself."""
    distances: dict[str, float] = {}
    for names in solution.joined.traverses.values():
        compared = [name for name in names if name in true]
        if len(compared) >= 2:
            truth = positions(compared, solution.shown(true))
            errors = align_points(positions(compared, solution.shown(poses)), truth) - truth
            distances |= dict(zip(compared, np.linalg.norm(errors, axis=1).tolist(), strict=True))
    return distances


def _content(
    solution: Solution, errors: MapErrors, coordinates: MapCoordinates | None
) -> dict[str, object]:
    """Make the content of ``report.json``: metres and radians, null for unknown."""
    numbers = vertex_numbers(solution.placed.graph)
    return {
        "dataset": solution.joined.outline.dataset.name,
        "gpgrad": __version__,
        "coordinates": None
        if coordinates is None
        else {
            "crs": coordinates.georeference.name,
            "origin": list(coordinates.georeference.origin),  # longitude, latitude, height
            "placed_by_truth": coordinates.by_truth,
            "placed_by_anchor": coordinates.by_anchor,
            "world_yaw": coordinates.T_local_world.planar.yaw,
        },
        "anchor": None if solution.anchored is None else _anchor_content(solution.anchored),
        "sessions": {
            session: {
                "poses": poses_file(solution.joined, session),
                "covariances": covariances_file(solution.joined, session),
                "submaps": len(names),
                "closures_that_agree_on_its_place": solution.placed.support.get(names[0]),
            }
            for session, names in solution.joined.traverses.items()
        },
        "trajectory_error": {
            session: {"before": asdict(before), "after": asdict(after)}
            for session, (before, after) in errors.trajectories.items()
        },
        "height_differences": {
            "before": asdict(errors.overlaps[0]),
            "after": asdict(errors.overlaps[1]),
        },
        "height_drift": solution.result.height_drift,
        "height_doubted": solution.result.height_doubted,
        "submaps": [{"id": name, "vertex": number} for name, number in numbers.items()],
        "edges": [
            {
                "start": fit.edge.start,
                "end": fit.edge.end,
                "kind": fit.edge.kind,
                "score": fit.edge.score,
                "chi_square": float(f"{fit.chi_square:.6g}"),
                "weight": fit.weight,
            }
            for fit in solution.result.edges
        ],
    }


def _anchor_content(anchored: Anchored) -> dict[str, object]:
    model = anchored.model
    return {
        "model": model.name,
        "system": model.elevations.system or None,
        "origin": list(model.origin),  # easting, northing of the map's origin
        "std": anchored.std,
        "std_stated": model.std is not None,
        "outside": list(anchored.outside),
        "anchors": [
            {
                "submap": fit.anchor.submap,
                "kind": fit.anchor.kind,
                "chi_square": float(f"{fit.chi_square:.6g}"),
                "weight": fit.weight,
            }
            for fit in anchored.result.anchors
        ],
    }
