"""From loop closures to a corrected map: pose graph, trajectory errors, merged maps."""

from gpgrad_core.slam.errors import (
    Consistency,
    TrajectoryError,
    measure_consistency,
    trajectory_error,
    true_poses,
)
from gpgrad_core.slam.g2o import read_graph, vertex_numbers, write_graph
from gpgrad_core.slam.graph import Edge, GraphParams, PoseGraph, build_pose_graph, odometry_poses
from gpgrad_core.slam.loop_closer import LoopCloser, Step
from gpgrad_core.slam.merged_map import MergeParams
from gpgrad_core.slam.optimise import (
    EdgeFit,
    OptimisedGraph,
    SolverParams,
    check_solver,
    optimise_pose_graph,
)
from gpgrad_core.slam.solution import (
    MapCoordinates,
    MapErrors,
    Solution,
    find_coordinates,
    measure_errors,
    solution_files,
    solve_datasets,
    write_merged,
    write_solution,
    write_track,
)
from gpgrad_core.slam.traverses import JoinedDatasets, join_datasets, place_traverses

__all__ = [
    "Consistency",
    "Edge",
    "EdgeFit",
    "GraphParams",
    "JoinedDatasets",
    "LoopCloser",
    "MapCoordinates",
    "MapErrors",
    "MergeParams",
    "OptimisedGraph",
    "PoseGraph",
    "Solution",
    "SolverParams",
    "Step",
    "TrajectoryError",
    "build_pose_graph",
    "check_solver",
    "find_coordinates",
    "join_datasets",
    "measure_consistency",
    "measure_errors",
    "odometry_poses",
    "optimise_pose_graph",
    "place_traverses",
    "read_graph",
    "solution_files",
    "solve_datasets",
    "trajectory_error",
    "true_poses",
    "vertex_numbers",
    "write_graph",
    "write_merged",
    "write_solution",
    "write_track",
]
