from .datasets import (
    SimulationParams,
    demo_path,
    load_cloud,
    load_dataset,
    simulate_dataset,
    write_dataset,
)
from .errors import InputError
from .evaluation import (
    Evaluation,
    EvaluationParams,
    PrecisionRecall,
    evaluate,
    write_report,
)
from .features import DetectorParams, FeatureParams, extract_features
from .fitting import FitResult, fit_parameters
from .gradient_map import MapParams, infer_gradient_map, infer_slope_variance
from .loop_closure import ClosureParams, classify
from .matching import MatchParams, match_features
from .outputs import (
    read_closures,
    report_closures,
    restore_closures,
    write_closures,
    write_fitted,
    write_map,
)
from .params.files import preferred_parameters, read_parameters
from .pipeline import (
    DetectionResult,
    PairResult,
    PipelineParams,
    detect_loop_closures,
    register_pair,
    resolve_parameters,
)
from .registration import RegistrationParams, refine, register
from .run.memo import Memo
from .scans import BuildParams, BuildReport, RecordingSources, build_dataset
from .se2 import SE2, Pose
from .slam import (
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
from .types import (
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

__version__: str

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
