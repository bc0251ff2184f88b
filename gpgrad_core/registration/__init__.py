"""Registers a pair of maps: hypotheses, alignment, and how surprising their agreement is."""

from gpgrad_core.registration.params import RegistrationParams
from gpgrad_core.registration.register import (
    Prepared,
    prepare,
    refine,
    register,
    register_prepared,
)

__all__ = ["Prepared", "RegistrationParams", "prepare", "refine", "register", "register_prepared"]
