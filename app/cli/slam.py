"""``gpgrad slam``: correct a traverse by its loop closures."""

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from typing_extensions import Doc

from app.cli.detect import SchedulerFlag, compare, tell_closure
from app.cli.flags import Given, PageFlag
from app.cli.inputs import (
    CandidatesFlag,
    Comparing,
    CrsFlag,
    OriginFlag,
    georeference_of,
    resolved,
    tell_damaged,
)
from app.cli.terminal import conclude, progress_bar, say, warn, working
from app.recordings import built_first
from gpgrad_core import slam
from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.detection.shortlist import Candidates, read_candidates
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import check_directory
from gpgrad_core.io.folder import outline_dataset
from gpgrad_core.io.georeference import Georeference
from gpgrad_core.io.records.closures import (
    read_closures,
    report_closures,
    restore_closures,
    write_closures,
)
from gpgrad_core.io.records.files import check_apart, check_output, replacing
from gpgrad_core.mapping.fitting import representative
from gpgrad_core.methods import find_method
from gpgrad_core.pages import PAGE, subject_of_map, write_page
from gpgrad_core.run import part, silent
from gpgrad_core.run.folders import whole_folder
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import num_workers
from gpgrad_core.slam.run_file import ENDING
from gpgrad_core.types import LoopClosure


@dataclass(frozen=True)
class Slam(Comparing):
    """Arguments of ``gpgrad slam``."""

    typed: ClassVar[str] = ""  # the command line, which the page shows
    datasets: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        Doc("Dataset folders with odometry. Loop closures between them join them into one map."),
        tyro.conf.arg(metavar="DATASET [DATASET ...]", help_behavior_hint="(required)"),
    ]
    out: Annotated[
        Path,
        Doc(
            "Folder to write the poses, the graph, figures, the cloud and the map to. Other files "
            "in it stay."
        ),
        tyro.conf.arg(metavar="FOLDER"),
    ]
    closures: Annotated[
        Path | None,
        Doc(
            "File of loop closures, as gpgrad detect or the viewer writes it. What a person "
            "decided there about a pair outweighs its score."
        ),
        tyro.conf.arg(metavar="FILE.json", help_behavior_hint="(default: detect them)"),
    ] = None
    search_radius: Annotated[
        float | None,
        Doc(
            "Compare only submaps of a traverse that lie within this distance [m] of each other, "
            "by the estimate so far."
        ),
        tyro.conf.arg(help_behavior_hint="(default: compare all)"),
    ] = None
    candidates: CandidatesFlag = "automatic"
    record: Annotated[
        Path | None,
        Doc(
            "Also write the drive to this file, for the time line of gpgrad view: what each submap "
            "decided, with its points. Pairs are compared submap after submap then."
        ),
        tyro.conf.arg(metavar="FILE.gpgrad", help_behavior_hint="(default: none)"),
    ] = None
    merge: Annotated[bool, Doc("Also write the merged cloud and map.")] = True
    page: PageFlag = True
    origin: OriginFlag = None
    crs: CrsFlag = None
    anchor: Annotated[
        Path | None,
        Doc(
            "GeoTIFF of an elevation model of the ground, in metres. The map is anchored on it and "
            "lies in its coordinates."
        ),
        tyro.conf.arg(metavar="FILE.tif", help_behavior_hint="(default: none)"),
    ] = None
    anchor_std: Annotated[
        float | None,
        Doc("Standard deviation of the model's heights [m], of what neighbouring cells share too."),
        tyro.conf.arg(metavar="METRES", help_behavior_hint="(default: estimated)"),
    ] = None
    anchor_start: Annotated[
        str | None,
        Doc(
            "Where the first submap is on the model: easting and northing [m] of its origin, and "
            "its heading [rad] from the east to the north."
        ),
        tyro.conf.arg(
            metavar="E,N,YAW",
            help_behavior_hint="(default: by the dataset's origin; else searched on the model)",
        ),
    ] = None
    anchoring: Annotated[
        Given[slam.AnchorParams], Doc("How well it is known where the drive starts on the model.")
    ] = Given(slam.AnchorParams)
    graph: Annotated[
        Given[slam.GraphParams],
        Doc("Uncertainty of the pose graph's edges: odometry and closures."),
    ] = Given(slam.GraphParams)
    solver: Annotated[Given[slam.SolverParams], Doc("When a loop closure is refused as wrong.")] = (
        Given(slam.SolverParams)
    )
    merged: Annotated[Given[slam.MergeParams], Doc("The merged cloud and map.")] = Given(
        slam.MergeParams
    )
    scheduler: SchedulerFlag = None

    def run(self) -> None:
        check_directory(self.out)
        candidates = read_candidates(self.candidates)
        self._check_flags()
        store = self.store()
        with ExitStack() as hints:
            for path in self.datasets:
                hints.enter_context(built_first(path))
            joined = slam.join_datasets([outline_dataset(path) for path in self.datasets])
            self._check_out(joined)
            dataset = joined.outline.dataset
            slam.odometry_poses(dataset)  # refuses what lacks it before the work
        report = read_closures(self.closures) if self.closures else None
        given = None if report is None else restore_closures(report)
        slam.check_solver()
        anchor = self._anchor(joined)
        georeference = (
            georeference_of(self.origin, self.crs, dataset.origin)
            if anchor is None
            else slam.georeference_on(anchor, self.anchor, self.origin, self.crs)
        )
        params = self.asked(dataset)
        graph, solver = self.graph.over(slam.GraphParams()), self.solver.over(slam.SolverParams())
        some = [*joined.outline.terrains(representative(len(dataset.submaps)))]
        params = resolved(params, some, dataset.name, Memo(store=store))
        with whole_folder(self.out, earlier=self._names(joined)) as folder:
            self._check_out(joined)  # another process may just have ended
            closures: Sequence[LoopClosure]
            if given is not None:
                sound = [submap.id for _, submap in joined.sound(warn)]
                closures, joined = given, joined.keeping(sound)
            else:
                closures, joined = self._detect(
                    joined, params, graph, solver, folder, candidates, store
                )
            tell_damaged(store)
            trusted = () if report is None else report.confirmed
            jobs = len(joined.outline.clouds) ** 2
            searching = nullcontext((silent, None)) if anchor is None else working("anchor", jobs)
            with searching as (progress, executor):
                solution = slam.solve_datasets(
                    joined,
                    closures,
                    graph,
                    solver,
                    trusted=trusted,
                    anchor=anchor,
                    params=params,
                    executor=executor,
                    progress=progress,
                )
            with progress_bar("judge") as progress:
                errors = slam.measure_errors(solution, progress)
            if self.page:
                found = read_closures(folder / "closures.json") if report is None else report
                with progress_bar("page") as progress:
                    subject = subject_of_map(
                        solution, errors, found, params, [self.typed], part(progress, 0.0, 0.3)
                    )
                    memo, rest = Memo(store=store), part(progress, 0.3, 1.0)
                    write_page(folder / PAGE, subject, memo, rest)
            coordinates = self._write(folder, solution, errors, georeference, params)
        if coordinates is not None:
            say(str(coordinates))
        if solution.anchored is not None and solution.anchored.outside:
            warn(solution.anchored.outside_note)
        conclude(
            *slam.describe_map(solution, errors),
            str(self.out),
            output=self.out,
            submaps=len(solution.result.poses),
            closures=len(solution.result.loops) - len(solution.result.refused),
            refused=len(solution.result.refused),
            height_drift=solution.result.height_drift,
            height_doubted=solution.result.height_doubted,
            trajectory_error={
                session: {"before": float(before.absolute), "after": float(after.absolute)}
                for session, (before, after) in errors.trajectories.items()
            },
        )

    def _check_flags(self) -> None:
        places = [path.resolve() for path in self.datasets]
        for k, path in enumerate(self.datasets):
            if places[k] in places[:k]:
                raise InputError(f"{path}: is named twice; name each dataset once")
        stepwise = "--record" if self.record is not None else "--search-radius"
        if (self.search_radius is not None or self.record is not None) and (
            self.scheduler is not None
        ):
            raise InputError(
                f"--scheduler does not go with {stepwise}, which compares submap after submap; "
                "leave one of them out"
            )
        if self.record is not None and self.closures is not None:
            raise InputError(
                "--record does not go with --closures: a file of closures does not say what each "
                "submap decided; leave one of them out"
            )
        if self.search_radius is not None and not self.search_radius > 0:
            raise InputError(f"--search-radius must be above 0 m, got {self.search_radius:g}")

    def _write(
        self,
        folder: Path,
        solution: slam.Solution,
        errors: slam.MapErrors,
        georeference: Georeference | None,
        params: PipelineParams,
    ) -> slam.MapCoordinates | None:
        coordinates = None if georeference is None else slam.coordinates_of(solution, georeference)
        with progress_bar("write") as progress:
            slam.write_solution(folder, solution, errors, progress, coordinates=coordinates)
        if self.merge:
            merged, terrain = self.merged.over(slam.MergeParams()), params.map.terrain
            with progress_bar("merge") as progress:
                notes = slam.write_merged(
                    folder, solution, terrain, merged, progress, coordinates=coordinates
                )
            warn(*notes)
        return coordinates

    def _anchor(self, joined: slam.JoinedDatasets) -> slam.AnchorModel | None:
        if self.anchor is None:
            given = {"anchor-std": self.anchor_std, "anchor-start": self.anchor_start}
            given |= {f"anchoring.{name}": value for name, value in self.anchoring.values.items()}
            for name, value in given.items():
                if value is not None:
                    flag = f"--{name.replace('_', '-')} {value}"
                    raise InputError(f"{flag}: needs the elevation model, --anchor FILE.tif")
            return None
        return slam.read_anchor(
            self.anchor,
            joined.outline,
            std=self.anchor_std,
            start=self.anchor_start,
            origin=self.origin,
            crs=self.crs,
            params=self.anchoring.over(slam.AnchorParams()),
        )

    def _names(self, joined: slam.JoinedDatasets) -> tuple[str, ...]:
        """Name the files that this run may write; the last one is written last."""
        return (*(() if self.closures else ("closures.json",)), PAGE, *slam.solution_files(joined))

    def _check_out(self, joined: slam.JoinedDatasets) -> None:
        names = self._names(joined)
        check_directory(self.out, names, overwrite=self.overwrite)
        if self.record is not None:
            check_output(self.record, (ENDING,), overwrite=self.overwrite)
        check_apart(
            [*(self.out / name for name in names), self.record],
            [*self.datasets, self.closures, self.params, self.anchor],
        )

    def _detect(
        self,
        joined: slam.JoinedDatasets,
        params: PipelineParams,
        graph: slam.GraphParams,
        solver: slam.SolverParams,
        folder: Path,
        candidates: Candidates,
        store: Store | None,
    ) -> tuple[Sequence[LoopClosure], slam.JoinedDatasets]:
        """Detect the closures, maybe submap by submap, and drop submaps that cannot be maps."""
        if self.search_radius is None and self.record is None:
            compared = compare(
                joined.outline,
                params,
                folder / "closures.json",
                method=find_method("gradient"),
                store=store,
                candidates=candidates,
                scheduler=self.scheduler,
            )
            kept = [submap.id for submap in compared.dataset.submaps]
            return compared.accepted, joined.keeping(kept)
        name, start = joined.outline.dataset.name, time.perf_counter()
        with ExitStack() as ends:
            progress = ends.enter_context(progress_bar("closures"))
            make = slam.LoopCloser
            if self.record is not None:
                settings = slam.RunSettings(
                    name, params, graph, solver, candidates, self.search_radius
                )
                unfinished = ends.enter_context(replacing(self.record))
                record = ends.enter_context(slam.RunWriter(unfinished, settings, is_locked=True))
                make = partial(slam.Drive, record=record, name=name)
            closer = ends.enter_context(
                make(
                    params,
                    graph,
                    solver,
                    search_radius=self.search_radius,
                    candidates=candidates,
                    executor=ends.enter_context(ThreadPoolExecutor(num_workers())),
                    store=store,
                )
            )
            sizes = closer.add_all(joined, _tell, warn, progress)
            closures = closer.closures
        seconds = {"total": time.perf_counter() - start}
        report = report_closures(joined.outline.dataset, DetectionResult(closures, seconds), params)
        write_closures(folder / "closures.json", replace(report, submaps=sizes))
        return closures, joined.keeping(sizes)


def _tell(step: slam.Step) -> None:
    for closure in step.closures:
        tell_closure(closure, "gradient")
