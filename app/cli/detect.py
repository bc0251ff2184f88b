"""``gpgrad detect``: register, score and judge pairs of submaps, on this machine or a cluster."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import tyro
from typing_extensions import Doc

from app.cli.inputs import CandidatesFlag, Comparing, DatasetPath, tell_damaged
from app.cli.terminal import EVENTS, Closure, conclude, progress_bar, say, warn
from app.recordings import built_first
from gpgrad_core.comparing import Compared, compare_dataset
from gpgrad_core.detection import PipelineParams
from gpgrad_core.detection.shortlist import read_candidates
from gpgrad_core.errors import InputError, count
from gpgrad_core.io.folder import Outline, outline_dataset
from gpgrad_core.io.records.closures import rounded, row_of
from gpgrad_core.io.records.files import check_apart, check_output
from gpgrad_core.methods import METHODS, Method, find_method
from gpgrad_core.slam import build_pose_graph, odometry_poses, write_graph
from gpgrad_core.types import LoopClosure

SchedulerFlag: TypeAlias = Annotated[
    str | None,
    Doc(
        "Address of a Dask scheduler, such as tcp://10.0.0.7:8786, to whose workers the work is "
        "given."
    ),
    tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: this machine's cores)"),
]


@dataclass(frozen=True)
class Detect(Comparing):
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

    def run(self) -> None:
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
        store = self.store()
        with built_first(self.dataset):
            outline = outline_dataset(self.dataset)
        asked = self.asked(outline.dataset)
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
        tell_damaged(store)
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


def compare(
    outline: Outline, requested: PipelineParams, out: Path, *, method: Method, **others: Any
) -> Compared:
    """Compare the pairs of a dataset as `compare_dataset` does, and tell what happens."""

    def on_closure(closure: LoopClosure) -> None:
        tell_closure(closure, method.name)

    hooks: dict[str, Any] = {"stage": progress_bar, "on_note": warn, "on_fit": say}
    return compare_dataset(
        outline, requested, out, method=method, on_closure=on_closure, **hooks, **others
    )


def tell_closure(closure: LoopClosure, method: str) -> None:
    """Send a loop closure as an event, on request; a refused pair is none."""
    if EVENTS.wanted and closure.accepted:
        row: dict[str, Any] = row_of(rounded(closure)) | {"method": method}
        EVENTS.tell(Closure(**{name: row[name] for name in Closure.__struct_fields__}))
