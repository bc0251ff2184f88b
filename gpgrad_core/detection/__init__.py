"""The order of the stages: one map, one pair, or the pairs of a dataset.

Only this folder knows the order. What a changed parameter does not affect is not computed again.
"""

from gpgrad_core.detection.automatic import (
    describe_choice,
    fit_submap,
    fixed_hyperparameters,
    is_resolved,
    numbers_stay,
    resolve_parameters,
    with_numbers_of,
)
from gpgrad_core.detection.engine import AnyDetector, StagedDetector, as_detector, check_searchable
from gpgrad_core.detection.pairs import DetectionResult, Pairs, detect_loop_closures
from gpgrad_core.detection.pipeline import (
    ExtractedSubmap,
    MapDetector,
    PairResult,
    check_affordable,
    extract_keypoints,
    infer_features,
    infer_gradient_map,
    infer_map,
    infer_slope_variance,
    judge_pair,
    register_pair,
)
from gpgrad_core.detection.stages import PipelineParams
from gpgrad_core.detection.stored import StoredDetector, store_for_run, with_store

__all__ = [
    "AnyDetector",
    "DetectionResult",
    "ExtractedSubmap",
    "MapDetector",
    "PairResult",
    "Pairs",
    "PipelineParams",
    "StagedDetector",
    "StoredDetector",
    "as_detector",
    "check_affordable",
    "check_searchable",
    "describe_choice",
    "detect_loop_closures",
    "extract_keypoints",
    "fit_submap",
    "fixed_hyperparameters",
    "infer_features",
    "infer_gradient_map",
    "infer_map",
    "infer_slope_variance",
    "is_resolved",
    "judge_pair",
    "numbers_stay",
    "register_pair",
    "resolve_parameters",
    "store_for_run",
    "with_numbers_of",
    "with_store",
]
