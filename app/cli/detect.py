"""``gpgrad detect``: register, score and judge pairs of submaps, on this machine or a cluster."""

import contextlib
import math
import sys
from collections.abc import Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import tyro
from typing_extensions import Doc

from app.cli.events import EVENTS, Closure
from app.cli.flags import Overwrite
from app.cli.inputs import (
    ALL_PARAMS,
    USERS_CACHE,
    AllParams,
    Cache,
    CandidatesFlag,
    DatasetPath,
    ParamsFile,
    asked_params,
    load_sources,
    open_store,
    resolved,
    tell_damaged,
)
from app.cli.terminal import conclude, progress_bar
from app.recordings import built_first
from gpgrad_core.detection import (
    Pairs,
    PipelineParams,
    check_affordable,
    is_resolved,
    store_for_run,
    with_store,
)
from gpgrad_core.detection.shortlist import Candidates, num_wanted, read_candidates
from gpgrad_core.errors import InputError, count
from gpgrad_core.io.folder import MOST_LOADED, Outline, outline_dataset
from gpgrad_core.io.records.closures import (
    ClosureWriter,
    count_images,
    report_closures,
    rounded,
    row_of,
)
from gpgrad_core.io.records.files import check_apart, check_output
from gpgrad_core.mapping.fitting import representative
from gpgrad_core.methods import METHODS, Method, find_method
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import Cluster, connected, workers
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import num_workers
from gpgrad_core.slam import build_pose_graph, odometry_poses, write_graph
from gpgrad_core.types import Dataset, ImageVerdict, LoopClosure

SchedulerFlag: TypeAlias = Annotated[
    str | None,
    Doc(
        "Address of a Dask scheduler, such as tcp://10.0.0.7:8786, to whose workers the work is "
        "given."
    ),
    tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: this machine's cores)"),
]


@dataclass(frozen=True)
class Detect:
    """Arguments of ``gpgrad detect``."""

    dataset: DatasetPath
    out: Annotated[
        Path,
        Doc("File to write the pairs and their verdicts to."),
        tyro.conf.arg(metavar="FILE.json"),
    ]
    method: Annotated[
        str, Doc(f"Method of detection: {', '.join(METHODS)}."), tyro.conf.arg(metavar="NAME")
    ] = "gradient"
    g2o: Annotated[
        Path | None,
        Doc("Also write the pose graph to this file."),
        tyro.conf.arg(metavar="FILE.g2o"),
    ] = None
    pair: Annotated[
        tyro.conf.DisallowNone[tuple[str, str] | None],
        Doc("Compare only these two submaps, given by their ids."),
        tyro.conf.arg(metavar="QUERY DATABASE", help_behavior_hint="(default: all pairs)"),
    ] = None
    candidates: CandidatesFlag = "automatic"
    scheduler: SchedulerFlag = None
    overwrite: Overwrite = False
    cache: Cache = USERS_CACHE
    params: ParamsFile = None
    pipeline: AllParams = ALL_PARAMS

    def run(self) -> None:
        """Detect and write."""
        candidates = read_candidates(self.candidates)
        method = find_method(self.method)
        method.check_searchable(candidates)
        check_output(self.out, (".json",), overwrite=self.overwrite)
        if self.g2o:
            check_output(self.g2o, (".g2o",), overwrite=self.overwrite)
        check_apart([self.out, self.g2o], [self.dataset, self.params])
        if self.pair is not None and self.candidates != "automatic":
            raise InputError(
                f"--pair compares two submaps, and --candidates {self.candidates} says how many "
                "others each is compared with; leave one of the two out"
            )
        if self.pair is not None and self.pair[0] == self.pair[1]:
            raise InputError(
                f"--pair: {self.pair[0]} beside itself is no pair; name two different submaps"
            )
        store = open_store(self.cache)
        with built_first(self.dataset):
            outline = outline_dataset(self.dataset)
        asked = asked_params(outline.dataset, self.params, self.pipeline)
        if self.g2o:
            odometry_poses(outline.dataset)  # refuses a dataset without odometry before the work
        with built_first(self.dataset):
            compared = compare(
                outline,
                asked,
                self.out,
                method=method,
                store=store,
                candidates=candidates,
                scheduler=self.scheduler,
                pair=self.pair,
            )
        if self.g2o:
            write_graph(self.g2o, build_pose_graph(compared.dataset, compared.accepted))
        skipped, num_submaps = compared.num_pairs_skipped, len(compared.dataset.submaps)
        left_out = f" ({skipped:,} were not compared)" if skipped else ""
        conclude(
            f"{count(len(compared.accepted), 'loop closure')} in "
            f"{count(compared.num_pairs, 'pair')}{left_out} of {count(num_submaps, 'submap')}, "
            f"{compared.seconds['total']:.1f} s: {self.out}",
            *((compared.images,) if compared.images else ()),
            output=self.out,
            closures=len(compared.accepted),
            pairs=compared.num_pairs,
            skipped=skipped,
            submaps=num_submaps,
            seconds=compared.seconds["total"],
        )


@dataclass(frozen=True, eq=False)
class Compared:
    """What came of the pairs.

    Attributes:
        dataset: The dataset that was searched, without its points.
        accepted: The loop closures.
        num_pairs: Number of pairs that were compared.
        num_pairs_skipped: Number of those that were not.
        images: What camera images say, counted in words; empty if they were not asked.
        seconds: Time of each stage [s].
    """

    dataset: Dataset
    accepted: tuple[LoopClosure, ...]
    num_pairs: int
    num_pairs_skipped: int
    images: str
    seconds: Mapping[str, float]


def compare(
    outline: Outline,
    asked: PipelineParams,
    out: Path,
    *,
    method: Method,
    store: Store | None,
    candidates: Candidates,
    scheduler: str | None = None,
    pair: tuple[str, str] | None = None,
) -> Compared:
    """Compare the pairs of a dataset, and write ``closures.json`` as they are compared.

    Args:
        outline: The dataset.
        asked: Parameters of all stages; what is automatic is fitted to the whole dataset, so that
            a single pair gets the same verdict.
        out: The file to write.
        method: The method of detection.
        store: Keeps results; None keeps them in memory, or in a folder for now.
        candidates: With how many earlier submaps a submap is compared.
        scheduler: Address of a cluster; None takes this machine.
        pair: Ids of the only two submaps to compare, the query first; None compares all.
    """
    check = partial(check_affordable, params=asked) if method.fitted else None
    num_submaps = len(outline.clouds)
    num_pairs = sum(num_wanted(candidates, k) for k in range(2 if pair else num_submaps))
    with store_for_run(store, num_submaps) as room, _workers(scheduler, num_pairs) as executor:
        kept = _shared(room, executor, outline)
        dataset, sources = load_sources(outline, check, most_bytes=_held_here(kept, executor))
        if method.fitted and not is_resolved(asked):
            some = [sources[k].load() for k in representative(len(sources))]
            asked = resolved(asked, some, dataset.name, Memo(store=store))
        params = method.ready(asked)
        if pair is not None:  # the database comes first: the later submap is the query
            by_id = {source.id: source for source in sources}
            submaps = tuple(dataset.submap(name) for name in reversed(pair))
            dataset = replace(dataset, submaps=submaps)
            sources = tuple(by_id[submap.id] for submap in submaps)
        accepted, verdicts = list[LoopClosure](), list[ImageVerdict]()
        with ClosureWriter(out) as writer:

            def take(closure: LoopClosure) -> None:
                writer.add(closure)
                tell_closure(closure, method.name)
                if closure.accepted:
                    accepted.append(closure)
                if closure.images is not None:
                    verdicts.append(closure.images)

            detector = with_store(method.detector(params, Memo(store=kept)), kept)
            pairs = Pairs(dataset.submaps, params, detector, candidates=candidates)
            with progress_bar("pairs") as progress:
                pairs.compare(None, executor, progress, sources=sources, on_verdict=take)
            skipped, result = math.comb(len(sources), 2) - len(pairs), pairs.result()
            report = report_closures(dataset, result, params, method=method.name, sources=sources)
            writer.write(replace(report, num_pairs_skipped=skipped))
    tell_damaged(store)
    said, seconds = count_images(verdicts), report.seconds
    return Compared(dataset, tuple(accepted), writer.num_pairs, skipped, said, seconds)


def tell_closure(closure: LoopClosure, method: str) -> None:
    """Tell a loop closure as an event, if these are asked for; a refused pair is none."""
    if EVENTS.wanted and closure.accepted:
        row: dict[str, Any] = row_of(rounded(closure)) | {"method": method}
        EVENTS.tell(Closure(**{name: row[name] for name in Closure.__struct_fields__}))


def _workers(scheduler: str | None, num_pairs: int) -> AbstractContextManager[Executor]:
    return workers(num_workers(), num_pairs) if scheduler is None else connected(scheduler)


def _shared(store: Store | None, executor: Executor, outline: Outline) -> Store | None:
    """Give the store if the workers can use it and read the clouds; None if not.

    Without it, everything is sent to them and back, and must fit into memory here.
    """
    if not isinstance(executor, Cluster) or store is None:
        return store
    with contextlib.suppress(OSError):  # then nobody sees it
        store.folder.mkdir(parents=True, exist_ok=True)
    sees = executor.sees(store.folder) and executor.sees(outline.clouds[0])
    return store if sees else None


def _held_here(store: Store | None, executor: Executor) -> int:
    """Give the bytes of points to keep here: all for a cluster, or none if it sees them."""
    if not isinstance(executor, Cluster):
        return MOST_LOADED
    return sys.maxsize if store is None else 0
