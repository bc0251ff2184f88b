"""A shortlist that several processes look at, in files that the system maps into all of them."""

import pickle
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gpgrad_core.detection.shortlist.candidates import Candidate
from gpgrad_core.detection.shortlist.shortlist import Shortlist, ShortlistState
from gpgrad_core.run.progress import Progress

LARGE = ("global_vectors", "descriptors", "positions")
"""The arrays that are not read but mapped; there are 52 kB of them for each submap."""
REST = "rest.pickle"


@dataclass(frozen=True)
class SharedShortlist:
    """Finds the candidates of a submap in any process; its jobs are ids of submaps.

    Votes are counted in many small steps, for which threads of one process wait: two processes
    take half of the time of one, and two threads two thirds.
    """

    folder: Path  # folder of this machine that nobody else can write, as the rest is a pickle
    count: int  # largest number of candidates
    promising: bool  # whether those that promise no more than chance are left out

    @classmethod
    def of(
        cls, shortlist: Shortlist, folder: Path, count: int, *, promising: bool
    ) -> "SharedShortlist":
        """Write a shortlist into an empty folder, which must stay as long as it is used.

        Raises:
            OSError: If writing fails.
        """
        rest = dict(vars(shortlist.state))
        for name in LARGE:
            np.save(folder / f"{name}.npy", rest.pop(name))
        (folder / REST).write_bytes(pickle.dumps(rest))
        return cls(folder, count, promising)

    def __call__(self, id: str, progress: Progress) -> tuple[Candidate, ...]:
        """Find the candidates among the submaps before one; see `Shortlist.candidates_before`."""
        shortlist = _mapped(self.folder)
        found = shortlist.candidates_before(id, self.count, promising=self.promising)
        progress(1.0)
        return found


@lru_cache(maxsize=1)
def _mapped(folder: Path) -> Shortlist:
    fields: dict[str, Any] = pickle.loads((folder / REST).read_bytes())
    for name in LARGE:
        fields[name] = np.asarray(np.load(folder / f"{name}.npy", mmap_mode="r"))
    return Shortlist.restored(ShortlistState(**fields))
