"""The methods that the viewer runs: the gradient maps' own, and the paper's."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, get_args

from gpgrad_core.detection import PairResult, PipelineParams, resolve_parameters
from gpgrad_core.detection import register_pair as register_gradient_pair
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.methods.paper import (
    PaperDetector,
    limits_in_loop,
    paper_params,
    register_paper_pair,
    tune,
    with_terrain,
)
from gpgrad_core.params.fields import get_path
from gpgrad_core.run.helper import Helper
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.types import LoopDetector, Submap

MethodName: TypeAlias = Literal["gradient", "paper"]
Register: TypeAlias = Callable[
    [Submap, Submap, PipelineParams, Memo, Progress, Helper | None], PairResult
]
"""Runs all stages of a method for a query and a database submap."""


@dataclass(frozen=True)
class ViewedMethod:
    """A method as the viewer runs it.

    Attributes:
        summary: What it does, for people.
        adapt: Turns the parameters of a dataset into those with which the method begins.
        fits_each: Whether it fits what is automatic to every submap, and not to the dataset.
        settle: Puts numbers in for what is automatic, given the dataset's submaps and the query.
        of_submap: Gives the parameters with which it makes the map of one submap.
        register: Registers a pair.
        detector: Makes its detector for many pairs; None is the pipeline's own.
        registered_by: Resets the thresholds that registrations do not depend on.
        threshold: Path of the threshold on its score.
        score: What its score is called.
        unused: Paths of the parameters that do nothing in it, or little that a person would look
            for.
    """

    summary: str
    adapt: Callable[[PipelineParams], PipelineParams]
    fits_each: bool
    settle: Callable[[Sequence[Submap], Submap, PipelineParams, Memo, Progress], PipelineParams]
    of_submap: Callable[[Submap, PipelineParams, Memo, Progress], PipelineParams]
    register: Register
    detector: Callable[[PipelineParams, Memo], LoopDetector] | None
    registered_by: Callable[[PipelineParams], PipelineParams]
    threshold: str
    score: str
    unused: frozenset[str]

    def lowest(self, params: PipelineParams) -> float:
        """Give the threshold on its score."""
        value = get_path(params, self.threshold)
        assert isinstance(value, int | float)
        return float(value)


def register_pair(
    query: Submap,
    database: Submap,
    params: PipelineParams,
    memo: Memo,
    progress: Progress = silent,
    helper: Helper | None = None,
    method: MethodName = "gradient",
) -> PairResult:
    """Run all stages of a method for one pair.

    Args:
        query: The submap to be placed.
        database: The submap on which it is placed.
        params: Those that `ViewState.given` has.
        memo: Keeps the results of the stages.
        progress: Called with the fraction done; may raise Cancelled.
        helper: Takes over one of the submaps, if the method can use it.
        method: Name of the method.

    Raises:
        InputError: If a submap's map cannot be made.
    """
    return METHODS[method].register(query, database, params, memo, progress, helper)


def map_params(
    submap: Submap,
    params: PipelineParams,
    memo: Memo,
    progress: Progress = silent,
    method: MethodName = "gradient",
) -> PipelineParams:
    """Give the parameters with which a method makes the map of one submap; arguments as above."""
    return METHODS[method].of_submap(submap, params, memo, progress)


def _settle_dataset(
    submaps: Sequence[Submap],
    query: Submap,
    params: PipelineParams,
    memo: Memo,
    progress: Progress,
) -> PipelineParams:
    del query  # all submaps share the numbers
    return resolve_parameters(submaps, params, memo, progress)


def _settle_query(
    submaps: Sequence[Submap],
    query: Submap,
    params: PipelineParams,
    memo: Memo,
    progress: Progress,
) -> PipelineParams:
    del submaps  # each has its own numbers; the query's are shown
    registration = replace(params.registration, inlier_radius=params.registration.radius(None))
    tuned = _of_paper_submap(query, params, memo, progress)
    return replace(tuned, registration=registration)


def _as_given(params: PipelineParams) -> PipelineParams:
    return params


def _of_any_submap(
    submap: Submap, params: PipelineParams, memo: Memo, progress: Progress
) -> PipelineParams:
    del submap, memo, progress
    return params


def _of_paper_submap(
    submap: Submap, params: PipelineParams, memo: Memo, progress: Progress
) -> PipelineParams:
    return with_terrain(params, tune(submap, params.map, memo, progress))


def _register_paper(
    query: Submap,
    database: Submap,
    params: PipelineParams,
    memo: Memo,
    progress: Progress,
    helper: Helper | None,
) -> PairResult:
    del helper  # two fits of a submap take less time than it would take to send them there
    return register_paper_pair(query, database, params, memo, progress)


def _without_closure(params: PipelineParams) -> PipelineParams:
    return replace(params, closure=ClosureParams())


def _with_limits_in_loop(params: PipelineParams) -> PipelineParams:
    return replace(params, closure=limits_in_loop(params.closure) or ClosureParams())


METHODS: dict[MethodName, ViewedMethod] = {
    "gradient": ViewedMethod(
        summary="Keypoints on gradient maps, and a score of all ground that both submaps show.",
        adapt=_as_given,
        fits_each=False,
        settle=_settle_dataset,
        of_submap=_of_any_submap,
        register=register_gradient_pair,
        detector=None,
        registered_by=_without_closure,
        threshold="closure.min_score",
        score="score",
        unused=frozenset({"closure.max_dissimilarity"}),
    ),
    "paper": ViewedMethod(
        summary="Le Gentil et al. 2020 as printed: SURF, Algorithm 1, and the verdict by n and h. "
        "What is automatic is fitted to each submap; the sliders show the query's numbers.",
        adapt=paper_params,
        fits_each=True,
        settle=_settle_query,
        of_submap=_of_paper_submap,
        register=_register_paper,
        detector=PaperDetector,
        registered_by=_with_limits_in_loop,
        threshold="closure.min_inliers",
        score="inliers n",
        unused=frozenset(
            {
                "closure.min_score",
                "closure.max_std",
                "map.scale",
                "registration.hypotheses",
                "registration.searched",
            }
        ),
    ),
}
"""Every method by its name."""
METHOD_NAMES: tuple[MethodName, ...] = get_args(MethodName)
