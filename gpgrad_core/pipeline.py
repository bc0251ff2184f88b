"""The order of the stages; the only file that knows it."""

from dataclasses import dataclass, field

from gpgrad_core.features import FeatureParams
from gpgrad_core.gradient_map import MapParams
from gpgrad_core.loop_closure import ClosureParams
from gpgrad_core.matching import MatchParams
from gpgrad_core.registration import RegistrationParams
from gpgrad_core.types import Features, GradientMap, LoopClosure, Matches, Registration


@dataclass(frozen=True)
class PipelineParams:
    """All parameters, a group a stage."""

    map: MapParams = field(default_factory=MapParams)
    features: FeatureParams = field(default_factory=FeatureParams)
    matching: MatchParams = field(default_factory=MatchParams)
    registration: RegistrationParams = field(default_factory=RegistrationParams)
    closure: ClosureParams = field(default_factory=ClosureParams)


@dataclass(frozen=True, eq=False)
class PairResult:
    """Everything between two submaps and the verdict on them, for whoever wants to look."""

    query_map: GradientMap
    database_map: GradientMap
    query_features: Features
    database_features: Features
    matches: Matches
    registration: Registration
    closure: LoopClosure


# The verbs below are written next; their signatures are settled.
#
# def infer_map(submap, params: PipelineParams, memo: Memo, progress=silent) -> GradientMap
# def register_pair(query: Submap, database: Submap, params: PipelineParams, memo: Memo,
#                   progress=silent) -> PairResult
# def detect_loop_closures(dataset: Dataset, params: PipelineParams = …, *, memo: Memo | None = None,
#                          progress=silent) -> list[LoopClosure]
