"""``gpgrad slam``: correct a traverse by its loop closures."""

import contextlib
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
import tyro
from typing_extensions import Doc

from app.cli.detect import SchedulerFlag, compare, tell_closure
from app.cli.flags import Given, Overwrite, PageFlag
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
from app.cli.terminal import conclude, count, progress_bar, say, warn
from app.recordings import built_first
from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.detection.shortlist import Candidates, read_candidates
from gpgrad_core.errors import InputError, NoTerrainError
from gpgrad_core.evaluation import check_directory
from gpgrad_core.io.folder import outline_dataset
from gpgrad_core.io.georeference import (
    FARTHEST,
    Georeference,
    grid_georeference,
    make_georeference,
    read_origin,
)
from gpgrad_core.io.rasters import Elevations, read_elevation_model
from gpgrad_core.io.records.closures import (
    ClosureReport,
    read_closures,
    report_closures,
    restore_closures,
    write_closures,
)
from gpgrad_core.io.records.files import check_apart, check_output, replacing
from gpgrad_core.io.records.georeferenced import check_libraries
from gpgrad_core.mapping.fitting import representative
from gpgrad_core.methods import find_method
from gpgrad_core.pages import PAGE, OutlinedSubmap, Subject, dataset_figures, judge, write_page
from gpgrad_core.run.folders import whole_folder
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.progress import part
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import num_workers
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import (
    AnchorModel,
    AnchorParams,
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
from gpgrad_core.slam.anchoring import Anchored
from gpgrad_core.slam.run_file import ENDING
from gpgrad_core.types import LoopClosure, Submap

MOST_ANCHOR_STD = 10_000.0
"""Of an elevation model's heights [m]."""
FAR = 100_000.0
"""A model whose corner is so far from the origin of its coordinates [m] gets one of its own."""


@dataclass(frozen=True)
class Slam:
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
        Given[AnchorParams], Doc("How well it is known where the drive starts on the model.")
    ] = Given(AnchorParams)
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
        anchor = self._anchor(joined)
        georeference = (
            georeference_of(self.origin, self.crs, dataset.origin)
            if anchor is None
            else self._grid(anchor)
        )
        params = asked_params(dataset, self.params, self.pipeline)
        graph, solver = self.graph.over(GraphParams()), self.solver.over(SolverParams())
        some = [*joined.outline.terrains(representative(len(dataset.submaps)))]
        params = settled(params, some, dataset.name, Memo(store=store))
        with whole_folder(self.out, earlier=self._names(joined)) as folder:
            self._check_out(joined)  # another process may just have ended
            closures: Sequence[LoopClosure]
            if given is not None:
                sound = [submap.id for _, submap in _sound(joined)]
                closures, joined = given, joined.keeping(sound)
            else:
                closures, joined = self._detect(
                    joined, params, graph, solver, folder, candidates, store
                )
            tell_damaged(store)
            trusted = () if report is None else report.confirmed
            solution = self._solve(joined, closures, graph, solver, trusted, anchor, params)
            with progress_bar("judge") as progress:
                errors = measure_errors(solution, progress)
            if self.page:
                found = read_closures(folder / "closures.json") if report is None else report
                self._write_page(folder, solution, errors, found, params, store)
            coordinates = self._write(folder, solution, errors, georeference, params)
        if coordinates is not None:
            say(_placed(coordinates))
        if solution.anchored is not None and solution.anchored.outside:
            warn(_outside(solution.anchored))
        conclude(
            *_corrected(solution, errors),
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

    def _solve(
        self,
        joined: JoinedDatasets,
        closures: Sequence[LoopClosure],
        graph: GraphParams,
        solver: SolverParams,
        trusted: Sequence[tuple[str, str]],
        anchor: AnchorModel | None,
        params: PipelineParams,
    ) -> Solution:
        if anchor is None:
            return solve_datasets(joined, closures, graph, solver, trusted=trusted)
        jobs = len(joined.outline.clouds) ** 2
        with progress_bar("anchor") as progress, workers(num_workers(), jobs) as executor:
            return solve_datasets(
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

    def _write_page(
        self,
        folder: Path,
        solution: Solution,
        errors: MapErrors,
        report: ClosureReport,
        params: PipelineParams,
        store: Store | None,
    ) -> None:
        joined, result = solution.joined, solution.result
        dataset = joined.outline.dataset
        sources = [OutlinedSubmap(joined.outline, k) for k in range(len(dataset.submaps))]
        with progress_bar("page") as progress:
            evaluation = None
            if len(joined.traverses) == 1:  # the truth of another may have another frame
                evaluation = judge(dataset, sources, report, part(progress, 0.0, 0.3))
            figures = dataset_figures(report, len(sources), evaluation)
            for session, (before, after) in errors.trajectories.items():
                of = f" of {session}" if len(joined.traverses) > 1 else ""
                change = f"{before.absolute:.3f} m to {after.absolute:.3f} m"
                figures.append((f"trajectory error{of}", change))
            subject = Subject(
                dataset.name,
                sources,
                report,
                params,
                before=solution.before,
                after=result.poses,
                truth=true_poses(dataset),
                starts=joined.starts,
                dropped=[(fit.edge.end, fit.edge.start) for fit in result.refused],
                evaluation=evaluation,
                figures=figures,
                commands=[self.typed],
                notes=dataset.notes,
            )
            write_page(folder / PAGE, subject, Memo(store=store), part(progress, 0.3, 1.0))

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
            coordinates = (
                find_coordinates(
                    solution.shown(solution.result.poses), solution.shown(true), georeference
                )
                if solution.anchored is None
                else MapCoordinates(
                    georeference, Pose.from_planar(SE2()), by_truth=False, by_anchor=True
                )
            )
            write_track(
                folder, joined.traverses, solution.shown(solution.result.poses), coordinates
            )
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

    def _anchor(self, joined: JoinedDatasets) -> AnchorModel | None:
        """Read the elevation model, and find out where the drive starts on it.

        Raises:
            InputError: If a flag needs the model, or the model cannot be used.
        """
        if self.anchor is None:
            given: dict[str, object] = {
                "--anchor-std": self.anchor_std,
                "--anchor-start": self.anchor_start,
                **{
                    f"--anchoring.{name.replace('_', '-')}": value
                    for name, value in self.anchoring.values.items()
                },
            }
            for flag, value in given.items():
                if value is not None:
                    raise InputError(
                        f"{flag} {value}: needs the elevation model, --anchor FILE.tif"
                    )
            return None
        if self.anchor_std is not None and not 0 < self.anchor_std <= MOST_ANCHOR_STD:
            raise InputError(
                f"--anchor-std must be above 0 and at most {MOST_ANCHOR_STD:g} m, got "
                f"{self.anchor_std:g}"
            )
        start = None if self.anchor_start is None else _read_start(self.anchor_start)
        elevations = read_elevation_model(self.anchor)
        # Near its corner, because clouds are written with few digits.
        far = max(map(abs, elevations.corner)) >= FAR
        east, north = map(float, np.floor(elevations.corner)) if far else (0.0, 0.0)
        if start is None:
            start = self._start_by_origin(joined, elevations)
        if start is not None:
            start = SE2(start.x - east, start.y - north, start.yaw)
        corner = elevations.corner[0] - east, elevations.corner[1] - north
        return AnchorModel(
            self.anchor.name,
            replace(elevations, corner=corner),
            (east, north),
            self.anchor_std,
            start,
            self.anchoring.over(AnchorParams()),
        )

    def _start_by_origin(self, joined: JoinedDatasets, elevations: Elevations) -> SE2 | None:
        """Give where the first submap is on the model by the dataset's origin, if that is known."""
        dataset = joined.outline.dataset
        origin = dataset.origin if self.origin is None else read_origin(self.origin)
        if origin is None:
            return None
        system = elevations.system or self.crs
        if system is None:
            raise InputError(
                f"{self.anchor}: names no coordinate system, so the drive's origin does not say "
                "where it is on the model; name the model's: --crs EPSG:32633, or say where the "
                "drive starts: --anchor-start E,N,YAW"
            )
        georeference = make_georeference(origin, system)
        first = dataset.submaps[0].pose_odometry
        assert first is not None  # as has been checked
        # By its centre: its frame's origin may lie where the coordinate system does not reach.
        centre = joined.outline.load(0)[0].centre
        here = centre + np.array([np.zeros(3), [100.0, 0.0, 0.0]])
        (x, y, _), (x_ahead, y_ahead, _) = georeference.apply(first.apply(here))
        yaw = float(np.arctan2(y_ahead - y, x_ahead - x))
        return SE2(float(x), float(y), yaw) @ SE2(-float(centre[0]), -float(centre[1]))

    def _grid(self, anchor: AnchorModel) -> Georeference | None:
        """Place the map in the model's coordinates, if coordinates are asked for.

        Raises:
            InputError: If the model is in another system than is asked for.
        """
        if self.crs is None and self.origin is None:
            return None
        check_libraries()
        system = anchor.elevations.system or self.crs
        if system is None:
            raise InputError(
                f"{self.anchor}: names no coordinate system; name it: --crs EPSG:32633"
            )
        found = grid_georeference(system, anchor.origin)
        if self.crs is not None and grid_georeference(self.crs, anchor.origin).name != found.name:
            raise InputError(
                f"{self.anchor}: is in {found.name}, not in {self.crs}; leave --crs out, or "
                f"project the model: gdalwarp -t_srs {self.crs} …"
            )
        return found

    def _names(self, joined: JoinedDatasets) -> tuple[str, ...]:
        """Name the files that this run may write; the last one is written last."""
        return (*(() if self.closures else ("closures.json",)), PAGE, *solution_files(joined))

    def _check_out(self, joined: JoinedDatasets) -> None:
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
        joined: JoinedDatasets,
        params: PipelineParams,
        graph: GraphParams,
        solver: SolverParams,
        folder: Path,
        candidates: Candidates,
        store: Store | None,
    ) -> tuple[Sequence[LoopClosure], JoinedDatasets]:
        """Find the closures; it also gives the datasets without submaps that cannot be maps.

        Where a radius or a record is asked for, they are found submap by submap, among those that
        are near by the estimate so far.
        """
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
        total, sizes, start = len(joined.outline.clouds), dict[str, int](), time.perf_counter()
        name = joined.outline.dataset.name
        with contextlib.ExitStack() as ends:
            progress = ends.enter_context(progress_bar("closures"))
            make = LoopCloser
            if self.record is not None:
                settings = RunSettings(name, params, graph, solver, candidates, self.search_radius)
                unfinished = ends.enter_context(replacing(self.record))
                record = ends.enter_context(RunWriter(unfinished, settings, is_locked=True))
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
            following = 0
            for k, submap in _sound(joined):
                passed = joined.outline.dataset.submaps[following : k + 1]
                following = k + 1
                sizes[submap.id] = len(submap.points)
                step = closer.add(
                    submap,
                    part(progress, (k / total) ** 2, ((k + 1) / total) ** 2),
                    starts_traverse=any(one.id in joined.starts for one in passed),
                )
                for closure in step.closures:
                    tell_closure(closure, "gradient")
            closures = closer.closures
        seconds = {"total": time.perf_counter() - start}
        report = report_closures(joined.outline.dataset, DetectionResult(closures, seconds), params)
        write_closures(folder / "closures.json", replace(report, submaps=sizes))
        return closures, joined.keeping(sizes)


def _sound(joined: JoinedDatasets) -> Iterator[tuple[int, Submap]]:
    """Load the submaps one by one, with a word on those of which no map can be made."""
    warn(*joined.outline.dataset.notes)
    for k in range(len(joined.outline.clouds)):
        try:
            submap, notes = joined.outline.load(k)
        except NoTerrainError as error:
            warn(f"{error}: it was left out")
        else:
            warn(*notes)
            yield k, submap


def _read_start(text: str) -> SE2:
    """Read where the first submap is: easting, northing [m] and yaw [rad]."""
    try:
        x, y, yaw = map(float, text.split(","))
    except ValueError:
        x = y = yaw = np.nan
    if not np.isfinite([x, y, yaw]).all() or max(abs(x), abs(y)) > FARTHEST:
        raise InputError(
            f"--anchor-start {text[:60]}: must be E,N,YAW, an easting and a northing [m] of the "
            "model, and a heading [rad]"
        )
    return SE2(x, y, float(np.arctan2(np.sin(yaw), np.cos(yaw))))


def _placed(coordinates: MapCoordinates) -> str:
    """Say in which coordinates the map is, and what places it."""
    by = "the true positions" if coordinates.by_truth else "odometry's frame, x east and y north"
    if coordinates.by_anchor:
        by = "the elevation model"
    system = coordinates.georeference
    longitude, latitude, height = system.origin
    return (
        f"in {system.name}, origin {latitude:.7f}, {longitude:.7f}, {height:.2f} m, placed by {by}"
    )


def _outside(anchored: Anchored) -> str:
    """Say which submaps have no height of the model under them."""
    names, total = anchored.outside, len(anchored.graph.poses)
    which = ", ".join(names[:5]) + (", …" if len(names) > 5 else "")
    return (
        f"{anchored.model.name}: has no height under {len(names)} of {count(total, 'submap')} "
        f"({which}); odometry and closures alone hold these"
    )


def _held(anchored: Anchored) -> str:
    """Say what holds a map on an elevation model."""
    surfaces, wrong = anchored.count("surface")
    places, refused = anchored.count("place")
    stated = "as stated" if anchored.model.std is not None else "estimated"
    return (
        f"anchored on {anchored.model.name}: {count(surfaces, 'height')} of its surface and "
        f"{count(places, 'place')} used, {wrong + refused} refused as wrong; error of its heights "
        f"{anchored.std:.2g} m, {stated}"
    )


def _corrected(solution: Solution, errors: MapErrors) -> list[str]:
    """Say how good a corrected map is: a line for each traverse, and one for the overlaps."""
    loops, refused = len(solution.result.loops), len(solution.result.refused)
    lines = [
        f"{count(len(solution.result.poses), 'submap')}, "
        f"{count(loops - refused, 'loop closure')} used, {refused} refused as wrong"
    ]
    if solution.result.height_note:
        lines.append(solution.result.height_note)
    if solution.anchored is not None:
        lines.append(_held(solution.anchored))
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
