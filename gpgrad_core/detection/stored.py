"""The pipeline's stages over a store: what an earlier run has made is not made again."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from gpgrad_core.detection.engine import StagedDetector
from gpgrad_core.detection.pipeline import ExtractedSubmap, MapDetector, infer_map
from gpgrad_core.detection.shortlist import ALL_UP_TO
from gpgrad_core.detection.stages import PREPARE, SELECT, key_of_stage
from gpgrad_core.registration import Prepared
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import Store, key_of
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

STORED = (SELECT, PREPARE)
"""The stages whose results are stored: all that a comparison needs of a submap."""
VIEW_BYTES = 2_000_000
"""Room for the results of a submap and its pairs."""
LOADED = Memo(100_000_000)
"""Views that this process has loaded, by their keys: it gets a new detector with every job."""


@dataclass(frozen=True, eq=False)
class StoredSubmap:
    """A submap as the comparison sees it: in the store, or here if the store could not take it."""

    source: SubmapSource
    features_key: str  # a shortlist needs nothing else
    prepared_key: str
    extracted: ExtractedSubmap | None = None  # None if the store has it

    @property
    def key(self) -> str:
        return f"{self.features_key} {self.prepared_key}"


@dataclass(frozen=True, eq=False)
class _Mapped:
    view: StoredSubmap
    gradient_map: GradientMap


@dataclass(frozen=True, eq=False)
class StoredDetector(StagedDetector[StoredSubmap | _Mapped, StoredSubmap]):
    """A `MapDetector` that keeps views and registrations in a store, and takes them from there."""

    detector: MapDetector  # what makes views and registrations; with its own maps, not a rival's
    store: Store  # where they are kept

    def infer(self, submap: Submap, progress: Progress = silent) -> StoredSubmap | _Mapped:
        return self.infer_source(submap, progress)

    def infer_source(
        self, source: SubmapSource, progress: Progress = silent
    ) -> StoredSubmap | _Mapped:
        features_key, prepared_key = (
            key_of(*key_of_stage(stage, self.detector.params, source)) for stage in STORED
        )
        view = StoredSubmap(source, features_key, prepared_key)
        if self.store.holds(view.features_key) and self.store.holds(view.prepared_key):
            progress(1.0)
            return view
        return _Mapped(view, self.detector.infer(source.load(), progress))

    def extract(
        self, inferred: StoredSubmap | _Mapped, progress: Progress = silent
    ) -> StoredSubmap:
        if isinstance(inferred, StoredSubmap):
            progress(1.0)
            return inferred
        extracted = self.detector.extract(inferred.gradient_map, progress)
        if self._put(inferred.view, extracted):
            return inferred.view
        return replace(inferred.view, extracted=extracted)

    def keypoints(self, extracted: StoredSubmap) -> Features:
        if extracted.extracted is None:
            features = self.store.get(extracted.features_key)
            if isinstance(features, Features):
                return features
        return self._load(extracted).features

    def key(self, extracted: StoredSubmap) -> str:
        return extracted.key

    def keep(self, make: Callable[[], R], *inputs: object) -> R:
        return self.store(make, *inputs)

    def compare(self, query: StoredSubmap, database: StoredSubmap) -> Registration:
        params = self.detector.params
        return self.store(
            lambda: self.detector.compare(self._load(query), self._load(database)),
            *("pair", query.key, database.key, params.matching, params.registration),
        )

    def _load(self, view: StoredSubmap) -> ExtractedSubmap:
        if view.extracted is not None:
            return view.extracted
        return LOADED(self._from_store, view.key, view=view)

    def _from_store(self, key: str, *, view: StoredSubmap) -> ExtractedSubmap:
        del key  # by which `LOADED` knows the view
        features, prepared = (self.store.get(key) for key in (view.features_key, view.prepared_key))
        if isinstance(features, Features) and isinstance(prepared, Prepared):
            return ExtractedSubmap(features, prepared)
        # It was damaged, or another process needed its room.
        extracted = self.detector.extract(self.detector.infer(view.source.load()))
        self._put(view, extracted)
        return extracted

    def _put(self, view: StoredSubmap, extracted: ExtractedSubmap) -> bool:
        return self.store.put(view.features_key, extracted.features) and self.store.put(
            view.prepared_key, extracted.prepared
        )


def with_store(detector: D, store: Store | None) -> "D | StoredDetector":
    """Let the pipeline's own detector use a store; rivals run to be timed, so nothing is stored."""
    if store is None or not isinstance(detector, MapDetector):
        return detector
    is_own = detector.make_map is infer_map and detector.drawn_from is None
    return StoredDetector(detector, store) if is_own else detector


@contextmanager
def store_for_run(store: Store | None, num_submaps: int) -> Generator[Store | None]:
    """A store with room for a run: a temporary one for many submaps, none for few."""
    if store is not None:
        yield store.with_room(num_submaps * VIEW_BYTES)
    elif num_submaps <= ALL_UP_TO:
        yield None
    else:
        with TemporaryFolder("gpgrad-results-") as folder:
            yield Store(Path(folder)).with_room(num_submaps * VIEW_BYTES)
