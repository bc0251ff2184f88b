"""Keypoints of a gradient map and their descriptors; each detector has its own file."""

from gpgrad_core.features.extraction import (
    DetectorName,
    DetectorParams,
    FeatureParams,
    check_detector,
    detect_features,
    extract_features,
    select_trusted,
)

__all__ = [
    "DetectorName",
    "DetectorParams",
    "FeatureParams",
    "check_detector",
    "detect_features",
    "extract_features",
    "select_trusted",
]
