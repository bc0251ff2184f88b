"""The table of pairs: what is known of each pair of submaps that was compared."""

from collections.abc import (
    Callable,
    Collection,
    Iterable,
    Iterator,
    Mapping,
    MutableMapping,
    Sequence,
)
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from math import inf, sqrt
from threading import Lock
from time import perf_counter
from typing import Any, TypedDict

import numpy as np
from typing_extensions import Unpack

from gpgrad_core.detection.automatic import is_resolved, resolve_parameters
from gpgrad_core.detection.choosing import CandidateSearch, likely
from gpgrad_core.detection.consistency import Consistency, Contexts
from gpgrad_core.detection.engine import (
    AnyDetector,
    Extracted,
    as_detector,
    check_searchable,
    chosen_blocks,
    compare,
    extract,
    square_blocks,
)
from gpgrad_core.detection.pipeline import FIT_SHARE, MapDetector, check_affordable, judge_pair
from gpgrad_core.detection.shortlist import Candidate, Candidates, num_candidates
from gpgrad_core.detection.stages import PipelineParams
from gpgrad_core.detection.stored import with_store
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.display import card
from gpgrad_core.errors import InputError
from gpgrad_core.gp.likelihood import Hyperparameters
from gpgrad_core.mapping.fitting import representative
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import Store
from gpgrad_core.types import (
    Context,
    Dataset,
    LoopClosure,
    LoopDetector,
    Pair,
    PairOfIds,
    Registration,
    Submap,
    SubmapSource,
)

MOST_LISTED = 20
"""Loop closures that a notebook lists."""
SUBMAPS_SHARE = 0.5
"""Part of the progress that maps and keypoints take."""
CHOICE_SHARE = 0.1
"""Part of the progress that choosing the pairs takes."""
PHASES = {
    "making maps and keypoints": SUBMAPS_SHARE,
    "choosing pairs": SUBMAPS_SHARE + CHOICE_SHARE,
    "comparing pairs": 1.0,
}
"""The fraction at which each phase of a run that chooses its pairs ends."""
IMAGE_BYTES = 200_000_000
"""Of the keypoints of camera images that a table keeps."""


@dataclass(frozen=True, eq=False)
class DetectionResult:
    """The compared pairs of a dataset, each with its verdict.

    Attributes:
        closures: Every unordered pair that was compared once; the database submap is the earlier
            one. Empty if they were handed over one by one.
        seconds: Time of each stage [s]: maps, features, pairs and total; fit, if parameters were
            fitted; and shortlist, if pairs were chosen.
        params: The parameters that the pipeline used, with numbers for all automatic ones; None
            if another detector ran.
        shortlists: By the id of each query that was not compared with all earlier submaps: the
            ones it was compared with and why, the best first.
        hyperparameters: Those of each submap by its id, if the detector fits them to every submap.
    """

    closures: tuple[LoopClosure, ...]
    seconds: dict[str, float]
    params: PipelineParams | None = None
    shortlists: Mapping[str, tuple[Candidate, ...]] = field(
        default_factory=dict[str, tuple[Candidate, ...]]
    )
    hyperparameters: Mapping[str, Hyperparameters] = field(
        default_factory=dict[str, Hyperparameters]
    )

    def _repr_html_(self) -> str:
        accepted = likely(closure for closure in self.closures if closure.accepted)
        head = [
            "query",
            "database",
            *(name for closure in accepted[:1] for name, _ in closure.registration.in_words),
        ]
        rows = [
            [
                closure.query_id,
                closure.database_id,
                *(value for _, value in closure.registration.in_words),
            ]
            for closure in accepted[:MOST_LISTED]
        ]
        more = len(accepted) - len(rows)
        return card(
            f"{len(accepted):,} loop closures in {len(self.closures):,} pairs",
            table=[head, *rows] if rows else (),
            note=f"… and {more:,} of lower score" if more else "",
        )


class Pairs:
    """The table of pairs: submaps in their order, and what is known of each compared pair.

    `compare` registers the pairs of all submaps at once, `add` those of one submap more, and
    `judge` gives the verdicts under any thresholds, which takes no time. Whatever the way, the
    same submaps have the same registrations and verdicts.

    Attributes:
        submaps: The submaps so far; those that were added one by one have no points.
        params: Parameters of all stages; automatic ones have numbers once pairs are compared.
        detector: What registers the pairs; None until the pipeline's own is made.
        seconds: Time of each stage of `compare` [s]; see `DetectionResult`.
        shortlists: The candidates of each submap that was not compared with all earlier ones.
        hyperparameters: Those of each submap, if the detector fits them to every submap.
    """

    def __init__(
        self,
        submaps: Iterable[Submap] = (),
        params: PipelineParams | None = None,
        detector: LoopDetector | None = None,
        *,
        candidates: Candidates = "automatic",
        memo: Memo | None = None,
        store: Store | None = None,
        registered: MutableMapping[PairOfIds, Registration] | None = None,
        bytes_in_memory: float = inf,
    ) -> None:
        """Make a table in which no pair is compared yet; see `detect_loop_closures`.

        ``registered`` has registrations of an earlier run with the same parameters, and gets each
        new one. ``bytes_in_memory`` of what is extracted stay in memory, the rest in a temporary
        folder, which `close` removes.
        """
        check_searchable(candidates, detector)
        self.submaps = list(submaps)
        self.params = params or PipelineParams()
        self.detector: AnyDetector | None = None if detector is None else as_detector(detector)
        self.seconds: dict[str, float] = {}
        self.shortlists: dict[str, tuple[Candidate, ...]] = {}
        self.hyperparameters: dict[str, Hyperparameters] = {}
        self._index = {submap.id: k for k, submap in enumerate(self.submaps)}
        self._candidates: Candidates = candidates
        self._memo, self._store, self._registered = memo, store, registered
        self._is_pipeline = detector is None
        self._extracted = Extracted(bytes_in_memory)
        self._waiting: dict[int, Submap] = {}  # of which nothing is extracted before it is needed
        self._search: CandidateSearch[Any, Any] | None = None
        self._registrations: dict[Pair, Registration] = {}
        # what no threshold on inliers or dissimilarity and no image refuses: scores for the pairs
        # alone, and standard deviations of positions [m]
        self._passing: dict[Pair, tuple[float, float]] = {}
        self._unchecked: list[Pair] = []  # whether they do
        self._accepted: tuple[tuple[int, int], Mapping[PairOfIds, float]] = (0, 0), {}
        self._weighed: dict[str, tuple[tuple[int, int], Consistency, Contexts]] = {}
        self._weighing = Lock()
        self._images = Memo(IMAGE_BYTES)

    @classmethod
    def of(
        cls,
        submaps: Iterable[Submap],
        registered: Mapping[PairOfIds, Registration],
        params: PipelineParams,
        detector: LoopDetector | None = None,
    ) -> "Pairs":
        """Make the table of pairs that were registered before, each with its score alone."""
        pairs = cls(submaps, params, detector)
        pairs._put({pairs._pair(pair): registration for pair, registration in registered.items()})
        return pairs

    def __len__(self) -> int:
        return len(self._registrations)

    def close(self) -> None:
        self._extracted.close()

    def resolve(
        self, sources: Sequence[SubmapSource] | None = None, progress: Progress = silent
    ) -> Progress:
        """Make the pipeline's detector, unless there is one; gives the progress of what is left."""
        if self.detector is not None:
            return progress
        sources = self.submaps if sources is None else sources
        for source in sources:
            check_affordable(source.load(), self.params)
        memo, start = self._memo or Memo(), perf_counter()
        if sources and not is_resolved(self.params):
            some = [sources[k].load() for k in representative(len(sources))]
            fitting = part(progress, 0.0, FIT_SHARE)
            self.params = resolve_parameters(some, self.params, memo, fitting)
            self.seconds["fit"] = perf_counter() - start
            progress = part(progress, FIT_SHARE, 1.0)
        self.detector = with_store(MapDetector(self.params, memo), self._store)
        return progress

    def compare(
        self,
        which: Collection[PairOfIds] | None = None,
        executor: Executor | None = None,
        progress: Progress = silent,
        *,
        sources: Sequence[SubmapSource] | None = None,
        fit_to: Sequence[SubmapSource] | None = None,
        on_verdict: Callable[[LoopClosure], None] | None = None,
    ) -> None:
        """Register pairs of all submaps that were not registered yet; see `detect_loop_closures`.

        ``which`` are ids in either order, and only their submaps get maps; None takes the
        candidates of every submap. ``sources`` load the submaps whose points the table lacks;
        automatic parameters are fitted to them, or to those in ``fit_to``.
        ``on_verdict`` is called with each verdict once it is final: if other pairs count, after the
        last pair.

        Raises:
            InputError: If a submap's map cannot be made, or if a pair is a submap with itself.
        """
        chosen = None if which is None else self._listed(which)
        sources = self.submaps if sources is None else sources
        progress = self.resolve(sources if fit_to is None else fit_to, progress)
        names = [submap.id for submap in self.submaps]
        some = range(len(names)) if chosen is None else sorted({k for two in chosen for k in two})
        spent = self._extract(
            {k: sources[k] for k in some}, executor, part(progress, 0.0, SUBMAPS_SHARE)
        )
        spent["pairs"], first, start = 0.0, SUBMAPS_SHARE, perf_counter()
        resumes = self._registered is not None or len(self) > 0
        if chosen is not None or resumes or self._searches(len(names)):
            choosing = part(progress, first, first + CHOICE_SHARE)
            chosen = self._choose(names, executor, choosing) if chosen is None else chosen
            spent["shortlist"], start = perf_counter() - start, perf_counter()
            first += CHOICE_SHARE
        at_once = self.params.closure.others == "off" and self._registered is None

        def take(pair: Pair, registration: Registration) -> None:
            self._registrations[pair] = registration
            if at_once and on_verdict is not None:
                on_verdict(self._verdict(pair, self.params))

        self._register(names, chosen, take, executor, part(progress, first, 1.0))
        self._put({})
        spent["pairs"] = perf_counter() - start
        fit = {"fit": self.seconds["fit"]} if "fit" in self.seconds else {}
        self.seconds = {**spent, "total": sum((spent | fit).values()), **fit}
        if on_verdict is not None and not at_once:
            for closure in self.judge():
                on_verdict(closure)

    def add(
        self,
        submap: Submap,
        executor: Executor | None = None,
        progress: Progress = silent,
        *,
        among: Collection[str] | None = None,
    ) -> list[PairOfIds]:
        """Add one submap, choose its candidates, and return the pairs that were compared.

        Its points are not stored. If the progress raises Cancelled, or anything fails, it is not
        added. ``among`` are ids of earlier submaps that may be candidates; None takes all.

        Raises:
            InputError: If the id is not new, if its map cannot be made, or if an image that is
                needed for a verdict cannot be read.
            OSError: If a process of the executor has died.
        """
        if submap.id in self._index:
            raise InputError(f"submap {submap.id} was already added; ids must differ")
        self.resolve([submap])
        assert self.detector is not None
        new, searches = len(self.submaps), self._searches(None)
        names = [*(other.id for other in self.submaps), submap.id]
        near = [k for k in range(new) if among is None or names[k] in among]
        try:
            if self._registered is not None and not searches:
                self._waiting[new] = submap
            else:
                self._extract({new: submap}, None, part(progress, 0.0, SUBMAPS_SHARE))
            best = None
            if searches:
                among = None if len(near) == new else [names[k] for k in near]
                best = self._searching.find(self._extracted.get(new), among, len(near))
            if best is not None:
                chosen = {candidate.id for candidate in best}
                near = [k for k in near if names[k] in chosen]
            compared, near_pairs = dict[Pair, Registration](), [(new, k) for k in near]
            rest = progress if new in self._waiting else part(progress, SUBMAPS_SHARE, 1.0)
            self._register(names, near_pairs, compared.__setitem__, executor, rest)
            compared = {pair: compared[pair] for pair in near_pairs}
            bare = replace(submap, points=np.empty((0, 3)), colors=None, noise_std=None)
            passing = self._pass(compared, bare)
        except BaseException:
            self._extracted.drop(new)
            self._waiting.pop(new, None)
            raise
        if searches:
            self._searching.add(submap.id, self._extracted.get(new))
        if best is not None:
            self.shortlists[submap.id] = best
        self._registrations.update(compared)
        self._passing |= passing
        self._index[submap.id] = new
        self.submaps.append(bare)
        return [(names[query], names[database]) for query, database in compared]

    def judge(
        self, thresholds: ClosureParams | None = None, pairs: Iterable[PairOfIds] | None = None
    ) -> Iterator[LoopClosure]:
        """The verdicts under thresholds (None: the table's), each with what the others say."""
        params = self.params if thresholds is None else replace(self.params, closure=thresholds)
        contexts = self._contexts(params.closure.others)
        for pair in list(self._registrations) if pairs is None else map(self._pair, pairs):
            yield self._verdict(pair, params, contexts.get(pair))

    def result(self, closures: Iterable[LoopClosure] = ()) -> DetectionResult:
        """Make a result of some verdicts and of all that is known of the run."""
        params = self.params if self._is_pipeline else None
        return DetectionResult(
            tuple(closures), self.seconds, params, self.shortlists, self.hyperparameters
        )

    @property
    def variance_factor(self) -> float:
        """By how much variances are multiplied now; see `Context`."""
        return self._contexts(self.params.closure.others).variance_factor

    @property
    def accepted(self) -> Mapping[PairOfIds, float]:
        """Scores of the pairs that are accepted now, by ids; quicker than `judge`."""
        count = len(self.submaps), len(self._registrations)
        if self._accepted[0] != count:
            self._passing |= self._pass({k: self._registrations[k] for k in self._unchecked})
            self._unchecked = []
            contexts = self._contexts(self.params.closure.others)
            scores, spread = contexts.scores, sqrt(contexts.variance_factor)
            weighed = {
                pair: (scores[pair], spread * std) if pair in scores else (alone, std)
                for pair, (alone, std) in self._passing.items()
            }
            closure, ids = self.params.closure, [submap.id for submap in self.submaps]
            accepted = {
                (ids[query], ids[database]): score
                for (query, database), (score, std) in weighed.items()
                if score >= closure.min_score and std <= closure.max_std
            }
            self._accepted = count, accepted
        return self._accepted[1]

    def _pair(self, pair: PairOfIds) -> Pair:
        return self._index[pair[0]], self._index[pair[1]]

    def _listed(self, which: Collection[PairOfIds]) -> list[Pair]:
        for query, database in which:
            if query == database:
                raise InputError(
                    f"{query} beside itself is no pair; name two different submaps in 'only'"
                )
        index = self._index
        pairs = [self._pair(pair) for pair in which if index.keys() >= set(pair)]
        return sorted({(max(pair), min(pair)) for pair in pairs})

    def _new_search(self) -> CandidateSearch[Any, Any]:
        assert self.detector is not None
        return CandidateSearch(self.detector, self._candidates, self.params.registration.seed)

    @property
    def _searching(self) -> CandidateSearch[Any, Any]:
        if self._search is None:
            self._search = self._new_search()
            for k, submap in enumerate(self.submaps):
                self._search.add(submap.id, self._extracted.get(k))
        return self._search

    def _searches(self, num_submaps: int | None) -> bool:
        """Whether a shortlist chooses candidates; None if any number of submaps may come."""
        if self.detector is None or not self.detector.has_keypoints or self._candidates == "all":
            return False
        return num_submaps is None or any(
            num_candidates(self._candidates, k) < k for k in range(num_submaps)
        )

    def _choose(
        self, names: Sequence[str], executor: Executor | None, progress: Progress
    ) -> list[Pair]:
        if self._searches(len(names)):
            extracted = [self._extracted.get(k) for k in range(len(names))]
            self.shortlists = self._new_search().find_all(names, extracted, executor, progress)
        return [
            (query, earlier)
            for query, name in enumerate(names)
            for earlier in (
                range(query)
                if name not in self.shortlists
                else sorted(self._index[candidate.id] for candidate in self.shortlists[name])
            )
        ]

    def _extract(
        self, sources: Mapping[int, SubmapSource], executor: Executor | None, progress: Progress
    ) -> dict[str, float]:
        assert self.detector is not None
        extracted, seconds = extract([*sources.values()], self.detector, executor, progress)
        start = perf_counter()
        extracted = self.detector.gather(extracted)
        for (k, source), one in zip(sources.items(), extracted, strict=True):
            self._extracted.put(k, one)
            if (own := self.detector.hyperparameters(one)) is not None:
                self.hyperparameters[source.id] = own
        seconds["features"] += perf_counter() - start
        return seconds

    def _register(
        self,
        names: Sequence[str],
        chosen: Sequence[Pair] | None,
        take: Callable[[Pair, Registration], None],
        executor: Executor | None,
        progress: Progress,
    ) -> None:
        """Register pairs (None: all), unless an earlier run has, and hand them over."""
        assert self.detector is not None
        registered = self._registered

        def keep(pair: Pair, registration: Registration) -> None:
            if registered is not None:
                registered[names[pair[0]], names[pair[1]]] = registration
            take(pair, registration)

        if chosen is None:
            rows = square_blocks(len(names), executor)
        else:
            missing = list[Pair]()
            for pair in chosen:
                if pair in self._registrations:
                    continue
                earlier = (registered or {}).get((names[pair[0]], names[pair[1]]))
                if earlier is None:
                    missing.append(pair)
                else:
                    take(pair, earlier)
            needed = {k for pair in missing for k in pair} & self._waiting.keys()
            if needed:
                sources = {k: self._waiting[k] for k in sorted(needed)}
                self._extract(sources, executor, part(progress, 0.0, SUBMAPS_SHARE))
                for k in needed:
                    del self._waiting[k]
                progress = part(progress, SUBMAPS_SHARE, 1.0)
            rows = chosen_blocks(missing, executor)
        compare(rows, self._extracted, self.detector, keep, executor, progress)

    def _put(self, registrations: Mapping[Pair, Registration]) -> None:
        self._registrations = dict(sorted({**self._registrations, **registrations}.items()))
        self._weighed.clear()
        self._passing, self._unchecked = {}, list(self._registrations)

    def _contexts(self, others: str) -> Contexts:
        speaks = others == "odometry"
        if others == "off" or (not speaks and len(self._registrations) < 2):
            return Contexts({})
        with self._weighing:  # any thread may ask first
            count = len(self.submaps), len(self._registrations)
            weighed = self._weighed.get(others)
            if weighed is None or weighed[0] != count:
                odometry = [
                    submap.pose_odometry.planar if speaks and submap.pose_odometry else None
                    for submap in self.submaps
                ]
                weigher = Consistency() if weighed is None else weighed[1]
                centres = [submap.centre for submap in self.submaps]
                contexts = weigher.weigh(self._registrations, odometry, centres)
                self._weighed[others] = weighed = count, weigher, contexts
            return weighed[2]

    def _verdict(
        self, pair: Pair, params: PipelineParams, context: Context | None = None
    ) -> LoopClosure:
        query, database = (self.submaps[k] for k in pair)
        registration = self._registrations[pair]
        return judge_pair(query, database, registration, params, self._images, context)

    def _pass(
        self, registrations: Mapping[Pair, Registration], new: Submap | None = None
    ) -> dict[Pair, tuple[float, float]]:
        """Find the pairs that only their scores or deviations can refuse, and return these."""
        submaps = self.submaps if new is None else [*self.submaps, new]
        return {
            (query, database): (registration.score, registration.position_std or 0.0)
            for (query, database), registration in registrations.items()
            if judge_pair(
                submaps[query],
                submaps[database],
                replace(registration, score=inf, covariance=None),
                self.params,
                self._images,
            ).accepted
        }


class MoreOptions(TypedDict, total=False):
    """What few callers of `detect_loop_closures` need."""

    sources: Sequence[SubmapSource] | None
    take: Callable[[LoopClosure], None] | None
    registered: MutableMapping[PairOfIds, Registration] | None


def detect_loop_closures(
    dataset: Dataset,
    params: PipelineParams | None = None,
    *,
    detector: LoopDetector | None = None,
    candidates: Candidates = "automatic",
    executor: Executor | None = None,
    memo: Memo | None = None,
    progress: Progress = silent,
    only: Collection[PairOfIds] | None = None,
    **more: Unpack[MoreOptions],
) -> DetectionResult:
    """Compare every submap with earlier ones: with all of them, or with those worth comparing.

    Parameters that are automatic are fitted to the dataset first (`resolve_parameters`).

    Args:
        dataset: The submaps in order.
        params: Parameters of all stages; with a detector, only those of the verdict are used.
        detector: Another way to register pairs; None uses the pipeline.
        candidates: With how many earlier submaps a submap is compared: a number, ``all``, or
            ``automatic``, which is all of up to 200 earlier ones, and up to 30 of more. The
            `Shortlist` chooses them by the keypoints; ``automatic`` is ``all`` for a detector
            without any.
        executor: Threads or processes that share the work; None does everything in this thread.
            The result is the same. For processes the detector must be picklable.
        memo: Shares results with other calls; None keeps what this call needs. Other processes do
            not fill it.
        progress: Called from this thread from time to time; may raise Cancelled.
        only: Ids of the pairs to compare, in either order; then candidates are not chosen, and
            submaps of none of them get no map. None compares as the candidates say.
        more: ``sources``, where the submaps are loaded from, as `open_dataset` gives them; without
            them the dataset has their points. ``take``, called with each verdict in place of
            collecting them, as soon as it is final. ``registered``, registrations by the ids
            (query, database) of an earlier run with the same parameters and candidates that did
            not end: they are not compared again, and each other one is put in.

    Returns:
        The verdict on every compared pair, sorted by query and then by database.

    Raises:
        InputError: If a submap's map cannot be made, if ``only`` pairs a submap with itself, if the
            number of candidates is none that is allowed, or if the detector has no keypoints to
            choose them by.
    """
    submaps, registered = dataset.submaps, more.get("registered")
    every = sources = more.get("sources") or submaps
    if only is not None:
        names = {name for pair in only for name in pair}
        submaps = tuple(submap for submap in submaps if submap.id in names)
        sources = [source for source in sources if source.id in names]
    pairs = Pairs(
        submaps, params, detector, candidates=candidates, memo=memo, registered=registered
    )
    closures: list[LoopClosure] = []
    take = more.get("take") or closures.append
    pairs.compare(only, executor, progress, sources=sources, fit_to=every, on_verdict=take)
    return pairs.result(closures)
