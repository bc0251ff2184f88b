"""The shortlist: which earlier submaps are worth comparing with a new one."""

from gpgrad_core.detection.shortlist.candidates import (
    ALL_UP_TO,
    DEFAULT_CANDIDATES,
    Candidate,
    Candidates,
    check_candidates,
    num_wanted,
    read_candidates,
)
from gpgrad_core.detection.shortlist.shortlist import Shortlist, ShortlistState
from gpgrad_core.detection.shortlist.vocabulary import Vocabulary

__all__ = [
    "ALL_UP_TO",
    "DEFAULT_CANDIDATES",
    "Candidate",
    "Candidates",
    "Shortlist",
    "ShortlistState",
    "Vocabulary",
    "check_candidates",
    "num_wanted",
    "read_candidates",
]
