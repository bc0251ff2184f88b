"""Keypoints of a gradient map and their descriptors; `registry.DETECTORS` lists the detectors."""

from gpgrad_core.features.extraction import (
    DetectorParams,
    FeatureParams,
    check_detector,
    detect_features,
    extract_features,
    select_trusted,
)
from gpgrad_core.features.registry import DETECTORS

__all__ = [
    "DETECTORS",
    "DetectorParams",
    "FeatureParams",
    "check_detector",
    "detect_features",
    "extract_features",
    "select_trusted",
]
