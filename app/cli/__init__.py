"""The command line: a dataclass a verb, whose fields are its arguments."""

import contextlib
import io
import math
import re
import socket
import sys
import time
import webbrowser
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import (
    Annotated,
    Any,
    Literal,
    TypeAlias,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import tyro
from platformdirs import user_config_path
from tqdm import tqdm
from typing_extensions import Doc
from tyro.constructors import (
    ConstructorRegistry,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from gpgrad_core.datasets import (
    SimulationParams,
    demo_path,
    load_dataset,
    outline_dataset,
    simulate_dataset,
    write_dataset,
)
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import (
    Evaluation,
    EvaluationParams,
    Section,
    calibrate,
    check_directory,
    describe_calibration,
    evaluate,
    measure_pairs,
    rank_pairs,
    read_rivals,
    run_methods,
    write_report,
)
from gpgrad_core.fitting import FitResult, fit_parameters, fitted_names
from gpgrad_core.gradient_map import MapParams, TerrainParams, infer_gradient_map, point_noise
from gpgrad_core.methods import METHODS, find_method
from gpgrad_core.outputs import (
    MAP_ENDINGS,
    check_output,
    read_closures,
    report_closures,
    restore_closures,
    write_closures,
    write_fitted,
    write_map,
)
from gpgrad_core.params.bounds import Bounds, bounded_fields
from gpgrad_core.params.files import preferred_parameters, read_parameters
from gpgrad_core.pipeline import DetectionResult, PipelineParams, detect_loop_closures
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.progress import Progress, part, silent
from gpgrad_core.run.threads import num_workers
from gpgrad_core.scans import BuildParams, RecordingSources, build_dataset, simulate_recording
from gpgrad_core.slam import (
    GraphParams,
    Judged,
    LoopCloser,
    MergeParams,
    Sessions,
    Solution,
    SolverParams,
    build_pose_graph,
    check_solver,
    join_datasets,
    judge_solution,
    odometry_poses,
    solve_sessions,
    write_graph,
    write_merged,
    write_solution,
)
from gpgrad_core.types import Dataset, LoopClosure
from gpgrad_core.version import VERSION

V = TypeVar("V")

FAILED, INTERRUPTED = 2, 130
DESCRIPTION = (
    "Loop closures from Gaussian-process gradient maps of bare terrain. "
    "`gpgrad VERB --help` tells all of a verb; `gpgrad --version` prints the version."
)

ParamsFile: TypeAlias = Annotated[
    Path | None,
    Doc("TOML file of parameters, a table a group: [map] length_scale = 0.3. A flag outweighs it."),
]
AllParams: TypeAlias = Annotated[PipelineParams, tyro.conf.arg(name="")]


@dataclass(frozen=True)
class View:
    """Open the viewer in a browser: surfaces, matches and verdict of two submaps, live."""

    dataset: Annotated[
        tyro.conf.Positional[Path | None],
        Doc("Dataset folder, folder of clouds, or one cloud; without it the built-in demo."),
    ] = None
    host: Annotated[str, Doc("Address to serve on; 0.0.0.0 lets other machines in.")] = "127.0.0.1"
    port: Annotated[int, Doc("Port to serve on; the next free one if it is taken, any if 0.")] = (
        8080
    )
    open: Annotated[bool, Doc("Open the browser by itself.")] = True
    sessions: Annotated[
        Literal["shared", "separate"],
        Doc("shared: all pages see and change the same. separate: each page has its own."),
    ] = "shared"
    state: Annotated[
        Path | None,
        Doc("Begin as the viewer was when it saved this file; DATASET and flags outweigh it."),
    ] = None
    root: Annotated[
        Path | None,
        Doc("Pages may choose among the datasets in this folder, and open none elsewhere."),
    ] = None
    config: Annotated[
        Path | None,
        Doc("Folder of your presets and of the list of recent datasets; by default your own."),
    ] = None
    max_upload: Annotated[int, Doc("Largest file that a page may upload, in MB.")] = 200
    params: ParamsFile = None
    pipeline: AllParams = field(default_factory=PipelineParams)

    def run(self, given: Sequence[str]) -> None:
        """Serve until interrupted."""
        # Here, because viser is heavy, and for this verb only.
        from app.viewer.permissions import Permissions  # noqa: PLC0415
        from app.viewer.server import Viewer  # noqa: PLC0415
        from app.viewer.session_file import read_session  # noqa: PLC0415

        _check_address(self.host, self.port)
        if self.root is not None and not self.root.is_dir():
            raise InputError(f"--root {self.root}: no such folder")
        if self.max_upload < 1:
            raise InputError(f"--max-upload must be 1 MB or more, got {self.max_upload}")
        saved = None if self.state is None else read_session(self.state)
        source = self.dataset or (saved and saved.dataset) or demo_path()
        dataset = _load(source)
        base = _base(dataset, None if saved else self.params)
        start = base
        if saved is not None:
            saved.check(dataset)
            start = read_parameters(self.params, saved.params) if self.params else saved.params
        params = _again(self, given, pipeline=start).pipeline
        viewer = Viewer(
            dataset,
            params if saved is None else base,
            self.host,
            self.port,
            source=str(source),
            saved=saved and replace(saved, params=params),
            sessions=self.sessions,
            permissions=Permissions(
                config=self.config or user_config_path("gpgrad", appauthor=False),
                root=self.root,
                max_upload=1_000_000 * self.max_upload,
            ),
        )
        try:
            _say(f"{dataset.name} is at {viewer.url} (Ctrl-C ends)")
            if self.open:
                webbrowser.open(viewer.url)
            viewer.run_forever()
        finally:
            viewer.close()


@dataclass(frozen=True)
class Detect:
    """Register, score and judge every pair of submaps of a dataset."""

    dataset: Annotated[tyro.conf.Positional[Path], Doc("Dataset folder or folder of clouds.")]
    out: Annotated[Path, Doc("File to write: closures.json.")]
    method: Annotated[str, Doc(f"How to detect: {', '.join(METHODS)}.")] = "gradient"
    g2o: Annotated[Path | None, Doc("Also write the pose graph to this .g2o file.")] = None
    pair: Annotated[
        tuple[str, str] | None,
        Doc("Compare these two submaps only: the id of the query, then of the database."),
    ] = None
    params: ParamsFile = None
    pipeline: AllParams = field(default_factory=PipelineParams)

    def run(self, given: Sequence[str]) -> None:
        """Detect and write."""
        method = find_method(self.method)
        check_output(self.out, (".json",))
        if self.g2o:
            check_output(self.g2o, (".g2o",))
        dataset = _load(self.dataset)
        if self.pair:
            dataset = _only(dataset, *self.pair)
        asked = _again(self, given, pipeline=_base(dataset, self.params)).pipeline
        params = method.adapt(asked)
        if self.g2o:
            odometry_poses(dataset)  # a graph without odometry should not cost minutes
        num_pairs = math.comb(len(dataset.submaps), 2)
        with _progress("pairs") as progress, workers(num_workers(), num_pairs) as executor:
            result = detect_loop_closures(
                dataset,
                params,
                detector=method.detector(params, Memo()),
                executor=executor,
                progress=progress,
            )
        report = report_closures(dataset, result, params, method=method.name)
        write_closures(self.out, report)
        if self.g2o:
            write_graph(self.g2o, build_pose_graph(dataset, result.closures))
        count = len(report.accepted)
        _say(
            f"{count} loop closure{'' if count == 1 else 's'} in {len(report.pairs)} pairs of "
            f"{len(report.submaps)} submaps, {report.seconds['total']:.1f} s: {self.out}"
        )


@dataclass(frozen=True)
class Evaluate:
    """Judge methods by the true poses: precision and recall, pose errors, figures."""

    dataset: Annotated[tyro.conf.Positional[Path], Doc("Dataset folder with poses_gt.txt.")]
    out: Annotated[Path, Doc("Folder for report.md, report.json and figures; made if need be.")]
    method: Annotated[
        tuple[str, ...],
        Doc(
            f"Methods to run, of: {', '.join(METHODS)}; gradient if neither methods nor files of "
            "closures are given."
        ),
    ] = ()
    closures: Annotated[
        tuple[Path, ...], Doc("Files of closures to judge besides, as `gpgrad detect` writes them.")
    ] = ()
    seed: Annotated[
        int | None, Doc("Seed of every random choice; None takes that of the parameters, 0.")
    ] = None
    calibration: Annotated[
        bool, Doc("Also judge the maps' uncertainty by points held out; takes about a minute.")
    ] = False
    evaluation: Annotated[EvaluationParams, tyro.conf.arg(name="")] = field(
        default_factory=EvaluationParams
    )
    params: ParamsFile = None
    pipeline: AllParams = field(default_factory=PipelineParams)

    def run(self, given: Sequence[str]) -> None:
        """Detect with each method, judge and write."""
        names = self.method if self.method or self.closures else ("gradient",)
        methods = [find_method(name) for name in names]
        check_directory(self.out)
        rivals = read_rivals(self.closures, taken=names)
        dataset = _load(self.dataset)
        params = _again(self, given, pipeline=_base(dataset, self.params)).pipeline
        if self.seed is not None:
            params = replace(params, registration=replace(params.registration, seed=self.seed))
        pairs = measure_pairs(dataset)
        for name, report in rivals.items():
            rank_pairs(report, dataset, pairs, name)  # a wrong file should not cost an hour
        num_jobs = math.comb(len(dataset.submaps), 2) * len(methods)
        with _progress("evaluate") as progress, workers(num_workers(), num_jobs) as executor:
            found = run_methods(dataset, methods, params, executor=executor, progress=progress)
        evaluation = evaluate(
            dataset,
            found | rivals,
            self.evaluation,
            pairs=pairs,
            seed=params.registration.seed,
        )
        sections = self._sections(dataset, params)
        with _progress("figures") as progress:
            write_report(self.out, evaluation, closures=found, sections=sections, progress=progress)
        for note in evaluation.notes:
            _warn(note)
        for line in (*_told(evaluation), str(self.out / "report.md")):
            _say(line)

    def _sections(self, dataset: Dataset, params: PipelineParams) -> tuple[Section, ...]:
        if not self.calibration:
            return ()
        with _progress("calibration") as progress:
            judged = calibrate(dataset, params, seed=params.registration.seed, progress=progress)
        return (describe_calibration(judged),)


@dataclass(frozen=True)
class Map:
    """Infer one cloud's elevation, its variance, and both slopes."""

    cloud: Annotated[tyro.conf.Positional[Path], Doc("A gravity-aligned point cloud.")]
    out: Annotated[Path, Doc(f"File to write, one of {', '.join(MAP_ENDINGS)}.")]
    params: ParamsFile = None
    map: MapParams = field(default_factory=MapParams)

    def run(self, given: Sequence[str]) -> None:
        """Infer and write."""
        check_output(self.out, MAP_ENDINGS)
        if self.cloud.is_dir():
            raise InputError(f"{self.cloud}: is a folder; give one cloud")
        dataset = _load(self.cloud)
        base = _base(dataset, self.params)
        params = _again(self, given, map=base.map).map
        (cloud,) = dataset.submaps
        with _progress("map") as progress:
            gradient_map = infer_gradient_map(cloud, params, progress)
        write_map(
            self.out,
            gradient_map,
            name=cloud.id,
            max_std_ratio=base.features.max_std_ratio,
        )
        outlying = int(point_noise(cloud, params.terrain).outlying.sum())
        if outlying:
            _warn(
                f"{outlying:,} of {len(cloud.points):,} points lie far off the ground around them "
                "and count as little as that"
            )
        rows, columns = gradient_map.grid.shape
        _say(
            f"{columns} x {rows} cells of {params.resolution:g} m "
            f"from {len(cloud.points):,} points: {self.out}"
        )


@dataclass(frozen=True)
class Fit:
    """Find length-scale, signal and noise of the terrain by maximum marginal likelihood."""

    dataset: Annotated[
        tyro.conf.Positional[Path], Doc("Dataset folder, folder of clouds, or one cloud.")
    ]
    out: Annotated[
        Path | None, Doc("File to write: .toml, which the other verbs take as parameters.")
    ] = None
    seed: Annotated[int, Doc("Seed of the choice of points.")] = 0
    params: ParamsFile = None
    map: TerrainParams = field(default_factory=TerrainParams)

    def run(self, given: Sequence[str]) -> None:
        """Fit, tell and write."""
        if self.out:
            check_output(self.out, (".toml",))
        if self.seed < 0:
            raise InputError(f"--seed must be 0 or more, got {self.seed}")
        dataset = _load(self.dataset)
        start = _again(self, given, map=_base(dataset, self.params).map.terrain).map
        with _progress("fit") as progress:
            result = fit_parameters(dataset.submaps, start, seed=self.seed, progress=progress)
        for line in _fitted(start, result):
            _say(line)
        if self.out:
            write_fitted(self.out, result)
            _say(str(self.out))


@dataclass(frozen=True)
class Build:
    """Build submaps from scans and poses; what was stopped is gone on with by the same command."""

    scans: Annotated[
        tyro.conf.Positional[Path],
        Doc("Folder of clouds with a file of poses, or a ROS 1 or ROS 2 bag."),
    ]
    out: Annotated[Path, Doc("Dataset folder to make; must not exist yet.")]
    poses: Annotated[
        Path | None,
        Doc("File of poses, TUM or KITTI; None: poses.txt beside the scans, or a bag's topic."),
    ] = None
    truth: Annotated[
        Path | None,
        Doc("File of true poses, to evaluate by; None: poses_gt.txt beside the scans, if any."),
    ] = None
    times: Annotated[
        Path | None,
        Doc("File of the scans' times [s], one a row; None: times.txt, or else their names."),
    ] = None
    mount: Annotated[
        Path | None,
        Doc(
            "File with the sensor's pose on the body that the poses are of, tx ty tz qx qy qz qw, "
            "or KITTI's calib.txt; None: mount.txt, a bag's transforms, or the body itself."
        ),
    ] = None
    cloud_topic: Annotated[
        str | None, Doc("Topic of a bag's clouds; None: the only one there is.")
    ] = None
    pose_topic: Annotated[
        str | None,
        Doc("Topic of a bag's poses; None: the only one there is, or else the transforms."),
    ] = None
    world_frame: Annotated[
        str | None,
        Doc("Frame to build in where poses are transforms; None: the root of their tree."),
    ] = None
    restart: Annotated[bool, Doc("Throw away what a stopped build has left.")] = False
    build: Annotated[BuildParams, tyro.conf.arg(name="")] = field(default_factory=BuildParams)

    def run(self, given: Sequence[str]) -> None:  # noqa: ARG002 - as the other verbs
        """Build and write."""
        sources = RecordingSources(
            poses=self.poses,
            truth=self.truth,
            times=self.times,
            mount=self.mount,
            cloud_topic=self.cloud_topic,
            pose_topic=self.pose_topic,
            world_frame=self.world_frame,
        )
        try:
            with _progress("build") as progress:
                report = build_dataset(
                    self.scans,
                    self.out,
                    self.build,
                    sources=sources,
                    restart=self.restart,
                    progress=progress,
                )
        except KeyboardInterrupt:
            raise KeyboardInterrupt("interrupted; the same command goes on from here") from None
        for note in report.notes:
            _warn(note)
        resumed = f", {report.num_resumed} of them from before" if report.num_resumed else ""
        _say(
            f"{_count(report.num_submaps, 'submap')} of {_count(report.num_scans, 'scan')}"
            f"{resumed}: {self.out}"
        )


@dataclass(frozen=True)
class Simulate:
    """Make a synthetic dataset with known truth."""

    directory: Annotated[tyro.conf.Positional[Path], Doc("Folder to make; must not exist yet.")]
    scans: Annotated[
        int,
        Doc("Make a recording of so many scans instead, for `gpgrad build`; 0: submaps."),
    ] = 0
    simulation: Annotated[SimulationParams, tyro.conf.arg(name="")] = field(
        default_factory=SimulationParams
    )

    def run(self, given: Sequence[str]) -> None:  # noqa: ARG002 - as the other verbs
        """Simulate and write."""
        if self.scans:
            with _progress("simulate") as progress:
                simulate_recording(self.directory, self.scans, self.simulation, progress=progress)
            _say(f"{_count(self.scans, 'scan')}: {self.directory}")
            return
        with _progress("simulate") as progress:
            dataset = simulate_dataset(self.simulation, progress)
        write_dataset(dataset, self.directory)
        _say(f"{len(dataset.submaps)} submaps: {self.directory}")


@dataclass(frozen=True)
class Slam:
    """Correct a traverse by its loop closures, and put its submaps into one cloud and one map."""

    datasets: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        Doc("Dataset folders with odometry; closures between several put them into one map."),
    ]
    out: Annotated[Path, Doc("Folder for poses, graph, figures, cloud and map; made if need be.")]
    closures: Annotated[
        Path | None, Doc("File of closures, as `gpgrad detect` writes it; None: detect them.")
    ] = None
    search_radius: Annotated[
        float | None,
        Doc(
            "Compare only submaps of a traverse within this many metres of each other, by the "
            "estimate so far; None: all."
        ),
    ] = None
    merge: Annotated[bool, Doc("Write the merged cloud and map too.")] = True
    graph: GraphParams = field(default_factory=GraphParams)
    solver: SolverParams = field(default_factory=SolverParams)
    merged: MergeParams = field(default_factory=MergeParams)
    params: ParamsFile = None
    pipeline: AllParams = field(default_factory=PipelineParams)

    def run(self, given: Sequence[str]) -> None:
        """Detect, solve, judge and write."""
        check_directory(self.out)
        if self.search_radius is not None and not self.search_radius > 0:
            raise InputError(f"--search-radius must be above 0 m, got {self.search_radius:g}")
        sessions = join_datasets([outline_dataset(path) for path in self.datasets])
        dataset = sessions.outline.dataset
        odometry_poses(dataset)  # what lacks it, or a solver, should not cost minutes
        check_solver()
        for note in dataset.notes:
            _warn(note)
        params = _again(self, given, pipeline=_base(dataset, self.params)).pipeline
        if self.closures:
            closures = restore_closures(read_closures(self.closures))
        else:
            closures = self._detect(sessions, params)
        solution = solve_sessions(sessions, closures, self.graph, self.solver)
        with _progress("judge") as progress:
            judged = judge_solution(solution, progress)
        with _progress("write") as progress:
            write_solution(self.out, solution, judged, progress)
        if self.merge:
            with _progress("merge") as progress:
                terrain = params.map.terrain
                notes = write_merged(self.out, solution, terrain, self.merged, progress)
            for note in notes:
                _warn(note)
        for line in (*_corrected(solution, judged), str(self.out)):
            _say(line)

    def _detect(self, sessions: Sessions, params: PipelineParams) -> tuple[LoopClosure, ...]:
        """Find the closures submap by submap, and keep them beside the results."""
        count, sizes, start = len(sessions.outline.clouds), dict[str, int](), time.perf_counter()
        with (
            _progress("closures") as progress,
            ThreadPoolExecutor(num_workers()) as executor,
            LoopCloser(
                params,
                self.graph,
                self.solver,
                search_radius=self.search_radius,
                executor=executor,
            ) as closer,
        ):
            for k in range(count):
                submap, notes = sessions.load(k)
                for note in notes:
                    _warn(note)
                sizes[submap.id] = len(submap.points)
                closer.add(
                    submap,
                    part(progress, (k / count) ** 2, ((k + 1) / count) ** 2),
                    starts_traverse=submap.id in sessions.starts,
                    solve=self.search_radius is not None,
                )
            closures = closer.closures
        seconds = {"total": time.perf_counter() - start}
        self.out.mkdir(exist_ok=True)
        report = report_closures(
            sessions.outline.dataset, DetectionResult(closures, seconds), params
        )
        write_closures(self.out / "closures.json", replace(report, submaps=sizes))
        return closures


Verb: TypeAlias = View | Detect | Evaluate | Map | Fit | Build | Slam | Simulate
VERBS: dict[str, type[Verb]] = {
    "view": View,
    "detect": Detect,
    "evaluate": Evaluate,
    "map": Map,
    "fit": Fit,
    "build": Build,
    "slam": Slam,
    "simulate": Simulate,
}


def run(arguments: Sequence[str]) -> int:
    """Run one verb.

    Args:
        arguments: The command line without the program's name.

    Returns:
        The exit code: 0, or 2 after one line on standard error that says what was wrong, or 130
        if interrupted.
    """
    try:
        if list(arguments) == ["--version"]:
            _say(VERSION)
            return 0
        verb = _parsed(arguments)
        verb.run(arguments[1:])
    except InputError as error:
        _warn(_one_line(str(error)))
        return FAILED
    except OSError as error:
        what = error.strerror or str(error)
        _warn(_one_line(f"{error.filename}: {what}" if error.filename else what))
        return FAILED
    except KeyboardInterrupt as stopped:
        _warn(str(stopped) or "interrupted")
        return INTERRUPTED
    return 0


def _parsed(arguments: Sequence[str]) -> Verb:
    """Turn the command line into a verb's arguments.

    Raises:
        InputError: If the usage is wrong.
        SystemExit: After help was printed.
    """
    verb = arguments[0] if arguments else ""
    if verb in VERBS:
        return _flags(VERBS[verb], arguments[1:])
    if verb and not verb.startswith("-"):
        raise InputError(f"unknown verb {verb!r}; known: {', '.join(VERBS)}")
    with _one_line_usage():
        return tyro.extras.subcommand_cli_from_dict(
            VERBS, prog="gpgrad", description=DESCRIPTION, args=arguments, registry=REGISTRY
        )


def _flags(verb: type[V], given: Sequence[str], default: V | None = None) -> V:
    with _one_line_usage():
        return tyro.cli(
            verb,
            prog=f"gpgrad {verb.__name__.lower()}",
            args=given,
            default=tyro.MISSING_NONPROP if default is None else default,
            registry=REGISTRY,
        )


def _again(verb: V, given: Sequence[str], **bases: object) -> V:
    """Read the same command line over other defaults, so that a flag outweighs a file."""
    return _flags(type(verb), given, replace(cast("Any", verb), **bases))


def _base(dataset: Dataset, path: Path | None) -> PipelineParams:
    """Parameters before any flag: built-in, then what the dataset prefers, then the file."""
    params = preferred_parameters(dataset, PipelineParams())
    return params if path is None else read_parameters(path, params)


def _check_address(host: str, port: int) -> None:
    """Refuse where nothing can be served: the server would wait for itself without end."""
    if not 0 <= port <= 65535:
        raise InputError(f"--port must be from 0 to 65535, got {port}")
    try:
        family, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family) as probe:
            probe.bind(address)
    except OSError as error:
        raise InputError(f"--host {host}: cannot serve there: {error.strerror}") from error


def _load(path: Path) -> Dataset:
    """Load a dataset, saying aloud what loading left out."""
    with _progress("load") as progress:
        dataset = load_dataset(path, progress)
    for note in dataset.notes:
        _warn(note)
    return dataset


def _only(dataset: Dataset, query_id: str, database_id: str) -> Dataset:
    """Keep two submaps, the database first: the later one is the query."""
    if query_id == database_id:
        raise InputError(f"--pair: {query_id} beside itself is no pair; name two submaps")
    return replace(dataset, submaps=(dataset.submap(database_id), dataset.submap(query_id)))


def _told(evaluation: Evaluation) -> list[str]:
    """What an evaluation found, a line a method."""
    rule, lines = evaluation.rules[0], list[str]()
    for method in evaluation.methods:
        verdict = method.rules[0]
        line = f"{method.name}: "
        if verdict.ranked:
            line += (
                f"AP {verdict.ranked.average_precision.value:.3f}, "
                f"R100 {verdict.ranked.recall_at_full_precision.value:.3f}, "
            )
        lines.append(
            f"{line}accepts {verdict.accepted_true} true and {verdict.accepted_false} false pairs, "
            f"misses {verdict.missed} ({rule.name})"
        )
    return lines


def _fitted(start: TerrainParams, result: FitResult) -> list[str]:
    """What a fit found, a line a parameter."""
    units = {one.name: one.bounds.unit for one in bounded_fields(TerrainParams)}
    lines: list[str] = []
    for name in fitted_names(start):
        before, after = (
            "the points' own" if value is None else f"{value:.4g}"
            for value in (getattr(start, name), getattr(result.params, name))
        )
        unit = f" {units[name]}" if units[name] else ""
        lines.append(f"{name}: {before} -> {after}{unit}")
    count = len(result.submap_ids)
    lines.append(
        f"log likelihood per point: {result.log_likelihood_before:.3f} -> "
        f"{result.log_likelihood_after:.3f} ({result.num_points:,} points of {count} "
        f"submap{'' if count == 1 else 's'}, {result.num_evaluations} evaluations)"
    )
    return lines


def _count(number: int, what: str) -> str:
    """Say how many there are.

    >>> _count(1, "scan"), _count(1200, "scan")
    ('1 scan', '1,200 scans')
    """
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def _corrected(solution: Solution, judged: Judged) -> list[str]:
    """What a corrected map is like, a line a session and one for the overlaps."""
    loops, refused = len(solution.result.loops), len(solution.result.refused)
    lines = [
        f"{len(solution.result.poses)} submaps, {loops - refused} loop "
        f"closure{'' if loops - refused == 1 else 's'} used, {refused} refused as wrong"
    ]
    for session, (before, after) in judged.trajectories.items():
        lines.append(
            f"{session}: trajectory error {before.absolute:.3f} m -> {after.absolute:.3f} m, "
            f"from submap to submap {before.relative:.3f} m -> {after.relative:.3f} m"
        )
    first, last = judged.overlaps
    if first.median is not None and last.median is not None:
        lines.append(
            f"median height difference where submaps overlap: {100 * first.median:.1f} cm "
            f"({first.count} pairs) -> {100 * last.median:.1f} cm ({last.count} pairs)"
        )
    return lines


def _say(line: str) -> None:
    """Tell what was done or asked for."""
    print(line, flush=True)  # noqa: T201


def _warn(line: str) -> None:
    """Tell anything else, where it does not mix with what was asked for."""
    print(f"gpgrad: {line}", file=sys.stderr, flush=True)  # noqa: T201


@contextlib.contextmanager
def _progress(what: str) -> Generator[Progress]:
    """Draw a bar on a terminal, and nothing into a file or a pipe."""
    if not sys.stderr.isatty():
        yield silent
        return
    layout = "{desc:>9} {percentage:3.0f} %|{bar}| {elapsed}<{remaining}"
    with tqdm(total=1.0, desc=what, bar_format=layout, leave=False) as bar:

        def progress(fraction: float) -> None:
            bar.n = fraction
            bar.refresh()

        yield progress


@contextlib.contextmanager
def _one_line_usage() -> Generator[None]:
    """Turn tyro's box of several lines about a wrong usage into an error of one line."""
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            yield
    except SystemExit as leaving:
        if leaving.code:
            raise InputError(_unboxed(box.getvalue())) from leaving
        raise


def _unboxed(text: str) -> str:
    r"""What a box drawn with lines says, in one line, without the pointer to the help.

    >>> _unboxed("╭─ Parsing error ────╮\n│ --port: not a number │\n╰──────────────────────╯")
    '--port: not a number'
    """
    plain = re.sub(r"\x1b\[[0-9;]*m", "", text)
    _, *rows = [re.sub(r"[\u2500-\u257f]+", "", row) for row in plain.splitlines()]
    said = re.split(r"Argument helptext:|For full helptext", _one_line(" ".join(rows)))[0]
    return re.sub(r"Error parsing (pipeline\.)?", "", said).strip()


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _help_of_params(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Tell tyro about a params dataclass: its texts, with the unit and the range of its bounds."""
    params = info.type
    if not is_dataclass(params) or not any(_bounds(hint) for hint in _hints(params).values()):
        return None
    default = info.default if isinstance(info.default, params) else params()
    specs: list[StructFieldSpec] = []
    for one in fields(params):
        hint = _hints(params)[one.name]
        value = getattr(default, one.name)
        bounds = _bounds(hint)
        if bounds is None:
            specs.append(StructFieldSpec(one.name, hint, value))
            continue
        doc = next(
            (extra.documentation for extra in hint.__metadata__ if isinstance(extra, Doc)), ""
        )
        unit = f" {bounds.unit}" if bounds.unit else ""
        text = f"{doc} From {bounds.low:,.10g} to {bounds.high:,.10g}{unit}."
        specs.append(StructFieldSpec(one.name, get_args(hint)[0], value, text))
    return StructConstructorSpec(params, tuple(specs))


def _hints(params: type) -> dict[str, Any]:
    return get_type_hints(params, include_extras=True)


def _bounds(hint: object) -> Bounds | None:
    if get_origin(hint) is not Annotated:
        return None
    return next((extra for extra in get_args(hint)[1:] if isinstance(extra, Bounds)), None)


REGISTRY = ConstructorRegistry()
REGISTRY.struct_rule(_help_of_params)
