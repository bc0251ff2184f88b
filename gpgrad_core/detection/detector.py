"""What registers pairs of submaps: one class, of which every method overrides what it needs."""

from collections.abc import Callable
from typing import Any, ClassVar, Generic, TypeAlias, TypeVar

from gpgrad_core.detection.shortlist import Candidates, check_candidates
from gpgrad_core.errors import InputError
from gpgrad_core.gp.likelihood import Hyperparameters
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.types import Features, LoopDetector, Registration, Submap, SubmapSource

R = TypeVar("R")
M = TypeVar("M")
"""What features are extracted from: a map or a prepared cloud."""
E = TypeVar("E")
"""What is extracted of a submap: all that a comparison needs of it."""


class StagedDetector(Generic[M, E]):
    """A `LoopDetector` in stages, so that the work on a single submap is done once.

    Most detectors override ``extract`` and ``compare``. What else can be overridden tells what a
    detector can do: one with ``keypoints`` can be searched by a shortlist. For an executor of
    processes the detector, what it extracts and what it registers must be picklable.
    """

    is_staged: ClassVar[bool] = True
    """Whether there is work on single submaps."""

    def __call__(self, query: Submap, database: Submap) -> Registration:
        """Register the query to the database."""
        return self.compare(self.extract(self.infer(query)), self.extract(self.infer(database)))

    def infer(self, submap: Submap, progress: Progress = silent) -> M:
        """Make what features are extracted from; without an override that is the submap itself."""
        progress(1.0)
        return submap  # type: ignore[return-value] - M is Submap then

    def infer_source(self, source: SubmapSource, progress: Progress = silent) -> M:
        """Do ``infer`` for a submap that may not be loaded yet, or need not be loaded at all."""
        return self.infer(source.load(), progress)

    def extract(self, made: M, progress: Progress = silent) -> E:
        """Extract what the comparison needs of one submap; without an override, all of it."""
        progress(1.0)
        return made  # type: ignore[return-value] - E is M then

    def gather(self, extracted: list[E]) -> list[E]:
        """Add to each extracted submap, in their order, what it needs to know of earlier ones."""
        return extracted

    def compare(self, query: E, database: E) -> Registration:
        """Register two extracted submaps."""
        raise NotImplementedError

    def keypoints(self, extracted: E) -> Features:
        """Give the keypoints by which a shortlist finds the pairs that are worth comparing."""
        raise NotImplementedError

    def hyperparameters(self, extracted: E) -> Hyperparameters | None:
        """Give those that were fitted to this submap; None if they are not fitted to each."""
        del extracted

    def key(self, extracted: E) -> str:
        """Give a key that only the same points and parameters have; empty if nothing is stored."""
        del extracted
        return ""

    def keep(self, make: Callable[[], R], *made_from: object) -> R:
        """Return ``make()``; from the store, if there is one that has it of the same."""
        del made_from
        return make()

    @property
    def has_keypoints(self) -> bool:
        """Whether a shortlist can choose pairs for it."""
        return type(self).keypoints is not StagedDetector.keypoints

    @property
    def is_ordered(self) -> bool:
        """Whether a registration depends on all earlier submaps, as with a bag of words."""
        return type(self).gather is not StagedDetector.gather


AnyDetector: TypeAlias = StagedDetector[Any, Any]


class _Plain(StagedDetector[SubmapSource, SubmapSource]):
    """A callable without stages: submaps are loaded where they are compared."""

    is_staged: ClassVar[bool] = False

    def __init__(self, register: LoopDetector) -> None:
        self.register = register

    def infer_source(self, source: SubmapSource, progress: Progress = silent) -> SubmapSource:
        progress(1.0)
        return source

    def compare(self, query: SubmapSource, database: SubmapSource) -> Registration:
        return self.register(query.load(), database.load())


def as_detector(detector: LoopDetector) -> AnyDetector:
    """Give any callable that registers pairs the stages of a `StagedDetector`."""
    return detector if isinstance(detector, StagedDetector) else _Plain(detector)


def check_searchable(candidates: Candidates, detector: LoopDetector | None) -> None:
    """Raise InputError if a detector (None: the pipeline) cannot choose so many candidates."""
    check_candidates(candidates)
    if isinstance(candidates, str) or detector is None or as_detector(detector).has_keypoints:
        return
    raise InputError(
        f"the detector has no keypoints by which the best {candidates:,} candidates could be "
        "chosen; compare all"
    )
