"""From what a robot recorded to submaps: scans and poses in, a dataset out."""

from gpgrad_core.scans.build import BuildReport, build_dataset, is_recording, open_recording
from gpgrad_core.scans.conditions import Condition, parse_condition
from gpgrad_core.scans.params import BuildParams
from gpgrad_core.scans.recording import Recording, RecordingSources
from gpgrad_core.scans.simulate import simulate_recording

__all__ = [
    "BuildParams",
    "BuildReport",
    "Condition",
    "Recording",
    "RecordingSources",
    "build_dataset",
    "is_recording",
    "open_recording",
    "parse_condition",
    "simulate_recording",
]
