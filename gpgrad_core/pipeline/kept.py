"""The pipeline's stages over a store: what an earlier run has made is not made again."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from gpgrad_core.pipeline.all_pairs import SourceDetector
from gpgrad_core.pipeline.detection import ExtractedSubmap, MapDetector, infer_map
from gpgrad_core.registration import Prepared
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.run.store import Store, key_of
from gpgrad_core.run.whole import TemporaryFolder
from gpgrad_core.shortlist import ALL_UP_TO
from gpgrad_core.types import (
    Features,
    GradientMap,
    LoopDetector,
    Registration,
    Submap,
    SubmapSource,
)

D = TypeVar("D", bound=LoopDetector)
R = TypeVar("R")

VIEW_BYTES = 2_000_000
"""Room for what is kept of a submap and its pairs; 30,000 points take half of it."""
LOADED = Memo(200_000_000)
"""Views that this process has loaded, by their keys: it gets a new detector with every job."""


@dataclass(frozen=True, eq=False)
class View:
    """A submap as the comparison sees it: in the store, or here if the store could not take it.

    Attributes:
        source: The submap, from which the view can be made anew.
        key: Key of the view in the store.
        made: What the comparison needs; None if the store has it.
    """

    source: SubmapSource
    key: str
    made: ExtractedSubmap | None = None


@dataclass(frozen=True, eq=False)
class _Mapped:
    """A submap with its map, until its view is made."""

    source: SubmapSource
    key: str
    gradient_map: GradientMap


@dataclass(frozen=True, eq=False)
class KeptDetector(SourceDetector):
    """A `MapDetector` that keeps views and registrations in a store, and takes them from there.

    So a run that was killed goes on where it was, and a second run with another threshold compares
    nothing. Submaps are handed around without their views, which are several times as large, and
    which every process loads as it needs them.

    Attributes:
        detector: What makes views and registrations; with its own maps, not a rival's.
        store: Where they are kept.
    """

    detector: MapDetector
    store: Store

    def infer(self, submap: Submap, progress: Progress = silent) -> View | _Mapped:
        """Make the map, unless the view is in the store."""
        return self.infer_source(submap, progress)

    def infer_source(self, source: SubmapSource, progress: Progress = silent) -> View | _Mapped:
        """Load the submap and make its map, unless the view is in the store."""
        params = self.detector.params
        key = key_of("view", source, params.map, params.features)
        if all(self.store.holds(part) for part in _parts(key)):
            progress(1.0)
            return View(source, key)
        return _Mapped(source, key, self.detector.infer(source.load(), progress))

    def extract(self, made: View | _Mapped, progress: Progress = silent) -> View:
        """Make the view of a map, and put it into the store."""
        if isinstance(made, View):
            progress(1.0)
            return made
        view = self.detector.extract(made.gradient_map, progress)
        return View(made.source, made.key, None if self._put(made.key, view) else view)

    def keypoints(self, extracted: View) -> Features:
        """Give the keypoints of a view."""
        if extracted.made is None:
            kept = self.store.get(_parts(extracted.key)[0])
            if isinstance(kept, Features):
                return kept
        return self._load(extracted).features

    def key(self, extracted: View) -> str:
        """Give the key of a view."""
        return extracted.key

    def keep(self, make: Callable[[], R], *made_from: object) -> R:
        """Return ``make()``, from the store if it was made before from the same."""
        return self.store(make, *made_from)

    def compare(self, query: View, database: View) -> Registration:
        """Register two views, unless that was done before."""
        params = self.detector.params
        return self.store(
            lambda: self.detector.compare(self._load(query), self._load(database)),
            *("pair", query.key, database.key, params.matching, params.registration),
        )

    def _load(self, view: View) -> ExtractedSubmap:
        if view.made is not None:
            return view.made
        return LOADED(self._from_store, view.key, source=view.source)

    def _from_store(self, key: str, *, source: SubmapSource) -> ExtractedSubmap:
        features, prepared = (self.store.get(part) for part in _parts(key))
        if isinstance(features, Features) and isinstance(prepared, Prepared):
            return ExtractedSubmap(features, prepared)
        # It was damaged, or another process needed its room.
        made = self.detector.extract(self.detector.infer(source.load()))
        self._put(key, made)
        return made

    def _put(self, key: str, view: ExtractedSubmap) -> bool:
        """Keep a view: the keypoints apart, because a shortlist needs nothing else."""
        features, prepared = _parts(key)
        return self.store.put(features, view.features) and self.store.put(prepared, view.prepared)


def _parts(key: str) -> tuple[str, str]:
    """Give the keys of a view's two parts: its keypoints, and what is prepared."""
    return key_of(key, "features"), key_of(key, "prepared")


def keeping(detector: D, store: Store | None) -> "D | KeptDetector":
    """Let a detector use a store, if there is one and the detector is the pipeline itself.

    Rivals are not kept: they run to be timed.
    """
    if store is None or not isinstance(detector, MapDetector):
        return detector
    is_own = detector.make_map is infer_map and detector.drawn_from is None
    return KeptDetector(detector, store) if is_own else detector


@contextmanager
def at_least_for_now(store: Store | None, num_submaps: int) -> Generator[Store | None]:
    """Give a store with room for a run; a temporary one if the results of many are not kept.

    Args:
        store: Where results are kept; None if they are not.
        num_submaps: Number of submaps of the run. Of few, the results fit into memory.
    """
    if store is not None:
        yield store.with_room(num_submaps * VIEW_BYTES)
    elif num_submaps <= ALL_UP_TO:
        yield None
    else:
        with TemporaryFolder("gpgrad-results-") as folder:
            yield Store(Path(folder)).with_room(num_submaps * VIEW_BYTES)
