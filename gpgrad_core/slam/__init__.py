"""From loop closures to a corrected map: pose graph, trajectory errors, merged maps."""

from gpgrad_core.slam.g2o import read_graph, write_graph
from gpgrad_core.slam.graph import Edge, GraphParams, PoseGraph, build_pose_graph, odometry_poses
from gpgrad_core.slam.optimise import (
    EdgeFit,
    OptimisedGraph,
    SolverParams,
    optimise_pose_graph,
)

__all__ = [
    "Edge",
    "EdgeFit",
    "GraphParams",
    "OptimisedGraph",
    "PoseGraph",
    "SolverParams",
    "build_pose_graph",
    "odometry_poses",
    "optimise_pose_graph",
    "read_graph",
    "write_graph",
]
