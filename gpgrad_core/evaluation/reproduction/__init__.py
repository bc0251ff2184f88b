"""The paper's figures, made from any datasets."""

from gpgrad_core.evaluation.reproduction.subject import TITLES, Subject, check_method, study

__all__ = ["TITLES", "Subject", "check_method", "study"]
