"""How many earlier submaps a submap is compared with, and why each of them was chosen."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

from gpgrad_core.errors import InputError
from gpgrad_core.params import AUTOMATIC

Candidates: TypeAlias = int | Literal["all", "automatic"]
"""How many earlier submaps a submap is compared with at most."""

ALL_UP_TO = 200
"""With ``automatic``, a submap with up to this many earlier ones is compared with all of them."""
DEFAULT_CANDIDATES = 30
"""With ``automatic``, a submap with more earlier ones is compared with this many at most: with
those that promise more than chance."""
MOST_CANDIDATES = 1_000_000


@dataclass(frozen=True, slots=True)
class Candidate:
    """An earlier submap that is worth comparing, and what speaks for it.

    Attributes:
        id: Id of the earlier submap.
        votes: Number of associations between the strongest keypoints of both submaps whose
            distances from each other agree. 0 if the associations were not looked at, because too
            many others were more similar.
        similarity: Cosine of the angle between the global vectors of both submaps, in [-1, 1]. 0
            as long as there are too few submaps to make such vectors.
    """

    id: str
    votes: int
    similarity: float


def read_candidates(word: str) -> Candidates:
    """Read the value of ``--candidates``: ``all``, ``automatic`` or a whole number.

    Raises:
        InputError: If it is something else.

    >>> read_candidates("30"), read_candidates("all")
    (30, 'all')
    """
    if word == "all":
        return "all"
    if word == AUTOMATIC:
        return "automatic"
    if not (word.isascii() and word.isdigit() and len(word) < 10):
        raise InputError(f"--candidates must be a whole number, all or automatic, got {word!r}")
    return check_candidates(int(word))


def check_candidates(candidates: Candidates, where: str = "") -> Candidates:
    """Raise InputError unless 1 to a million; `where`, the file that has it, begins the message."""
    if isinstance(candidates, int) and not 1 <= candidates <= MOST_CANDIDATES:
        raise InputError(
            f"{where}{': ' * bool(where)}the candidates must be 1 to {MOST_CANDIDATES:,} submaps, "
            f"got {candidates:,}"
        )
    return candidates


def num_wanted(candidates: Candidates, num_earlier: int) -> int:
    """Count the earlier submaps to compare a submap with at most.

    >>> num_wanted("automatic", 200), num_wanted("automatic", 5000), num_wanted(50, 10)
    (200, 30, 10)
    """
    if candidates == "all" or (candidates == "automatic" and num_earlier <= ALL_UP_TO):
        return num_earlier
    wanted = DEFAULT_CANDIDATES if candidates == "automatic" else candidates
    return min(wanted, num_earlier)
