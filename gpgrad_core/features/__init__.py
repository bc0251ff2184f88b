"""Keypoints of a gradient map and their descriptors; `DETECTORS` lists the detectors."""

from gpgrad_core.features.extraction import (
    DETECTORS,
    DetectorParams,
    FeatureParams,
    check_detector,
    detect_features,
    extract_features,
    select_trusted,
)

__all__ = [
    "DETECTORS",
    "DetectorParams",
    "FeatureParams",
    "check_detector",
    "detect_features",
    "extract_features",
    "select_trusted",
]
