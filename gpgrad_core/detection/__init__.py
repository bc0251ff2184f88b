"""The order of the stages: one map, one pair, or the pairs of a dataset.

Only this folder knows the order. What a changed parameter does not affect is not computed again.
"""

from gpgrad_core.detection.automatic import (
    describe_choice,
    fit_submap,
    given_hyperparameters,
    is_resolved,
    numbers_stay,
    resolve_parameters,
    with_numbers_of,
)
from gpgrad_core.detection.dataset import (
    DetectionResult,
    ExtractedSubmap,
    MapDetector,
    PairResult,
    check_affordable,
    detect_loop_closures,
    extract_kept,
    infer_features,
    infer_gradient_map,
    infer_map,
    infer_slope_variance,
    judge_pair,
    judge_together,
    register_pair,
    weigh_together,
)
from gpgrad_core.detection.detector import AnyDetector, Detector, as_detector, check_searchable
from gpgrad_core.detection.others import Contexts, Others, own_registration
from gpgrad_core.detection.params import PipelineParams
from gpgrad_core.detection.stored import StoredDetector, store_for_run, with_store

__all__ = [
    "AnyDetector",
    "Contexts",
    "DetectionResult",
    "Detector",
    "ExtractedSubmap",
    "MapDetector",
    "Others",
    "PairResult",
    "PipelineParams",
    "StoredDetector",
    "as_detector",
    "check_affordable",
    "check_searchable",
    "describe_choice",
    "detect_loop_closures",
    "extract_kept",
    "fit_submap",
    "given_hyperparameters",
    "infer_features",
    "infer_gradient_map",
    "infer_map",
    "infer_slope_variance",
    "is_resolved",
    "judge_pair",
    "judge_together",
    "numbers_stay",
    "own_registration",
    "register_pair",
    "resolve_parameters",
    "store_for_run",
    "weigh_together",
    "with_numbers_of",
    "with_store",
]
