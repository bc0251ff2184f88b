"""A method made of two pure functions: one describes a submap, the other compares two of them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.types import Registration, Submap

D = TypeVar("D")


@dataclass(frozen=True, eq=False)
class CloudDetector(Generic[D]):
    """A `StagedDetector` made of two functions of a module, so that it can be pickled.

    Attributes:
        describe: Makes everything that the comparison needs of a submap: a frozen dataclass.
        register: Registers its first argument, the query, to its second.
        params: The parameters that both functions get.
        memo: Keeps the descriptions; it is empty at first in another process.
    """

    describe: Callable[[Submap, PipelineParams], D]
    register: Callable[[D, D, PipelineParams], Registration]
    params: PipelineParams
    memo: Memo

    def __call__(self, query: Submap, database: Submap) -> Registration:
        """Register the query to the database."""
        return self.compare(self.extract(query), self.extract(database))

    def infer(self, submap: Submap, progress: Progress = silent) -> Submap:
        """Return the submap itself, because there is no map."""
        progress(1.0)
        return submap

    def extract(self, made: Submap, progress: Progress = silent) -> D:
        """Describe the submap."""
        described = self.memo(self.describe, made, self.params)
        progress(1.0)
        return described

    def compare(self, query: D, database: D) -> Registration:
        """Register two described submaps."""
        return self.register(query, database, self.params)
