"""Registers a pair of maps: candidate motions, their alignment, and the score."""

from gpgrad_core.registration.agreement import map_agreement
from gpgrad_core.registration.params import RegistrationParams
from gpgrad_core.registration.register import (
    Prepared,
    prepare,
    refine,
    register,
    register_prepared,
)
from gpgrad_core.registration.search import search_motions

__all__ = [
    "Prepared",
    "RegistrationParams",
    "map_agreement",
    "prepare",
    "refine",
    "register",
    "register_prepared",
    "search_motions",
]
