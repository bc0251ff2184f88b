"""From loop closures to a corrected map: pose graph, trajectory errors, merged maps."""

from gpgrad_core.slam.consistency import Consistency, measure_consistency
from gpgrad_core.slam.g2o import read_graph, write_graph
from gpgrad_core.slam.graph import Edge, GraphParams, PoseGraph, build_pose_graph, odometry_poses
from gpgrad_core.slam.loop_closer import LoopCloser, Step
from gpgrad_core.slam.merge import MergedMap, MergeParams, gather, merge_clouds, merge_maps
from gpgrad_core.slam.optimise import (
    EdgeFit,
    OptimisedGraph,
    SolverParams,
    check_solver,
    optimise_pose_graph,
)
from gpgrad_core.slam.report import (
    Judged,
    Solution,
    judge_solution,
    solve_sessions,
    write_merged,
    write_solution,
)
from gpgrad_core.slam.sessions import Placed, Sessions, join_datasets, place_traverses
from gpgrad_core.slam.trajectory import TrajectoryError, trajectory_error, true_poses

__all__ = [
    "Consistency",
    "Edge",
    "EdgeFit",
    "GraphParams",
    "Judged",
    "LoopCloser",
    "MergeParams",
    "MergedMap",
    "OptimisedGraph",
    "Placed",
    "PoseGraph",
    "Sessions",
    "Solution",
    "SolverParams",
    "Step",
    "TrajectoryError",
    "build_pose_graph",
    "check_solver",
    "gather",
    "join_datasets",
    "judge_solution",
    "measure_consistency",
    "merge_clouds",
    "merge_maps",
    "odometry_poses",
    "optimise_pose_graph",
    "place_traverses",
    "read_graph",
    "solve_sessions",
    "trajectory_error",
    "true_poses",
    "write_graph",
    "write_merged",
    "write_solution",
]
