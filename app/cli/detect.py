"""``gpgrad detect``: register, score and judge pairs of submaps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from typing_extensions import Doc

from app.cli.comparing import (
    SchedulerFlag,
    compare,
    kept_in_memory,
    shared,
    workers_for,
)
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
from app.cli.terminal import count, say
from app.recordings import built_first
from gpgrad_core.datasets import outline_dataset
from gpgrad_core.errors import InputError
from gpgrad_core.fitting import representative
from gpgrad_core.methods import METHODS, find_method
from gpgrad_core.outputs import check_apart, check_output
from gpgrad_core.pipeline import check_affordable, store_for_run
from gpgrad_core.run.memo import Memo
from gpgrad_core.shortlist import num_wanted, read_candidates
from gpgrad_core.slam import build_pose_graph, odometry_poses, write_graph
from gpgrad_core.types import Dataset, SubmapSource


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
        store = open_store(self.cache)
        with built_first(self.dataset):
            outline = outline_dataset(self.dataset)
        asked = self.pipeline.over(base_params(outline.dataset, self.params))
        if self.g2o:
            odometry_poses(outline.dataset)  # refuses a dataset without odometry before the work
        check = partial(check_affordable, params=asked) if method.fitted else None
        num_submaps = len(outline.clouds)
        num_pairs = sum(num_wanted(candidates, k) for k in range(2 if self.pair else num_submaps))
        with (
            store_for_run(store, num_submaps) as room,
            workers_for(self.scheduler, num_pairs) as executor,
        ):
            kept = shared(room, executor, outline)
            with built_first(self.dataset):
                dataset, sources = load_sources(
                    outline, check, most_bytes=kept_in_memory(kept, executor)
                )
            if method.fitted:  # to the whole dataset, so that a single pair gets the same verdict
                some = [sources[k].load() for k in representative(num_submaps)]
                asked = settled(asked, some, dataset.name, Memo(store=store))
            if self.pair:
                dataset, sources = _only(dataset, sources, *self.pair)
            compared = compare(
                dataset,
                sources,
                method.ready(asked),
                self.out,
                method=method,
                store=kept,
                candidates=candidates,
                executor=executor,
            )
        tell_damaged(store)
        if self.g2o:
            write_graph(self.g2o, build_pose_graph(dataset, compared.accepted))
        skipped, num_pairs = compared.num_pairs_skipped, compared.num_pairs
        left_out = f" ({skipped:,} were not compared)" if skipped else ""
        say(
            f"{count(len(compared.accepted), 'loop closure')} in {count(num_pairs, 'pair')}"
            f"{left_out} of {count(len(sources), 'submap')}, {compared.seconds['total']:.1f} s: "
            f"{self.out}"
        )
        if compared.images:
            say(compared.images)


def _only(
    dataset: Dataset, sources: Sequence[SubmapSource], query_id: str, database_id: str
) -> tuple[Dataset, tuple[SubmapSource, ...]]:
    """Keep two submaps, the database first: the later one is the query."""
    if query_id == database_id:
        raise InputError(f"--pair: {query_id} beside itself is no pair; name two different submaps")
    wanted = dataset.submap(database_id), dataset.submap(query_id)
    by_id = {source.id: source for source in sources}
    return replace(dataset, submaps=wanted), tuple(by_id[one.id] for one in wanted)
