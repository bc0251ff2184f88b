"""``gpgrad detect``: register, score and judge pairs of submaps."""

import math
from collections.abc import Generator, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from typing_extensions import Doc

from app.cli.inputs import (
    ALL_PARAMS,
    USERS_CACHE,
    AllParams,
    Cache,
    CandidatesFlag,
    DatasetPath,
    ParamsFile,
    base_params,
    load_sources,
    open_store,
    settled,
    tell_damaged,
)
from app.cli.outputs import Overwrite
from app.cli.terminal import count, progress_bar, say
from gpgrad_core.datasets import Outline, outline_dataset
from gpgrad_core.errors import InputError
from gpgrad_core.fitting import representative
from gpgrad_core.methods import METHODS, find_method
from gpgrad_core.outputs import ClosureWriter, check_apart, check_output, report_closures
from gpgrad_core.pipeline import check_affordable, detect_loop_closures, keeping
from gpgrad_core.run.cluster import Cluster, connected
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import num_workers
from gpgrad_core.run.whole import TemporaryFolder
from gpgrad_core.shortlist import ALL_UP_TO, num_wanted, read_candidates
from gpgrad_core.slam import build_pose_graph, odometry_poses, write_graph
from gpgrad_core.types import Dataset, LoopClosure, SubmapSource

VIEW_BYTES = 2_000_000
"""Room for what is kept of a submap and its pairs; 30,000 points take half of it."""


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
    scheduler: Annotated[
        str | None,
        Doc(
            "Address of a Dask scheduler, such as tcp://10.0.0.7:8786, to whose workers the work "
            "is given."
        ),
        tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: this machine's cores)"),
    ] = None
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
        store = open_store(self.cache)
        outline = outline_dataset(self.dataset)
        asked = self.pipeline.over(base_params(outline.dataset, self.params))
        if self.g2o:
            odometry_poses(outline.dataset)  # refuses a dataset without odometry before the work
        check = partial(check_affordable, params=asked) if method.fitted else None
        num_submaps, accepted = len(outline.clouds), list[LoopClosure]()
        num_pairs = sum(num_wanted(candidates, k) for k in range(2 if self.pair else num_submaps))
        with (
            _at_least_for_now(store, num_submaps) as room,
            _workers(self.scheduler, num_pairs) as executor,
            ClosureWriter(self.out) as writer,
        ):
            shared = not isinstance(executor, Cluster) or _all_see(executor, outline, room)
            kept = room if shared else None
            dataset, sources = load_sources(outline, check, keep_all=not shared)
            if method.fitted:  # to the whole dataset, so that a single pair gets the same verdict
                some = [sources[k].load() for k in representative(num_submaps)]
                asked = settled(asked, some, dataset.name, store)
            if self.pair:
                dataset, sources = _only(dataset, sources, *self.pair)
            params = method.adapt(asked)

            def take(closure: LoopClosure) -> None:
                writer.add(closure)
                if closure.accepted:
                    accepted.append(closure)

            with progress_bar("pairs") as progress:
                result = detect_loop_closures(
                    dataset,
                    params,
                    detector=keeping(method.detector(params, Memo()), kept),
                    candidates=candidates,
                    executor=executor,
                    progress=progress,
                    sources=sources,
                    take=take,
                )
            skipped = math.comb(len(sources), 2) - writer.num_pairs
            report = report_closures(dataset, result, params, method=method.name, sources=sources)
            writer.write(replace(report, num_pairs_skipped=skipped))
        tell_damaged(store)
        if self.g2o:
            write_graph(self.g2o, build_pose_graph(dataset, accepted))
        left_out = f" ({skipped:,} were not compared)" if skipped else ""
        say(
            f"{count(len(accepted), 'loop closure')} in {count(writer.num_pairs, 'pair')}"
            f"{left_out} of {count(len(sources), 'submap')}, {report.seconds['total']:.1f} s: "
            f"{self.out}"
        )


def _workers(scheduler: str | None, num_pairs: int) -> AbstractContextManager[Executor]:
    """Give the workers of a cluster, or this machine's."""
    return workers(num_workers(), num_pairs) if scheduler is None else connected(scheduler)


def _all_see(cluster: Cluster, outline: Outline, store: Store | None) -> bool:
    """Tell whether the workers can read the clouds, and keep results where this process does.

    Otherwise everything is sent to them and back.
    """
    if store is not None:
        store.folder.mkdir(parents=True, exist_ok=True)
    return store is not None and cluster.sees(store.folder) and cluster.sees(outline.clouds[0])


@contextmanager
def _at_least_for_now(store: Store | None, num_submaps: int) -> Generator[Store | None]:
    """Give a store with room for a run; a temporary one if the results of many are not kept."""
    if store is not None:
        yield store.with_room(num_submaps * VIEW_BYTES)
    elif num_submaps <= ALL_UP_TO:
        yield None  # they fit into memory
    else:
        with TemporaryFolder("gpgrad-results-") as folder:
            yield Store(Path(folder)).with_room(num_submaps * VIEW_BYTES)


def _only(
    dataset: Dataset, sources: Sequence[SubmapSource], query_id: str, database_id: str
) -> tuple[Dataset, tuple[SubmapSource, ...]]:
    """Keep two submaps, the database first: the later one is the query."""
    if query_id == database_id:
        raise InputError(f"--pair: {query_id} beside itself is no pair; name two different submaps")
    wanted = dataset.submap(database_id), dataset.submap(query_id)
    by_id = {source.id: source for source in sources}
    return replace(dataset, submaps=wanted), tuple(by_id[one.id] for one in wanted)
