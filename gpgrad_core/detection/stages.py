"""The stages of the pipeline as data: what each computes, from which results and parameters.

That is a stage's key in the memo and the store, its time in the viewer, and its part of the
progress.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, Literal, TypeAlias, TypeVar

from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.features import FeatureParams, detect_features, select_trusted
from gpgrad_core.mapping.gradient_map import MapParams, fit_terrain, sample_map
from gpgrad_core.matching import MatchParams, match_features
from gpgrad_core.registration import (
    RegistrationParams,
    prepare,
    register_prepared,
    search_candidates,
)
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Submap, SubmapSource

R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)

Phase: TypeAlias = Literal["map", "features", "matching", "registration"]


@dataclass(frozen=True)
class PipelineParams:
    """All parameters of the pipeline, one group per stage.

    Attributes:
        map: How a submap becomes a gradient map.
        features: Which keypoints are used.
        matching: Which nearest neighbours count as associations.
        registration: How a pair of maps is registered.
        closure: When a registration counts as a loop closure.
    """

    map: MapParams = field(default_factory=MapParams)
    features: FeatureParams = field(default_factory=FeatureParams)
    matching: MatchParams = field(default_factory=MatchParams)
    registration: RegistrationParams = field(default_factory=RegistrationParams)
    closure: ClosureParams = field(default_factory=ClosureParams)


@dataclass(frozen=True)
class Stage(Generic[R_co]):
    """A pure function, and where its arguments come from."""

    # takes the submaps if it wants them, then the results of its inputs, and then its parameters
    function: Callable[..., R_co]
    params_of: Callable[[PipelineParams], tuple[object, ...]]  # picks its parameters out of all
    inputs: tuple["Stage[object]", ...]  # a pair takes both results of a stage of single submaps
    phase: Phase  # what its time counts as
    wants_submap: bool = False  # whether its arguments begin with the submap itself
    of_pair: bool = False  # whether it belongs to a pair of submaps, and not to one
    reports: bool = False  # whether it takes a progress hook


FIT = Stage(
    fit_terrain, lambda params: (params.map.terrain,), (), "map", wants_submap=True, reports=True
)
SAMPLE = Stage(
    sample_map,
    lambda params: (params.map.resolution, params.map.scale),
    (FIT,),
    "map",
    wants_submap=True,
)
DETECT = Stage(detect_features, lambda params: (params.features.detector,), (SAMPLE,), "features")
SELECT = Stage(select_trusted, lambda params: (params.features,), (DETECT,), "features")
PREPARE = Stage(prepare, lambda params: (params.features.max_std_ratio,), (SAMPLE,), "registration")
MATCH = Stage(
    match_features, lambda params: (params.matching,), (SELECT,), "matching", of_pair=True
)
SEARCH = Stage(
    search_candidates,
    lambda params: (params.registration.searched,),
    (PREPARE,),
    "registration",
    of_pair=True,
)
REGISTER = Stage(
    register_prepared,
    lambda params: (params.registration,),
    (PREPARE, MATCH, SEARCH),
    "registration",
    of_pair=True,
    reports=True,
)
STAGES: tuple[Stage[object], ...] = (
    *(FIT, SAMPLE, DETECT, SELECT, PREPARE),
    *(MATCH, SEARCH, REGISTER),
)


@dataclass(frozen=True, eq=False)
class Stages:
    """Runs stages with some parameters; the memo keeps what they give."""

    params: PipelineParams  # parameters of all stages, with numbers for those that the stages use
    memo: Memo  # keeps the results

    def run(self, stage: Stage[R], *submaps: Submap, progress: Progress = silent) -> R:
        """Run a stage for a submap or a pair (query, database), and the stages before it."""
        return self.apply(stage, *self._inputs(stage, submaps, progress), progress=progress)

    def apply(self, stage: Stage[R], *inputs: object, progress: Progress = silent) -> R:
        """Run a stage on given inputs, unless the memo has the result."""
        arguments = *inputs, *stage.params_of(self.params)
        if stage.reports:
            return self.memo(stage.function, *arguments, progress=progress)
        return self.memo(stage.function, *arguments)

    def holds(self, stage: Stage[object], *submaps: Submap) -> bool:
        if not all(
            self.holds(source, *some)
            for source in stage.inputs
            for some in _submaps_of(source, submaps)
        ):
            return False
        arguments = *self._inputs(stage, submaps), *stage.params_of(self.params)
        return self.memo.holds(stage.function, *arguments)

    def keep(self, result: R, stage: Stage[R], *submaps: Submap) -> R:
        arguments = *self._inputs(stage, submaps), *stage.params_of(self.params)
        return self.memo.keep(result, stage.function, *arguments)

    def _inputs(
        self, stage: Stage[object], submaps: tuple[Submap, ...], progress: Progress = silent
    ) -> list[object]:
        inputs: list[object] = [*submaps] if stage.wants_submap else []
        heard = silent if stage.of_pair else progress  # that of a pair is for its own stage
        for source in stage.inputs:
            for some in _submaps_of(source, submaps):
                inputs.append(self.run(source, *some, progress=heard))  # noqa: PERF401
        return inputs


def key_of_stage(
    stage: Stage[object], params: PipelineParams, *sources: SubmapSource
) -> tuple[object, ...]:
    """List what makes a stage's result of a submap or pair (query, database) for `key_of`."""
    inputs = (
        key_of_stage(source, params, *some)
        for source in stage.inputs
        for some in _submaps_of(source, sources)
    )
    own = sources if stage.wants_submap else ()
    return (stage.function.__name__, *own, *inputs, *stage.params_of(params))


S = TypeVar("S", bound=SubmapSource)


def _submaps_of(source: Stage[object], submaps: tuple[S, ...]) -> list[tuple[S, ...]]:
    """List for which submaps an input is run: the pair as a whole, or each submap by itself."""
    return [submaps] if source.of_pair else [(submap,) for submap in submaps]
