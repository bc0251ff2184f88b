"""The order of the stages: one map, one pair, or the pairs of a dataset.

Only this folder knows the order. What a changed parameter does not affect is not computed again.
"""

from gpgrad_core.pipeline.automatic import (
    describe_choice,
    fit_submap,
    given_hyperparameters,
    is_resolved,
    numbers_stay,
    resolve_parameters,
    with_numbers_of,
)
from gpgrad_core.pipeline.detection import (
    DetectionResult,
    ExtractedSubmap,
    MapDetector,
    PairResult,
    check_affordable,
    check_searchable,
    detect_loop_closures,
    extract_kept,
    infer_features,
    infer_map,
    judge_pair,
    register_pair,
)
from gpgrad_core.pipeline.kept import KeptDetector, at_least_for_now, keeping
from gpgrad_core.pipeline.one_map import infer_gradient_map, infer_slope_variance
from gpgrad_core.pipeline.params import PipelineParams

__all__ = [
    "DetectionResult",
    "ExtractedSubmap",
    "KeptDetector",
    "MapDetector",
    "PairResult",
    "PipelineParams",
    "at_least_for_now",
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
    "keeping",
    "numbers_stay",
    "register_pair",
    "resolve_parameters",
    "with_numbers_of",
]
