"""What the page of a dataset shows: its submaps and verdicts, poses, figures and notes."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeAlias

from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import Evaluation, EvaluationParams, evaluate
from gpgrad_core.io.records.closures import ClosureReport, restore_closures
from gpgrad_core.run import Progress, silent
from gpgrad_core.se2 import Pose
from gpgrad_core.slam import MapErrors, Solution, build_pose_graph, optimise_pose_graph
from gpgrad_core.types import Dataset, LoopClosure, Submap

Loader: TypeAlias = Callable[[], Submap]
MOST_JUDGED = 400
"""Submaps; of more, too many pairs would be compared with the truth for the sake of a curve."""


@dataclass(frozen=True, eq=False)
class PageData:
    """What a page shows."""

    name: str  # of the dataset
    loaders: Mapping[str, Loader]  # of the submaps, by their ids, in their order
    report: ClosureReport
    params: PipelineParams
    # poses ``T_world_submap`` by id before the correction, as far as they are known
    before: Mapping[str, Pose] = field(default_factory=dict[str, Pose])
    after: Mapping[str, Pose] | None = None  # None if nothing was corrected
    truth: Mapping[str, Pose] = field(default_factory=dict[str, Pose])
    starts: Collection[str] = ()  # first submaps of further traverses
    # closures (query id, database id) that the pose graph refused as wrong
    dropped: Collection[tuple[str, str]] = ()
    evaluation: Evaluation | None = None  # of the report's method, by the true poses
    figures: Sequence[tuple[str, str]] = ()  # names and values at the top of the page
    commands: Sequence[str] = ()  # command lines that make the same
    notes: Sequence[str] = ()  # what was left out, one line each


def corrected(
    dataset: Dataset, closures: Sequence[LoopClosure], trusted: Collection[tuple[str, str]] = ()
) -> tuple[dict[str, Pose], dict[str, Pose] | None, tuple[tuple[str, str], ...], str]:
    """Correct odometry by closures: poses before, after, refused closures, and why none, if so."""
    odometry = dataset.odometry
    if len(odometry) < len(dataset.submaps):
        why = "The dataset has no odometry, so there is nothing to correct."
        return dataset.true_poses, None, (), why
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
    loaders: Mapping[str, Loader],
    report: ClosureReport,
    progress: Progress = silent,
) -> Evaluation | None:
    """Judge verdicts by the true poses; None without these, or beyond `MOST_JUDGED` submaps."""
    if len(dataset.true_poses) < 2 or not report.pairs or len(loaders) > MOST_JUDGED:
        return None
    loaded = replace(dataset, submaps=tuple(load() for load in loaders.values()))
    bare = EvaluationParams(num_resamples=0)
    return evaluate(loaded, {report.method: report}, bare, progress=progress)


def subject_of(
    dataset: Dataset,
    report: ClosureReport,
    params: PipelineParams,
    *,
    evaluation: Evaluation | None = None,
    commands: Sequence[str] = (),
) -> PageData:
    """Gather what the page of a loaded dataset shows; the closures correct its odometry."""
    loaders = {submap.id: submap.load for submap in dataset.submaps}
    if evaluation is None:
        evaluation = judge(dataset, loaders, report)
    closures = restore_closures(report)
    before, after, dropped, note = corrected(dataset, closures, report.confirmed)
    return PageData(
        dataset.name,
        loaders,
        report,
        params,
        before=before,
        after=after,
        truth=dataset.true_poses,
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
) -> PageData:
    """Gather what the page of a solved map shows."""
    joined, result = solution.joined, solution.result
    dataset = joined.outline.dataset

    def load(number: int) -> Submap:
        return joined.outline.load(number)[0]

    loaders = {submap.id: partial(load, k) for k, submap in enumerate(dataset.submaps)}
    is_alone = len(joined.traverses) == 1  # the truth of another may have another frame
    evaluation = judge(dataset, loaders, report, progress) if is_alone else None
    figures = dataset_figures(report, len(loaders), evaluation)
    for session, (before, after) in errors.trajectories.items():
        name = "trajectory error" if is_alone else f"trajectory error of {session}"
        figures.append((name, f"{before.absolute:.3f} m to {after.absolute:.3f} m"))
    return PageData(
        dataset.name,
        loaders,
        report,
        params,
        before=solution.before,
        after=result.poses,
        truth=dataset.true_poses,
        starts=joined.starts,
        dropped=[fit.edge.pair for fit in result.refused],
        evaluation=evaluation,
        figures=figures,
        commands=commands,
        notes=dataset.notes,
    )


def dataset_figures(
    report: ClosureReport, num_submaps: int, evaluation: Evaluation | None = None
) -> list[tuple[str, str]]:
    """Summarise the result in numbers."""
    figures = [
        ("submaps", f"{num_submaps:,}"),
        ("pairs compared", f"{len(report.pairs):,}"),
        ("loop closures", f"{len(report.accepted):,}"),
    ]
    if evaluation is not None:
        method = evaluation.methods[0]
        wrong = method.accepted.wrong_motion + method.accepted.no_overlap
        if (ranked := method.rules[0].ranked) is not None:
            full = ranked.recall_at_full_precision.value
            figures.append(("average precision", f"{ranked.average_precision.value:.3f}"))
            figures.append(("recall at full precision", f"{full:.3f}"))
        figures.append(("accepted with a wrong motion", f"{wrong:,}"))
    return figures
