"""The page of a dataset: maps, scores and every accepted pair, in one file that asks no server."""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil, degrees, sqrt
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy.typing import DTypeLike

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection import (
    PairResult,
    PipelineParams,
    infer_features,
    infer_map,
    resolve_parameters,
)
from gpgrad_core.detection.choosing import likely
from gpgrad_core.errors import InputError, score_in_words
from gpgrad_core.evaluation import Evaluation, EvaluationParams, evaluate
from gpgrad_core.evaluation.report import render
from gpgrad_core.io.folder import Outline
from gpgrad_core.io.records.closures import (
    ClosureReport,
    restore_closures,
    rounded,
)
from gpgrad_core.io.records.files import replacing
from gpgrad_core.mapping.fitting import representative
from gpgrad_core.matching import match_features
from gpgrad_core.pages.packing import Pack, pack_terrain
from gpgrad_core.params import AUTOMATIC, get_path, parameters_of
from gpgrad_core.registration.candidates import one_to_one
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.se2 import FAR, SE2, Pose
from gpgrad_core.slam import MapErrors, Solution, build_pose_graph, optimise_pose_graph
from gpgrad_core.slam.errors import level_motion, positions, true_poses
from gpgrad_core.slam.graph import shifted
from gpgrad_core.types import Dataset, Features, GradientMap, LoopClosure, Submap
from gpgrad_core.version import VERSION

PAGE = "page.html"
"""Name of the page in a folder of results."""
FOLDER = Path(__file__).parent
MOST_CELLS = 4_500_000
"""Of all terrain together: about 7 MB of a page."""
MOST_ALONG = 160
"""Cells along a side of one submap."""
MOST_HELD = 300_000_000
"""Bytes of maps that are held at a time; each is needed once."""
MOST_JUDGED = 400
"""Submaps; of more, too many pairs would be compared with the truth for the sake of a curve."""
MOST_LINED = 1000
"""Number of pairs, the best first, whose keypoints the page has."""

ACCEPTED, BARRED, TRUE, FALSE, RIGHT, DROPPED, CONFIRMED = 1, 2, 4, 8, 16, 32, 64
"""What is known of a pair, as bits: accepted; refused for another reason than its score; true and
false by the first rule of the evaluation; its motion is right; refused by the pose graph;
a person has accepted it, whatever its score."""


@runtime_checkable
class Loadable(Protocol):
    """Where a submap comes from: a `SubmapSource`, or less."""

    @property
    def id(self) -> str: ...

    def load(self) -> Submap:
        """Load the submap."""
        ...


@dataclass(frozen=True)
class OutlinedSubmap:
    """A submap of an outlined dataset, which is loaded when it is needed."""

    outline: Outline  # the dataset
    number: int  # the submap's place in it

    @property
    def id(self) -> str:
        return self.outline.dataset.submaps[self.number].id

    def load(self) -> Submap:
        """Load the submap."""
        return self.outline.load(self.number)[0]


@dataclass(frozen=True, eq=False)
class Subject:
    """What a page shows.

    Attributes:
        name: Name of the dataset.
        sources: Where the submaps are loaded from, in their order.
        report: The verdicts on the pairs.
        params: Parameters of all stages.
        before: Poses ``T_world_submap`` by id before the correction; none if nothing is known.
        after: Corrected poses; None if nothing was corrected.
        truth: True poses, as far as they are known.
        starts: First submaps of further traverses.
        dropped: Closures (query id, database id) that the pose graph refused as wrong.
        evaluation: The method of the report, judged by the true poses.
        figures: Names and values at the top of the page.
        commands: Command lines that make the same.
        notes: What was left out, one line each.
    """

    name: str
    sources: Sequence[Loadable]
    report: ClosureReport
    params: PipelineParams
    before: Mapping[str, Pose] = field(default_factory=dict[str, Pose])
    after: Mapping[str, Pose] | None = None
    truth: Mapping[str, Pose] = field(default_factory=dict[str, Pose])
    starts: Collection[str] = ()
    dropped: Collection[tuple[str, str]] = ()
    evaluation: Evaluation | None = None
    figures: Sequence[tuple[str, str]] = ()
    commands: Sequence[str] = ()
    notes: Sequence[str] = ()


def corrected(
    dataset: Dataset, closures: Sequence[LoopClosure], trusted: Collection[tuple[str, str]] = ()
) -> tuple[dict[str, Pose], dict[str, Pose] | None, tuple[tuple[str, str], ...], str]:
    """Correct a dataset's odometry by its closures, if it has any.

    It gives the poses before and after, the refused closures, and why there are no corrected poses,
    or an empty text.
    """
    odometry = {
        submap.id: submap.pose_odometry
        for submap in dataset.submaps
        if submap.pose_odometry is not None
    }
    if len(odometry) < len(dataset.submaps):
        true = {s.id: s.pose_true for s in dataset.submaps if s.pose_true is not None}
        return true, None, (), "The dataset has no odometry, so there is nothing to correct."
    accepted = [closure for closure in closures if closure.accepted]
    if not accepted:
        return odometry, None, (), "No loop closure was accepted, so nothing was corrected."
    try:
        solved = optimise_pose_graph(build_pose_graph(dataset, accepted, trusted=trusted))
    except InputError as error:
        return odometry, None, (), f"The poses were not corrected: {error}"
    refused = tuple(fit.edge.pair for fit in solved.refused)
    return odometry, solved.poses, refused, ""


def judge(
    dataset: Dataset,
    sources: Sequence[Loadable],
    report: ClosureReport,
    progress: Progress = silent,
) -> Evaluation | None:
    """Judge verdicts by the true poses; None without these, or beyond `MOST_JUDGED` submaps."""
    if len(true_poses(dataset)) < 2 or not report.pairs or len(sources) > MOST_JUDGED:
        return None
    loaded = replace(dataset, submaps=tuple(source.load() for source in sources))
    bare = EvaluationParams(num_resamples=0)
    return evaluate(loaded, {report.method: report}, bare, progress=progress)


def subject_of(
    dataset: Dataset,
    report: ClosureReport,
    params: PipelineParams,
    *,
    evaluation: Evaluation | None = None,
    commands: Sequence[str] = (),
) -> Subject:
    """Gather what the page of a loaded dataset shows; the closures correct its odometry.

    `commands` are command lines that make the same; an evaluation of None leaves that to `judge`.
    """
    truth = true_poses(dataset)
    if evaluation is None:
        evaluation = judge(dataset, dataset.submaps, report)
    closures = restore_closures(report)
    before, after, dropped, note = corrected(dataset, closures, report.confirmed)
    return Subject(
        dataset.name,
        dataset.submaps,
        report,
        params,
        before=before,
        after=after,
        truth=truth,
        dropped=dropped,
        evaluation=evaluation,
        figures=dataset_figures(report, len(dataset.submaps), evaluation),
        commands=commands,
        notes=[*([note] if note else []), *dataset.notes],
    )


def subject_of_map(
    solution: Solution,
    errors: MapErrors,
    report: ClosureReport,
    params: PipelineParams,
    commands: Sequence[str] = (),
    progress: Progress = silent,
) -> Subject:
    """Gather what the page of a solved map shows."""
    joined, result = solution.joined, solution.result
    dataset = joined.outline.dataset
    sources = [OutlinedSubmap(joined.outline, k) for k in range(len(dataset.submaps))]
    evaluation = None
    if len(joined.traverses) == 1:  # the truth of another may have another frame
        evaluation = judge(dataset, sources, report, progress)
    figures = dataset_figures(report, len(sources), evaluation)
    for session, (before, after) in errors.trajectories.items():
        of = f" of {session}" if len(joined.traverses) > 1 else ""
        change = f"{before.absolute:.3f} m to {after.absolute:.3f} m"
        figures.append((f"trajectory error{of}", change))
    return Subject(
        dataset.name,
        sources,
        report,
        params,
        before=solution.before,
        after=result.poses,
        truth=true_poses(dataset),
        starts=joined.starts,
        dropped=[fit.edge.pair for fit in result.refused],
        evaluation=evaluation,
        figures=figures,
        commands=commands,
        notes=dataset.notes,
    )


def write_page(
    path: Path, subject: Subject, memo: Memo | None = None, progress: Progress = silent
) -> None:
    """Write the page of a dataset, whole or not at all, with maps from the memo or its store.

    Raises:
        InputError: If the file cannot be written, or a submap's map cannot be made.
    """
    page = page_of_dataset(subject, memo, progress)
    with replacing(path) as unfinished:
        unfinished.write_text(page, encoding="utf-8")


def page_of_dataset(subject: Subject, memo: Memo | None = None, progress: Progress = silent) -> str:
    """Make the page of a dataset, as `write_page` writes it."""
    report, sources = subject.report, subject.sources
    memo = memo or Memo(MOST_HELD)
    params = _with_numbers(subject, memo)
    number = {source.id: k for k, source in enumerate(sources)}
    threshold = _threshold(report, params)
    ranked = likely(report.accepted)
    pack, wanted = Pack(), ranked[:MOST_LINED]
    named = {name for closure in wanted for name in closure.pair}
    features: dict[str, Features] = {}
    cells: list[dict[str, object]] = []
    centres: dict[str, Array] = {}
    side = 0.0
    for k, source in enumerate(sources):
        submap = source.load()
        terrain = infer_map(submap, params, memo)
        if not side:  # the first submap stands for the others
            height, width = (terrain.grid.resolution * count for count in terrain.grid.shape)
            side = max(sqrt(len(sources) * height * width / MOST_CELLS), 0.0)
        centre = centres[submap.id] = submap.centre
        cells.append(_add_terrain(pack, terrain, params.features.max_std_ratio, side, centre))
        if submap.id in named and report.method == "gradient":
            features[submap.id] = infer_features(submap, params, memo)
        progress(0.9 * (k + 1) / len(sources))
    lines = {
        closure.pair: _centred(line, *(centres[name] for name in closure.pair))
        for closure in wanted
        if (line := _inliers(closure, features, params)) is not None
    }
    _add_pairs(pack, subject, number, threshold)
    content = {
        "name": subject.name,
        "method": report.method,
        "threshold": threshold,
        "submaps": [
            {"id": source.id, "starts": k == 0 or source.id in subject.starts, **cells[k]}
            for k, source in enumerate(sources)
        ],
        "poses": _poses(subject, cells, centres),
        "curve": None if subject.evaluation is None else _curve(subject.evaluation),
        "skipped": report.num_pairs_skipped,
        "reasons": _reasons(report, number),
        "lines": [
            [number[query], number[database], _add_line(pack, k, line)]
            for k, ((query, database), line) in enumerate(lines.items())
        ],
        "arrays": pack.index,
    }
    progress(0.95)
    page = _filled(subject.name, content, pack, subject, parameters_in_words(params))
    progress(1.0)
    return page


def page_of_pair(
    result: PairResult,
    *,
    name: str = "",
    max_std_ratio: float = PipelineParams().features.max_std_ratio,
) -> str:
    """Make the page of one pair: both surfaces at the motion that was found, and the inliers."""
    closure = rounded(result.closure)
    pack = Pack()
    maps = (result.database_map, result.query_map)
    ids = (closure.database_id, closure.query_id)
    centres = [_middle(terrain) for terrain in maps]
    cells = [
        _add_terrain(pack, terrain, max_std_ratio, 0.0, centre)
        for terrain, centre in zip(maps, centres, strict=True)
    ]
    report = ClosureReport(
        dataset=name or f"{closure.query_id} onto {closure.database_id}",
        method="gradient",
        seed=0,
        params={},
        versions={},
        seconds={},
        submaps=dict.fromkeys(ids, 0),
        pairs=(closure,),
    )
    score = closure.registration.score
    threshold = score if closure.accepted else np.nextafter(score, np.inf)
    subject = Subject(report.dataset, (), report, PipelineParams(), figures=_pair_figures(closure))
    _add_pairs(pack, subject, {ids[0]: 0, ids[1]: 1}, float(threshold))
    lines: list[list[int]] = []
    if result.registration.num_inliers:
        kept, matches = result.registration.inliers, result.matches
        both = np.hstack([matches.query_xy[kept], matches.database_xy[kept]])
        lines = [[1, 0, _add_line(pack, 0, _centred(both, *centres[::-1]))]]
    content = {
        "name": report.dataset,
        "method": "",
        "threshold": float(threshold),
        "submaps": [{"id": ids[k], "starts": True, **cells[k]} for k in (0, 1)],
        "poses": None,
        "curve": None,
        "skipped": 0,
        "reasons": [[1, 0, closure.reason]],
        "lines": lines,
        "arrays": pack.index,
    }
    return _filled(report.dataset, content, pack, subject, [])


def parameters_in_words(params: PipelineParams) -> list[tuple[str, str, bool]]:
    """List all parameters: name, value with unit, and whether it differs from the default."""
    base, rows = PipelineParams(), list[tuple[str, str, bool]]()
    for parameter in parameters_of(PipelineParams):
        value = get_path(params, parameter.path)
        text = AUTOMATIC if value is None else f"{value:g}" if type(value) is float else str(value)
        unit = "" if parameter.bounds is None or value is None else f" {parameter.bounds.unit}"
        rows.append((parameter.path, text + unit, value != get_path(base, parameter.path)))
    return rows


def _filled(
    title: str,
    content: Mapping[str, object],
    pack: Pack,
    subject: Subject,
    parameters: Sequence[tuple[str, str, bool]],
) -> str:
    # A text that ends the script's element would end the page; the browser reads \u003c as <.
    text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return render(
        FOLDER / "page.html",
        title=title,
        content=text.replace("<", "\\u003c"),
        arrays=pack.text,
        style=(FOLDER / "page.css").read_text(encoding="utf-8"),
        script=(FOLDER / "page.js").read_text(encoding="utf-8"),
        figures=subject.figures,
        commands=subject.commands,
        notes=subject.notes,
        parameters=parameters,
        method=subject.report.method,
        whole=content["poses"] is not None,
        judged=content["curve"] is not None,
        corrected=subject.after is not None,
        version=VERSION,
    )


def _with_numbers(subject: Subject, memo: Memo) -> PipelineParams:
    if subject.params.map.has_numbers or not subject.sources:
        return subject.params
    some = [subject.sources[k].load() for k in representative(len(subject.sources))]
    return resolve_parameters(some, subject.params, memo)


def _threshold(report: ClosureReport, params: PipelineParams) -> float:
    """Give the score from which pairs were accepted.

    Some methods do not go by the least score; then it is the lowest of an accepted pair.
    """
    undecided = [closure for closure in report.pairs if closure.pair not in report.decisions]
    lowest = min((one.registration.score for one in undecided if one.accepted), default=np.inf)
    return float(min(params.closure.min_score, lowest))


def _add_terrain(
    pack: Pack,
    terrain: GradientMap,
    max_std_ratio: float,
    side: float,
    centre: Float[Array, "3"],
) -> dict[str, object]:
    """Pack every n-th cell of a map: at least `side` [m] wide, about a centre [m].

    Browsers draw with seven digits of a coordinate.
    """
    grid = terrain.grid
    every = max(ceil(side / grid.resolution - 0.01), ceil(max(grid.shape) / MOST_ALONG), 1)
    packed = pack_terrain(
        terrain.elevation[::every, ::every], terrain.trusted(max_std_ratio, every), grid
    )
    rows, columns = terrain.elevation[::every, ::every].shape
    pack.add("heights", packed.deltas)
    pack.add("known", packed.known)
    return {
        "centre": centre.tolist(),
        "x": round(float(grid.origin[0] - centre[0]), 4),
        "y": round(float(grid.origin[1] - centre[1]), 4),
        "cell": grid.resolution * every,
        "rows": rows,
        "columns": columns,
        "base": packed.base - float(centre[2]),
        "step": packed.step,
    }


def _inliers(
    closure: LoopClosure, features: Mapping[str, Features], params: PipelineParams
) -> Float[Array, "n 4"] | None:
    """Find a pair's inliers again: x, y in the query and in the database [m].

    None if they are not those that the pair was judged by, as with another method.
    """
    found = closure.registration
    motion, scale = found.T_database_query, found.scale
    if motion is None or scale is None or {*closure.pair} - features.keys():
        return None
    query, database = (features[name] for name in closure.pair)
    matches = match_features(query, database, params.matching)
    kept = one_to_one(motion, matches, params.registration.radius(scale))
    if abs(int(kept.sum()) - found.num_inliers) > 1:  # the file has nine digits of the motion
        return None
    return np.hstack([matches.query_xy[kept], matches.database_xy[kept]])


def _middle(terrain: GradientMap) -> Float[Array, "3"]:
    rows, columns = terrain.grid.shape
    place = terrain.grid.to_position(np.array([[columns - 1.0, rows - 1.0]]) / 2)[0]
    return np.array([*place, np.median(terrain.elevation)])


def _centred(
    line: Float[Array, "n 4"], query: Float[Array, "3"], database: Float[Array, "3"]
) -> Float[Array, "n 4"]:
    """Give inliers about the centres of both submaps [m]."""
    return line - np.concatenate([query[:2], database[:2]])


def _add_line(pack: Pack, number: int, line: Float[Array, "n 4"]) -> int:
    pack.add("line", line.astype(np.float32).ravel())
    return number


def _add_pairs(pack: Pack, subject: Subject, number: Mapping[str, int], threshold: float) -> None:
    """Pack all pairs, each as a number in each of these arrays."""
    report, dropped = subject.report, set(subject.dropped)
    found = [closure.registration for closure in report.pairs]
    known: dict[frozenset[str], int] = {}
    if subject.evaluation is not None:
        known = _labels(subject.evaluation)
    states: list[int] = []
    for judged, closure in zip(report.pairs, restore_closures(report), strict=True):
        decision = report.decisions.get(closure.pair)
        decided = None if decision is None else decision.accepted
        passes = judged.registration.score >= threshold
        barred = decided is False or (not judged.accepted and passes)
        states.append(
            ACCEPTED * closure.accepted
            | BARRED * (barred and not closure.accepted)
            | CONFIRMED * (decided is True)
            | DROPPED * (closure.pair in dropped)
            | known.get(frozenset(closure.pair), 0)
        )
    motions = [one.T_database_query for one in found]
    unknown = SE2(np.nan, np.nan, np.nan)
    far = any(max(abs(motion.x), abs(motion.y)) > FAR for motion in motions if motion is not None)

    def numbers(name: str, values: Sequence[float | None], kind: DTypeLike = np.float32) -> None:
        pack.add(name, np.array([np.nan if v is None else v for v in values], kind))

    def counts(name: str, values: Sequence[int]) -> None:
        pack.add(name, np.minimum(np.array(values, np.int64), 65535).astype(np.uint16))

    counts("query", [number[closure.query_id] for closure in report.pairs])
    counts("database", [number[closure.database_id] for closure in report.pairs])
    counts("inliers", [one.num_inliers for one in found])
    pack.add("state", np.array(states, np.uint8))
    numbers("score", [one.score for one in found])
    numbers("area", [one.overlap_area for one in found])
    for name in ("x", "y", "yaw"):
        values = [getattr(motion or unknown, name) for motion in motions]
        numbers(name, values, np.float64 if far else np.float32)
    numbers("z", [None if one.covariance is None else one.z_offset for one in found])


def _labels(evaluation: Evaluation) -> dict[frozenset[str], int]:
    """Give what the truth says of each pair, as bits."""
    pairs, labels, errors = evaluation.pairs, evaluation.labels[0], evaluation.methods[0].errors
    bits = TRUE * labels.positive + FALSE * labels.negative + RIGHT * errors.near
    ends = zip(pairs.query, pairs.database, strict=True)
    return {
        frozenset((pairs.ids[query], pairs.ids[database])): int(value)
        for (query, database), value in zip(ends, bits, strict=True)
    }


def _curve(evaluation: Evaluation) -> dict[str, object]:
    ranked, rule = evaluation.methods[0].rules[0].ranked, evaluation.rules[0]
    return {
        "rule": rule.statement,
        "true": int(evaluation.labels[0].positive.sum()),
        "average": None if ranked is None else round(ranked.average_precision.value, 4),
        "full": None if ranked is None else round(ranked.recall_at_full_precision.value, 4),
    }


def _reasons(report: ClosureReport, number: Mapping[str, int]) -> list[list[object]]:
    """Give the reasons of the pairs that somebody may ask about: those that rank high."""
    decided = zip(report.pairs, restore_closures(report), strict=True)
    ranked = sorted(decided, key=lambda both: (not both[1].accepted, -both[0].registration.score))
    return [
        [number[judged.query_id], number[judged.database_id], judged.reason]
        for judged, _ in ranked[: 2 * MOST_LINED]
    ]


def _poses(
    subject: Subject,
    cells: Sequence[Mapping[str, object]],
    centres: Mapping[str, Float[Array, "3"]],
) -> dict[str, object]:
    """Give x, y, yaw and height of every submap's centre before and after, and of the truth."""

    def placed(poses: Mapping[str, Pose]) -> dict[str, Pose]:
        return {name: shifted(poses[name], centres[name]) for name in ids if name in poses}

    ids = [source.id for source in subject.sources]
    known = {name for name in ids if name in subject.before}
    before, true = placed(subject.before), placed(subject.truth)
    if len(known) < len(ids):  # those without a pose stand in rows beside the others
        wide = max(float(str(cell["cell"])) * int(str(cell["columns"])) for cell in cells) + 1.0
        across = ceil(sqrt(len(ids)))
        right = max((pose.translation[0] for pose in before.values()), default=0.0)
        for k, name in enumerate(name for name in ids if name not in known):
            place = SE2(float(right) + wide * (1 + k % across), wide * (k // across), 0.0)
            before[name] = Pose.from_planar(place)
    after = None if subject.after is None else placed(subject.after)
    reference = before if after is None else after
    shared = [name for name in ids if name in true and name in reference]
    truth: list[list[float] | None] | None = None
    if known and len(shared) >= 2:
        motion = level_motion(positions(shared, true), positions(shared, reference))
        truth = [_row(motion @ true[name]) if name in true else None for name in ids]
    return {
        "known": bool(known),
        "before": [_row(before[name]) for name in ids],
        "after": None if after is None else [_row(after[name]) for name in ids],
        "truth": truth,
    }


def _row(pose: Pose) -> list[float]:
    planar: SE2 = pose.planar
    values: NDArray[np.float64] = np.array(
        [planar.x, planar.y, planar.yaw, float(pose.translation[2])]
    )
    return [round(float(value), 5) for value in values]


def _pair_figures(closure: LoopClosure) -> list[tuple[str, str]]:
    found = closure.registration
    figures = [
        ("verdict", "loop closure" if closure.accepted else "no loop closure"),
        ("score", score_in_words(found.score)),
        ("inliers", f"{found.num_inliers:,}"),
    ]
    if (motion := found.T_database_query) is not None:
        figures += [
            ("offset", f"{motion.x:+.2f} m, {motion.y:+.2f} m"),
            ("turn", f"{degrees(motion.yaw):+.1f}°"),
        ]
    return figures


def dataset_figures(
    report: ClosureReport, num_submaps: int, evaluation: Evaluation | None = None
) -> list[tuple[str, str]]:
    """Say in numbers what was found."""
    figures = [
        ("submaps", f"{num_submaps:,}"),
        ("pairs compared", f"{len(report.pairs):,}"),
        ("loop closures", f"{len(report.accepted):,}"),
    ]
    if evaluation is not None:
        method = evaluation.methods[0]
        ranked = method.rules[0].ranked
        if ranked is not None:
            figures.append(("average precision", f"{ranked.average_precision.value:.3f}"))
            figures.append(
                ("recall at full precision", f"{ranked.recall_at_full_precision.value:.3f}")
            )
        figures.append(
            (
                "accepted with a wrong motion",
                f"{method.accepted.wrong_motion + method.accepted.no_overlap:,}",
            )
        )
    return figures
