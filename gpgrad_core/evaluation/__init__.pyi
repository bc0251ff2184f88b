from .calibration import Calibration, calibrate, describe_calibration
from .experiment import read_rivals, run_methods
from .judge import Accepted, Evaluation, MethodVerdict, Ranked, RuleVerdict, Summary, evaluate
from .overlap import TruePairs, measure_pairs
from .precision_recall import (
    Interval,
    PrecisionRecall,
    Ranking,
    average_precision,
    best_f1,
    precision_by_inliers,
    rank_pairs,
    recall_at_full_precision,
)
from .registration_benchmark import (
    BenchmarkProblem,
    check_problems,
    describe_problems,
    read_problems,
)
from .report import (
    Protocol,
    Section,
    check_directory,
    describe_evaluation,
    describe_images,
    describe_protocol,
    report_evaluation,
    write_report,
)
from .rules import EvaluationParams, Labels, PoseErrors, Rule, pose_errors

__all__ = [
    "Accepted",
    "BenchmarkProblem",
    "Calibration",
    "Evaluation",
    "EvaluationParams",
    "Interval",
    "Labels",
    "MethodVerdict",
    "PoseErrors",
    "PrecisionRecall",
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
    "describe_evaluation",
    "describe_images",
    "describe_problems",
    "describe_protocol",
    "evaluate",
    "measure_pairs",
    "pose_errors",
    "precision_by_inliers",
    "rank_pairs",
    "read_problems",
    "read_rivals",
    "recall_at_full_precision",
    "report_evaluation",
    "run_methods",
    "write_report",
]
