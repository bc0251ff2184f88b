from .detection import (
    DetectionResult,
    PairResult,
    PipelineParams,
    detect_loop_closures,
    infer_gradient_map,
    infer_slope_variance,
    register_pair,
    resolve_parameters,
)
from .detection.shortlist import Candidate, Shortlist
from .detection.verdict import ClosureParams, classify
from .errors import InputError
from .evaluation import Evaluation, EvaluationParams, PrecisionRecall, evaluate, write_report
from .features import DetectorParams, FeatureParams, extract_features
from .io.clouds import load_cloud
from .io.folder import load_dataset, open_dataset, write_dataset
from .io.records.closures import read_closures, report_closures, restore_closures, write_closures
from .io.records.maps import write_fitted, write_map
from .io.records.shortlists import read_shortlist, resume_shortlist, write_shortlist
from .live.client import Live
from .mapping.fitting import FitResult, fit_parameters
from .mapping.gradient_map import MapParams, TerrainParams
from .matching import MatchParams, match_features
from .pages import Inline, show
from .params import preferred_parameters, read_parameters
from .recordings.build import BuildReport, build_dataset
from .recordings.params import BuildParams
from .recordings.recording import RecordingSources
from .registration import RegistrationParams, refine, register
from .run.memo import Memo
from .se2 import SE2, Pose
from .simulation.demo import demo_path
from .simulation.params import SimulationParams
from .simulation.recording import simulate_recording
from .simulation.simulate import simulate_dataset
from .slam import (
    Drive,
    Edge,
    EdgeFit,
    GraphParams,
    LoopCloser,
    Moment,
    OptimisedGraph,
    PoseGraph,
    Run,
    RunSettings,
    RunWriter,
    SolverParams,
    Step,
    build_pose_graph,
    optimise_pose_graph,
    read_graph,
    read_run,
    trajectory_error,
    write_graph,
    write_run,
)
from .types import (
    Agreement,
    Dataset,
    Features,
    GradientMap,
    Grid,
    LoopClosure,
    LoopDetector,
    Matches,
    Registration,
    Submap,
    SubmapSource,
)

__version__: str

__all__ = [
    "SE2",
    "Agreement",
    "BuildParams",
    "BuildReport",
    "Candidate",
    "ClosureParams",
    "Dataset",
    "DetectionResult",
    "DetectorParams",
    "Drive",
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
    "Inline",
    "InputError",
    "Live",
    "LoopCloser",
    "LoopClosure",
    "LoopDetector",
    "MapParams",
    "MatchParams",
    "Matches",
    "Memo",
    "Moment",
    "OptimisedGraph",
    "PairResult",
    "PipelineParams",
    "Pose",
    "PoseGraph",
    "PrecisionRecall",
    "RecordingSources",
    "Registration",
    "RegistrationParams",
    "Run",
    "RunSettings",
    "RunWriter",
    "Shortlist",
    "SimulationParams",
    "SolverParams",
    "Step",
    "Submap",
    "SubmapSource",
    "TerrainParams",
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
    "open_dataset",
    "optimise_pose_graph",
    "preferred_parameters",
    "read_closures",
    "read_graph",
    "read_parameters",
    "read_run",
    "read_shortlist",
    "refine",
    "register",
    "register_pair",
    "report_closures",
    "resolve_parameters",
    "restore_closures",
    "resume_shortlist",
    "show",
    "simulate_dataset",
    "simulate_recording",
    "trajectory_error",
    "write_closures",
    "write_dataset",
    "write_fitted",
    "write_graph",
    "write_map",
    "write_report",
    "write_run",
    "write_shortlist",
]
