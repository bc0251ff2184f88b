"""From loop closures to a corrected map: pose graph, trajectory errors, merged maps."""

from gpgrad_core.slam.consistency import Consistency, measure_consistency
from gpgrad_core.slam.g2o import read_graph, write_graph
from gpgrad_core.slam.graph import Edge, GraphParams, PoseGraph, build_pose_graph, odometry_poses
from gpgrad_core.slam.joining import JoinedDatasets, Placed, join_datasets, place_traverses
from gpgrad_core.slam.loop_closer import LoopCloser, Step
from gpgrad_core.slam.merge import MergedMap, MergeParams, gather, merge_clouds, merge_maps
from gpgrad_core.slam.optimise import (
    EdgeFit,
    OptimisedGraph,
    SolverParams,
    check_solver,
    optimise_pose_graph,
)
from gpgrad_core.slam.placed import PlacedMap, place_map, write_places
from gpgrad_core.slam.solution import (
    MapErrors,
    Solution,
    measure_errors,
    solution_files,
    solve_datasets,
    write_merged,
    write_solution,
)
from gpgrad_core.slam.truth import TrajectoryError, trajectory_error, true_poses

__all__ = [
    "Consistency",
    "Edge",
    "EdgeFit",
    "GraphParams",
    "JoinedDatasets",
    "LoopCloser",
    "MapErrors",
    "MergeParams",
    "MergedMap",
    "OptimisedGraph",
    "Placed",
    "PlacedMap",
    "PoseGraph",
    "Solution",
    "SolverParams",
    "Step",
    "TrajectoryError",
    "build_pose_graph",
    "check_solver",
    "gather",
    "join_datasets",
    "measure_consistency",
    "measure_errors",
    "merge_clouds",
    "merge_maps",
    "odometry_poses",
    "optimise_pose_graph",
    "place_map",
    "place_traverses",
    "read_graph",
    "solution_files",
    "solve_datasets",
    "trajectory_error",
    "true_poses",
    "write_graph",
    "write_merged",
    "write_places",
    "write_solution",
]
