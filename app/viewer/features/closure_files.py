"""Loop closures as a file: their verdicts, the pose graph they make, or the poses it corrects."""

from pathlib import Path

from app.viewer.session.decisions import Decisions
from app.viewer.session.methods import MethodName
from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.io.poses import write_poses
from gpgrad_core.io.records.closures import report_closures, write_closure_table, write_closures
from gpgrad_core.slam import (
    OptimisedGraph,
    build_pose_graph,
    optimise_pose_graph,
    vertex_numbers,
    write_graph,
)
from gpgrad_core.types import Dataset


def write_closure_file(
    path: Path,
    dataset: Dataset,
    result: DetectionResult,
    params: PipelineParams,
    method: MethodName,
    *,
    decisions: Decisions | None = None,
    solved: OptimisedGraph | None = None,
) -> None:
    """Write loop closures in the format that the ending of the file names.

    ``.json`` and ``.csv`` hold all verdicts, ``.g2o`` the pose graph, and ``.txt`` the corrected
    poses in TUM's format, which are optimised unless that is done. Those that a person accepted are
    never left out.
    """
    decided = decisions or Decisions()
    trusted, by_hand = decided.trusted, decided.of_closures()
    match path.suffix:
        case ".g2o":
            graph = build_pose_graph(dataset, result.closures, trusted=trusted)
            write_graph(path, graph, None if solved is None else solved.poses)
        case ".txt":
            graph = build_pose_graph(dataset, result.closures, trusted=trusted)
            poses = (solved or optimise_pose_graph(graph)).poses
            numbers = vertex_numbers(graph)
            write_poses(path, {numbers[name]: pose for name, pose in poses.items()})
        case ".csv":
            write_closure_table(path, report_closures(dataset, result, params, method=method))
        case _:
            report = report_closures(dataset, result, params, method=method, decisions=by_hand)
            write_closures(path, report)
