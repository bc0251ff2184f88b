"""Datasets put into one map, and the files of it: poses, graph, errors, figures, cloud and map."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gpgrad_core.datasets.ply import write_ply_pieces
from gpgrad_core.datasets.poses import write_poses
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation.report import check_directory
from gpgrad_core.gradient_map import TerrainParams
from gpgrad_core.outputs.files import replacing
from gpgrad_core.outputs.georeferenced import write_cloud_optimised, write_laz
from gpgrad_core.outputs.maps import write_arrays, write_raster
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.run.progress import Progress, part, silent
from gpgrad_core.se2 import Pose
from gpgrad_core.slam.consistency import Consistency, measure_consistency
from gpgrad_core.slam.g2o import vertex_numbers, write_graph
from gpgrad_core.slam.graph import GraphParams, PoseGraph, build_pose_graph
from gpgrad_core.slam.joining import JoinedDatasets, Placed, place_traverses
from gpgrad_core.slam.merge import MergeParams, gather, merge_clouds, merge_maps
from gpgrad_core.slam.optimise import OptimisedGraph, SolverParams, optimise_pose_graph
from gpgrad_core.slam.placed import PlacedMap
from gpgrad_core.slam.truth import (
    TrajectoryError,
    align_points,
    trajectory_error,
    true_poses,
)
from gpgrad_core.types import LoopClosure, Submap
from gpgrad_core.version import VERSION


@dataclass(frozen=True, eq=False)
class Solution:
    """Datasets in one map.

    Attributes:
        joined: The datasets.
        placed: Their pose graph before it was solved.
        result: The solved graph.
    """

    joined: JoinedDatasets
    placed: Placed
    result: OptimisedGraph

    @property
    def before(self) -> dict[str, Pose]:
        """The odometry's poses, all in the first dataset's frame."""
        return self.placed.graph.poses

    def submaps(self, note: Callable[[str], None] | None = None) -> Iterator[Submap]:
        """Load the submaps one by one.

        Args:
            note: Called with each line about what was left out of a submap.
        """
        for k in range(len(self.joined.outline.clouds)):
            submap, notes = self.joined.load(k)
            if note is not None:
                for line in notes:
                    note(line)
            yield submap


def solve_datasets(
    joined: JoinedDatasets,
    closures: Iterable[LoopClosure],
    graph: GraphParams | None = None,
    solver: SolverParams | None = None,
    *,
    trusted: Iterable[tuple[str, str]] = (),
) -> Solution:
    """Put datasets into one map by their closures.

    Args:
        joined: The datasets.
        closures: The loop closures; refused ones are left out.
        graph: How certain odometry and closures are.
        solver: When a closure counts as wrong.
        trusted: Pairs (query id, database id) whose closures a person has confirmed; they never
            count as wrong.

    Raises:
        InputError: If a submap has no odometry, a closure names an unknown submap, or no closure
            joins a dataset to the others.
    """
    dataset = joined.outline.dataset
    placed = place_traverses(
        build_pose_graph(dataset, closures, graph, trusted=trusted, starts=joined.starts)
    )
    if placed.alone:
        name = placed.alone[0].split(":")[0]
        raise InputError(
            f"{name}: no loop closure joins it to {next(iter(joined.traverses))}, so they cannot "
            "be put into one map; accept more closures (--closure.min-score), or leave it out"
        )
    return Solution(joined, placed, optimise_pose_graph(placed.graph, solver))


@dataclass(frozen=True)
class MapErrors:
    """Errors of a map, before and after the correction.

    Attributes:
        trajectories: Trajectory errors (before, after) of each dataset with true poses, by the
            dataset's name.
        overlaps: Height differences of overlapping submaps (before, after).
    """

    trajectories: Mapping[str, tuple[TrajectoryError, TrajectoryError]]
    overlaps: tuple[Consistency, Consistency]


def measure_errors(solution: Solution, progress: Progress = silent) -> MapErrors:
    """Measure the trajectories by the true poses, and how well submaps lie on one another.

    Args:
        solution: The map; its clouds are loaded twice, one by one.
        progress: Called twice; may raise Cancelled.
    """
    true = true_poses(solution.joined.outline.dataset)
    trajectories: dict[str, tuple[TrajectoryError, TrajectoryError]] = {}
    for session, names in solution.joined.traverses.items():
        known = {name: true[name] for name in names if name in true}
        if len(known) >= 2:
            only = solution.joined.outline.dataset.positions_only
            trajectories[session] = (
                trajectory_error(known, solution.before, positions_only=only),
                trajectory_error(known, solution.result.poses, positions_only=only),
            )
    overlaps: list[Consistency] = []
    for k, poses in enumerate((solution.before, solution.result.poses)):
        overlaps.append(measure_consistency(solution.submaps(), poses))
        progress((k + 1) / 2)
    return MapErrors(trajectories, (overlaps[0], overlaps[1]))


SOLUTION_FILES = (
    *("trajectory.png", "errors.png", "cloud.ply", "cloud.laz", "map.npz", "map.tif"),
    *("poses.geojson", "poses.kml"),
    *("graph.g2o", "report.json"),
)
"""Names of the files of a map, apart from its poses."""


def write_solution(
    directory: Path | str,
    solution: Solution,
    errors: MapErrors,
    progress: Progress = silent,
    *,
    placed: PlacedMap | None = None,
) -> None:
    """Write poses, graph, errors and figures into a folder.

    Args:
        directory: The folder; it is made if it does not exist.
        solution: The map.
        errors: Its errors.
        progress: Called from time to time.
        placed: Where the map lies in a coordinate system, for the report; None says nothing.

    Raises:
        InputError: If the folder cannot be made or written to.
    """
    from gpgrad_core.slam.figures import (  # noqa: PLC0415 - matplotlib takes half a second
        draw_errors,
        draw_trajectories,
    )

    directory = check_directory(directory)
    directory.mkdir(exist_ok=True)
    joined, result = solution.joined, solution.result
    for session, names in joined.traverses.items():
        poses = {joined.numbers[name]: result.poses[name] for name in names}
        with replacing(directory / poses_file(joined, session)) as unfinished:
            write_poses(unfinished, poses)
    write_graph(directory / "graph.g2o", used_graph(solution), result.poses)
    progress(0.3)
    true = true_poses(joined.outline.dataset)
    name = joined.outline.dataset.name
    figures = {
        "trajectory": draw_trajectories(
            name, list(joined.traverses.values()), solution.before, result, true
        )
    }
    distances = [_distances(solution, poses, true) for poses in (solution.before, result.poses)]
    if distances[0]:
        figures["errors"] = draw_errors(name, *distances)
    for figure_name, figure in figures.items():
        with replacing(directory / f"{figure_name}.png") as unfinished:
            figure.savefig(unfinished)
    progress(0.9)
    with replacing(directory / "report.json") as unfinished:
        text = json.dumps(
            _content(solution, errors, placed), indent=1, ensure_ascii=False, allow_nan=False
        )
        unfinished.write_text(text + "\n", encoding="utf-8")
    progress(1.0)


def solution_files(joined: JoinedDatasets) -> tuple[str, ...]:
    """Name the files that `write_solution` and `write_merged` may write; the report is the last."""
    return (*(poses_file(joined, session) for session in joined.traverses), *SOLUTION_FILES)


def poses_file(joined: JoinedDatasets, session: str) -> str:
    """Name the file of a dataset's corrected poses."""
    if len(joined.traverses) == 1:
        return "poses_corrected.txt"
    return f"poses_corrected_{''.join(c if c.isalnum() or c in '-_' else '_' for c in session)}.txt"


def used_graph(solution: Solution) -> PoseGraph:
    """Give the graph without the refused closures, for other tools to solve."""
    graph = solution.placed.graph
    kept = tuple(fit.edge for fit in solution.result.edges if fit.weight >= 0.5)
    return PoseGraph(graph.poses, kept, graph.tilt_std)


def write_merged(
    directory: Path | str,
    solution: Solution,
    terrain: TerrainParams,
    params: MergeParams | None = None,
    progress: Progress = silent,
    *,
    placed: PlacedMap | None = None,
) -> tuple[str, ...]:
    """Write all submaps as one cloud and one elevation map, in bounded memory.

    Writes ``cloud.ply``, ``map.npz`` and ``map.tif``; and ``cloud.laz`` if the map is placed.

    Args:
        directory: An existing folder.
        solution: The map; its submaps are loaded one by one.
        terrain: Parameters of the GP.
        params: Parameters of the cloud and the map.
        placed: Gives the coordinate system in which cloud and map are made; ``map.tif`` is then
            cloud-optimised and names it. None makes them in the map's world.
        progress: Called from time to time; may raise Cancelled.

    Returns:
        What had to be left out, one line each.

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
            georeference=None if placed is None else placed.apply,
            progress=part(progress, 0.0, 0.15),
        )
        with replacing(directory / "cloud.ply") as unfinished:
            pieces = merge_clouds(gathered, params.voxel, part(progress, 0.15, 0.25))
            write_ply_pieces(unfinished, pieces)
        if placed is not None:
            write_laz(
                directory / "cloud.laz", merge_clouds(gathered, params.voxel), placed.georeference
            )
        merged = merge_maps(gathered, terrain, params, layers, part(progress, 0.25, 0.9))
        with replacing(directory / "map.npz") as unfinished:
            write_arrays(unfinished, merged.grid, merged.layers)
        progress(0.95)
        if placed is None:
            with replacing(directory / "map.tif") as unfinished:
                write_raster(unfinished, merged.grid, merged.layers)
        else:
            write_cloud_optimised(
                directory / "map.tif", merged.grid, merged.layers, placed.georeference
            )
        progress(1.0)
        return merged.notes


def _distances(
    solution: Solution, poses: Mapping[str, Pose], true: Mapping[str, Pose]
) -> dict[str, float]:
    """Measure each submap's distance [m] from its true position, each dataset aligned by itself."""
    found: dict[str, float] = {}
    for names in solution.joined.traverses.values():
        known = [name for name in names if name in true]
        if len(known) < 2:
            continue
        truth = np.array([true[name].translation for name in known])
        places = np.array([poses[name].translation for name in known])
        left = np.linalg.norm(align_points(places, truth) - truth, axis=1)
        found |= dict(zip(known, left.tolist(), strict=True))
    return found


def _content(solution: Solution, errors: MapErrors, placed: PlacedMap | None) -> dict[str, Any]:
    """Make the content of ``report.json``: metres and radians, null for unknown."""
    numbers = vertex_numbers(solution.placed.graph)
    return {
        "dataset": solution.joined.outline.dataset.name,
        "gpgrad": VERSION,
        "coordinates": None
        if placed is None
        else {
            "crs": placed.georeference.name,
            "origin": list(placed.georeference.origin),  # longitude, latitude, height
            "placed_by_truth": placed.by_truth,
            "world_yaw": placed.T_local_world.planar.yaw,
        },
        "sessions": {
            session: {
                "poses": poses_file(solution.joined, session),
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
