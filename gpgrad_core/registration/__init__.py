"""Registers a pair of maps: candidate motions, their alignment, and the score."""

from gpgrad_core.registration.params import RegistrationParams
from gpgrad_core.registration.register import refine, register, register_prepared, search_candidates
from gpgrad_core.registration.score import map_agreement
from gpgrad_core.registration.surface import Prepared, prepare

__all__ = [
    "Prepared",
    "RegistrationParams",
    "map_agreement",
    "prepare",
    "refine",
    "register",
    "register_prepared",
    "search_candidates",
]
