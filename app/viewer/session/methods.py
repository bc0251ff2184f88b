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
from gpgrad_core.params import get_path
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.helper import Helper
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import LoopDetector, Submap

MethodName: TypeAlias = Literal["gradient", "paper"]
Register: TypeAlias = Callable[
    [Submap, Submap, PipelineParams, Memo, Progress, Helper | None], PairResult
]
"""Runs all stages of a method for a query and a database submap."""


@dataclass(frozen=True)
class ViewedMethod:
    """A method as the viewer runs it."""

    summary: str  # what it does, for people
    fits_each: bool  # whether what is automatic is fitted to every submap, and not to the dataset
    adapt: Callable[[PipelineParams], PipelineParams]  # a dataset's parameters to its first ones
    register: Register
    detector: Callable[[PipelineParams, Memo], LoopDetector] | None  # None: the pipeline's own
    # resets the thresholds that registrations do not depend on
    registered_by: Callable[[PipelineParams], PipelineParams]
    threshold: str  # path of the threshold on its score
    score: str  # what people call it
    unused: frozenset[str]  # paths of parameters that do nothing in it, or little to look for

    def lowest(self, params: PipelineParams) -> float:
        value = get_path(params, self.threshold)
        assert isinstance(value, int | float)
        return float(value)

    def of_submap(
        self, submap: Submap, params: PipelineParams, memo: Memo, progress: Progress = silent
    ) -> PipelineParams:
        if not self.fits_each:
            return params
        return with_terrain(params, tune(submap, params.map, memo, progress))

    def resolve(
        self,
        submaps: Sequence[Submap],
        query: Submap,
        params: PipelineParams,
        memo: Memo,
        progress: Progress = silent,
    ) -> PipelineParams:
        """Replace what is automatic by numbers: those that all submaps share, or the query's."""
        if not self.fits_each:
            return resolve_parameters(submaps, params, memo, progress)
        registration = replace(params.registration, inlier_radius=params.registration.radius(None))
        return replace(self.of_submap(query, params, memo, progress), registration=registration)


def register_pair(
    query: Submap,
    database: Submap,
    params: PipelineParams,
    memo: Memo,
    progress: Progress = silent,
    helper: Helper | None = None,
    method: MethodName = "gradient",
) -> PairResult:
    """Run all stages of a method for one pair, with the parameters of `ViewState.given`."""
    return METHODS[method].register(query, database, params, memo, progress, helper)


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


METHODS: dict[MethodName, ViewedMethod] = {
    "gradient": ViewedMethod(
        summary="Keypoints on gradient maps, and a score of all ground that both submaps show.",
        fits_each=False,
        adapt=lambda params: params,
        register=register_gradient_pair,
        detector=None,
        registered_by=lambda params: replace(params, closure=ClosureParams()),
        threshold="closure.min_score",
        score="score",
        unused=frozenset({"closure.max_dissimilarity"}),
    ),
    "paper": ViewedMethod(
        summary="Le Gentil et al. 2020 as printed: SURF, Algorithm 1, and the verdict by n and h. "
        "What is automatic is fitted to each submap; the sliders show the query's numbers.",
        fits_each=True,
        adapt=paper_params,
        register=_register_paper,
        detector=PaperDetector,
        registered_by=lambda params: replace(
            params, closure=limits_in_loop(params.closure) or ClosureParams()
        ),
        threshold="closure.min_inliers",
        score="inliers n",
        unused=frozenset(
            {
                "closure.min_score",
                "closure.max_std",
                "closure.others",
                "map.scale",
                "registration.hypotheses",
                "registration.searched",
            }
        ),
    ),
}
"""Every method by its name."""
METHOD_NAMES: tuple[MethodName, ...] = get_args(MethodName)
