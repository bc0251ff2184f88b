"""gpgrad_core: loop closures from Gaussian-process gradient maps of bare terrain.

The index of what others may rely on; ``import gpgrad_core as gg``. Lengths are in metres, angles
in radians; data and params are frozen; every verb is a pure function of them.
"""

from gpgrad_core.datasets import (
    SimulationParams,
    demo_path,
    load_cloud,
    load_dataset,
    simulate_dataset,
    write_dataset,
)
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import (
    Evaluation,
    EvaluationParams,
    PrecisionRecall,
    evaluate,
    write_report,
)
from gpgrad_core.features import DetectorParams, FeatureParams, extract_features
from gpgrad_core.fitting import FitResult, fit_parameters
from gpgrad_core.gradient_map import MapParams, infer_gradient_map, infer_slope_variance
from gpgrad_core.loop_closure import ClosureParams, classify
from gpgrad_core.matching import MatchParams, match_features
from gpgrad_core.outputs import (
    read_closures,
    report_closures,
    restore_closures,
    write_closures,
    write_fitted,
    write_map,
)
from gpgrad_core.params.files import preferred_parameters, read_parameters
from gpgrad_core.pipeline import (
    DetectionResult,
    PairResult,
    PipelineParams,
    detect_loop_closures,
    register_pair,
    resolve_parameters,
)
from gpgrad_core.registration import RegistrationParams, refine, register
from gpgrad_core.run.memo import Memo
from gpgrad_core.scans import BuildParams, BuildReport, RecordingSources, build_dataset
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import (
    Edge,
    EdgeFit,
    GraphParams,
    LoopCloser,
    OptimisedGraph,
    PoseGraph,
    SolverParams,
    build_pose_graph,
    optimise_pose_graph,
    read_graph,
    trajectory_error,
    write_graph,
)
from gpgrad_core.types import (
    Dataset,
    Features,
    GradientMap,
    Grid,
    LoopClosure,
    LoopDetector,
    Matches,
    Registration,
    Submap,
)
from gpgrad_core.version import VERSION as __version__

__all__ = [
    "SE2",
    "BuildParams",
    "BuildReport",
    "ClosureParams",
    "Dataset",
    "DetectionResult",
    "DetectorParams",
    "Edge",
    "EdgeFit",
    "Evaluation",
    "EvaluationParams",
    "FeatureParams",
    "Features",
    "FitResult",
    "GradientMap",
    "GraphParams",
    "Grid",
    "InputError",
    "LoopCloser",
    "LoopClosure",
    "LoopDetector",
    "MapParams",
    "MatchParams",
    "Matches",
    "Memo",
    "OptimisedGraph",
    "PairResult",
    "PipelineParams",
    "Pose",
    "PoseGraph",
    "PrecisionRecall",
    "RecordingSources",
    "Registration",
    "RegistrationParams",
    "SimulationParams",
    "SolverParams",
    "Submap",
    "__version__",
    "build_dataset",
    "build_pose_graph",
    "classify",
    "demo_path",
    "detect_loop_closures",
    "evaluate",
    "extract_features",
    "fit_parameters",
    "infer_gradient_map",
    "infer_slope_variance",
    "load_cloud",
    "load_dataset",
    "match_features",
    "optimise_pose_graph",
    "preferred_parameters",
    "read_closures",
    "read_graph",
    "read_parameters",
    "refine",
    "register",
    "register_pair",
    "report_closures",
    "resolve_parameters",
    "restore_closures",
    "simulate_dataset",
    "trajectory_error",
    "write_closures",
    "write_dataset",
    "write_fitted",
    "write_graph",
    "write_map",
    "write_report",
]
