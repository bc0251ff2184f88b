"""The parameters of all stages together."""

from dataclasses import dataclass, field

from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.features import FeatureParams
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.matching import MatchParams
from gpgrad_core.registration import RegistrationParams


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
