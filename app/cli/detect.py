"""``gpgrad detect``: register, score and judge pairs of submaps."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from typing_extensions import Doc

from app.cli.comparing import SchedulerFlag, compare
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
    open_store,
)
from app.cli.terminal import count, say
from app.recordings import built_first
from gpgrad_core.detection.shortlist import read_candidates
from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import outline_dataset
from gpgrad_core.io.records.files import check_apart, check_output
from gpgrad_core.methods import METHODS, find_method
from gpgrad_core.slam import build_pose_graph, odometry_poses, write_graph


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
        say(
            f"{count(len(compared.accepted), 'loop closure')} in "
            f"{count(compared.num_pairs, 'pair')}{left_out} of {count(num_submaps, 'submap')}, "
            f"{compared.seconds['total']:.1f} s: {self.out}"
        )
        if compared.images:
            say(compared.images)
