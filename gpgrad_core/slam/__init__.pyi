from .anchoring import AnchorModel, AnchorParams, anchor_graph
from .drive import Drive, write_run
from .errors import Consistency, TrajectoryError, measure_consistency, trajectory_error, true_poses
from .graph import (
    Edge,
    GraphParams,
    PoseGraph,
    build_pose_graph,
    odometry_poses,
    read_graph,
    vertex_numbers,
    write_graph,
)
from .loop_closer import LoopCloser, Step
from .merged_map import MergeParams
from .moment import Moment, verdicts_at
from .optimise import (
    EdgeFit,
    OptimisedGraph,
    SolverParams,
    check_solver,
    measure_covariances,
    optimise_pose_graph,
)
from .run_file import Run, RunSettings, RunWriter, is_run, read_run
from .solution import (
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
from .traverses import JoinedDatasets, join_datasets, place_traverses

__all__ = [
    "AnchorModel",
    "AnchorParams",
    "Consistency",
    "Drive",
    "Edge",
    "EdgeFit",
    "GraphParams",
    "JoinedDatasets",
    "LoopCloser",
    "MapCoordinates",
    "MapErrors",
    "MergeParams",
    "Moment",
    "OptimisedGraph",
    "PoseGraph",
    "Run",
    "RunSettings",
    "RunWriter",
    "Solution",
    "SolverParams",
    "Step",
    "TrajectoryError",
    "anchor_graph",
    "build_pose_graph",
    "check_solver",
    "find_coordinates",
    "is_run",
    "join_datasets",
    "measure_consistency",
    "measure_covariances",
    "measure_errors",
    "odometry_poses",
    "optimise_pose_graph",
    "place_traverses",
    "read_graph",
    "read_run",
    "solution_files",
    "solve_datasets",
    "trajectory_error",
    "true_poses",
    "verdicts_at",
    "vertex_numbers",
    "write_graph",
    "write_merged",
    "write_run",
    "write_solution",
    "write_track",
]
