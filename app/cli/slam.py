"""``gpgrad slam``: correct a traverse by its loop closures."""

import contextlib
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from typing_extensions import Doc

from app.cli.detect import SchedulerFlag, compare
from app.cli.flags import Given, Overwrite
from app.cli.inputs import (
    ALL_PARAMS,
    USERS_CACHE,
    AllParams,
    Cache,
    CandidatesFlag,
    CrsFlag,
    OriginFlag,
    ParamsFile,
    asked_params,
    georeference_of,
    open_store,
    settled,
    tell_damaged,
)
from app.cli.terminal import count, progress_bar, say, warn
from app.recordings import built_first
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
from gpgrad_core.run.folders import whole_folder
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import part
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import num_workers
from gpgrad_core.slam import (
    Drive,
    GraphParams,
    JoinedDatasets,
    LoopCloser,
    MapCoordinates,
    MapErrors,
    MergeParams,
    RunSettings,
    RunWriter,
    Solution,
    SolverParams,
    check_solver,
    find_coordinates,
    join_datasets,
    measure_errors,
    odometry_poses,
    solution_files,
    solve_datasets,
    true_poses,
    write_merged,
    write_solution,
    write_track,
)
from gpgrad_core.slam.run_file import ENDING
from gpgrad_core.types import LoopClosure


@dataclass(frozen=True)
class Slam:
    """Arguments of ``gpgrad slam``."""

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
    origin: OriginFlag = None
    crs: CrsFlag = None
    graph: Annotated[
        Given[GraphParams], Doc("Uncertainty of the pose graph's edges: odometry and closures.")
    ] = Given(GraphParams)
    solver: Annotated[Given[SolverParams], Doc("When a loop closure is refused as wrong.")] = Given(
        SolverParams
    )
    merged: Annotated[Given[MergeParams], Doc("The merged cloud and map.")] = Given(MergeParams)
    scheduler: SchedulerFlag = None
    overwrite: Overwrite = False
    cache: Cache = USERS_CACHE
    params: ParamsFile = None
    pipeline: AllParams = ALL_PARAMS

    def run(self) -> None:
        """Detect, solve, judge and write."""
        check_directory(self.out)
        candidates = read_candidates(self.candidates)
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
        store = open_store(self.cache)
        with contextlib.ExitStack() as hints:
            for path in self.datasets:
                hints.enter_context(built_first(path))
            joined = join_datasets([outline_dataset(path) for path in self.datasets])
            self._check_out(joined)
            dataset = joined.outline.dataset
            odometry_poses(dataset)  # refuses what lacks it before the work
        report = read_closures(self.closures) if self.closures else None
        given = None if report is None else restore_closures(report)
        check_solver()
        georeference = georeference_of(self.origin, self.crs, dataset.origin)
        params = asked_params(dataset, self.params, self.pipeline)
        graph, solver = self.graph.over(GraphParams()), self.solver.over(SolverParams())
        some = [joined.outline.load(k)[0] for k in representative(len(dataset.submaps))]
        params = settled(params, some, dataset.name, Memo(store=store))
        with whole_folder(self.out, earlier=self._names(joined)) as folder:
            self._check_out(joined)  # another process may just have ended
            closures: Sequence[LoopClosure]
            if given is not None:
                warn(*dataset.notes)
                closures = given
            elif self.search_radius is None and self.record is None:
                closures = compare(
                    joined.outline,
                    params,
                    folder / "closures.json",
                    method=find_method("gradient"),
                    store=store,
                    candidates=candidates,
                    scheduler=self.scheduler,
                ).accepted
            else:
                closures = self._detect(joined, params, graph, solver, folder, candidates, store)
            tell_damaged(store)
            trusted = () if report is None else report.confirmed
            solution = solve_datasets(joined, closures, graph, solver, trusted=trusted)
            with progress_bar("judge") as progress:
                errors = measure_errors(solution, progress)
            coordinates = self._write(folder, solution, errors, georeference, params)
        if coordinates is not None:
            say(_placed(coordinates))
        say(*_corrected(solution, errors), str(self.out))

    def _write(
        self,
        folder: Path,
        solution: Solution,
        errors: MapErrors,
        georeference: Georeference | None,
        params: PipelineParams,
    ) -> MapCoordinates | None:
        """Write the results; gives where the map lies, if that was asked for."""
        joined, coordinates = solution.joined, None
        if georeference is not None:
            # The origin is the first dataset's; the truth of others may have another frame.
            first = set(next(iter(joined.traverses.values())))
            truth = true_poses(joined.outline.dataset)
            true = {name: pose for name, pose in truth.items() if name in first}
            coordinates = find_coordinates(solution.result.poses, true, georeference)
            write_track(folder, joined.traverses, solution.result.poses, coordinates)
        with progress_bar("write") as progress:
            write_solution(folder, solution, errors, progress, coordinates=coordinates)
        if self.merge:
            merged, terrain = self.merged.over(MergeParams()), params.map.terrain
            with progress_bar("merge") as progress:
                notes = write_merged(
                    folder, solution, terrain, merged, progress, coordinates=coordinates
                )
            warn(*notes)
        return coordinates

    def _names(self, joined: JoinedDatasets) -> tuple[str, ...]:
        """Name the files that this run may write; the last one is written last."""
        return (*(() if self.closures else ("closures.json",)), *solution_files(joined))

    def _check_out(self, joined: JoinedDatasets) -> None:
        names = self._names(joined)
        check_directory(self.out, names, overwrite=self.overwrite)
        if self.record is not None:
            check_output(self.record, (ENDING,), overwrite=self.overwrite)
        check_apart(
            [*(self.out / name for name in names), self.record],
            [*self.datasets, self.closures, self.params],
        )

    def _detect(
        self,
        joined: JoinedDatasets,
        params: PipelineParams,
        graph: GraphParams,
        solver: SolverParams,
        folder: Path,
        candidates: Candidates,
        store: Store | None,
    ) -> tuple[LoopClosure, ...]:
        """Find the closures submap by submap, among those that are near by the estimate so far."""
        warn(*joined.outline.dataset.notes)
        total, sizes, start = len(joined.outline.clouds), dict[str, int](), time.perf_counter()
        name = joined.outline.dataset.name
        with contextlib.ExitStack() as ends:
            progress = ends.enter_context(progress_bar("closures"))
            make = LoopCloser
            if self.record is not None:
                settings = RunSettings(name, params, graph, solver, candidates, self.search_radius)
                unfinished = ends.enter_context(replacing(self.record))
                record = ends.enter_context(RunWriter(unfinished, settings))
                make = partial(Drive, record=record, name=name)
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
            for k in range(total):
                submap, notes = joined.outline.load(k)
                warn(*notes)
                sizes[submap.id] = len(submap.points)
                closer.add(
                    submap,
                    part(progress, (k / total) ** 2, ((k + 1) / total) ** 2),
                    starts_traverse=submap.id in joined.starts,
                )
            closures = closer.closures
        seconds = {"total": time.perf_counter() - start}
        report = report_closures(joined.outline.dataset, DetectionResult(closures, seconds), params)
        write_closures(folder / "closures.json", replace(report, submaps=sizes))
        return closures


def _placed(coordinates: MapCoordinates) -> str:
    """Say in which coordinates the map is, and what places it."""
    by = "the true positions" if coordinates.by_truth else "odometry's frame, x east and y north"
    system = coordinates.georeference
    longitude, latitude, height = system.origin
    return (
        f"in {system.name}, origin {latitude:.7f}, {longitude:.7f}, {height:.2f} m, placed by {by}"
    )


def _corrected(solution: Solution, errors: MapErrors) -> list[str]:
    """Say how good a corrected map is: a line for each traverse, and one for the overlaps."""
    loops, refused = len(solution.result.loops), len(solution.result.refused)
    lines = [
        f"{count(len(solution.result.poses), 'submap')}, "
        f"{count(loops - refused, 'loop closure')} used, {refused} refused as wrong"
    ]
    for session, (before, after) in errors.trajectories.items():
        only = " (of positions only)" if before.relative_turn is None else ""
        lines.append(
            f"{session}: trajectory error{only} {before.absolute:.3f} m -> {after.absolute:.3f} m, "
            f"from submap to submap {before.relative:.3f} m -> {after.relative:.3f} m"
        )
    first, last = errors.overlaps
    if first.median is not None and last.median is not None:
        lines.append(
            f"median height difference where submaps overlap: {100 * first.median:.1f} cm "
            f"({first.count} pairs) -> {100 * last.median:.1f} cm ({last.count} pairs)"
        )
    return lines
