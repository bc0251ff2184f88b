"""Evaluates detectors against true poses: precision and recall, and the errors of the motions."""

from gpgrad_core.evaluation.calibration import Calibration, calibrate, describe_calibration
from gpgrad_core.evaluation.experiment import read_rivals, run_methods
from gpgrad_core.evaluation.judge import (
    Accepted,
    Evaluation,
    MethodVerdict,
    Ranked,
    RuleVerdict,
    Summary,
    evaluate,
)
from gpgrad_core.evaluation.overlap import TruePairs, measure_pairs
from gpgrad_core.evaluation.pose_error import PoseErrors, pose_errors
from gpgrad_core.evaluation.precision_recall import (
    Interval,
    PrecisionRecall,
    average_precision,
    best_f1,
    precision_by_inliers,
    precision_recall,
    recall_at_full_precision,
)
from gpgrad_core.evaluation.ranking import Ranking, rank_pairs
from gpgrad_core.evaluation.registration_benchmark import (
    Problem,
    check_problems,
    describe_problems,
    read_problems,
)
from gpgrad_core.evaluation.report import (
    Section,
    check_directory,
    report_evaluation,
    write_report,
)
from gpgrad_core.evaluation.rules import EvaluationParams, Labels, Rule
from gpgrad_core.evaluation.sections import Protocol, describe_images, describe_protocol

__all__ = [
    "Accepted",
    "Calibration",
    "Evaluation",
    "EvaluationParams",
    "Interval",
    "Labels",
    "MethodVerdict",
    "PoseErrors",
    "PrecisionRecall",
    "Problem",
    "Protocol",
    "Ranked",
    "Ranking",
    "Rule",
    "RuleVerdict",
    "Section",
    "Summary",
    "TruePairs",
    "average_precision",
    "best_f1",
    "calibrate",
    "check_directory",
    "check_problems",
    "describe_calibration",
    "describe_images",
    "describe_problems",
    "describe_protocol",
    "evaluate",
    "measure_pairs",
    "pose_errors",
    "precision_by_inliers",
    "precision_recall",
    "rank_pairs",
    "read_problems",
    "read_rivals",
    "recall_at_full_precision",
    "report_evaluation",
    "run_methods",
    "write_report",
]
