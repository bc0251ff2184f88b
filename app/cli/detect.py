"""``gpgrad detect``: register, score and judge pairs of submaps."""

from dataclasses import dataclass, replace
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
    load,
    open_store,
    settled,
    tell_damaged,
)
from app.cli.outputs import Overwrite
from app.cli.terminal import count, progress_bar, say
from gpgrad_core.errors import InputError
from gpgrad_core.methods import METHODS, find_method
from gpgrad_core.outputs import check_apart, check_output, report_closures, write_closures
from gpgrad_core.pipeline import detect_loop_closures, keeping
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.threads import num_workers
from gpgrad_core.shortlist import num_wanted, read_candidates
from gpgrad_core.slam import build_pose_graph, odometry_poses, write_graph
from gpgrad_core.types import Dataset


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
        dataset = load(self.dataset)
        asked, whole = self.pipeline.over(base_params(dataset, self.params)), dataset.submaps
        if self.pair:
            dataset = _only(dataset, *self.pair)
        if self.g2o:
            odometry_poses(dataset)  # refuses a dataset without odometry before the work
        if method.fitted:  # to the whole dataset, so that a single pair gets the same verdict
            asked = settled(asked, whole, dataset.name, store)
        params = method.adapt(asked)
        num_pairs = sum(num_wanted(candidates, k) for k in range(len(dataset.submaps)))
        with progress_bar("pairs") as progress, workers(num_workers(), num_pairs) as executor:
            result = detect_loop_closures(
                dataset,
                params,
                detector=keeping(method.detector(params, Memo()), store),
                candidates=candidates,
                executor=executor,
                progress=progress,
            )
        tell_damaged(store)
        report = report_closures(dataset, result, params, method=method.name)
        write_closures(self.out, report)
        if self.g2o:
            write_graph(self.g2o, build_pose_graph(dataset, result.closures))
        closures, pairs = count(len(report.accepted), "loop closure"), len(report.pairs)
        submaps, seconds = count(len(report.submaps), "submap"), report.seconds["total"]
        skipped = report.num_pairs_skipped
        left_out = f" ({skipped:,} were not compared)" if skipped else ""
        say(
            f"{closures} in {count(pairs, 'pair')}{left_out} of {submaps}, {seconds:.1f} s: "
            f"{self.out}"
        )


def _only(dataset: Dataset, query_id: str, database_id: str) -> Dataset:
    """Keep two submaps, the database first: the later one is the query."""
    if query_id == database_id:
        raise InputError(f"--pair: {query_id} beside itself is no pair; name two different submaps")
    return replace(dataset, submaps=(dataset.submap(database_id), dataset.submap(query_id)))
