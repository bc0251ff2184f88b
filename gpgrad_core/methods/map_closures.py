"""MapClosures (Gupta 2024): ORB on images of the point density, and RANSAC in the plane."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.libraries import load_library
from gpgrad_core.methods.cloud_detector import CloudDetector
from gpgrad_core.methods.outcome import outcome, seen_from_above
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Registration, Submap

PACKAGE = "map_closures"
RESOLUTION = 1 / 6
"""Side of a cell [length-scales]: 5 cm with the default length-scale. The package's own default,
for cities, is 50 cm. Cells of 7.5 cm raise its AP on two of three datasets, to 0.32, but miss an
easy closure."""
DATABASE_ID, QUERY_ID = 0, 100
"""Numbers of the two maps; the package does not compare maps with numbers close to each other."""


@dataclass(frozen=True, eq=False)
class MapClosuresCloud:
    """The points of a submap in the form that the package needs.

    Attributes:
        points: Points (n, 3) [m].
    """

    points: Float[Array, "n 3"]


def map_closures_detector(params: PipelineParams, memo: Memo) -> CloudDetector[MapClosuresCloud]:
    """Make MapClosures; the package must be installed."""
    return CloudDetector(_cloud, _register, params, memo)


def _cloud(submap: Submap, params: PipelineParams) -> MapClosuresCloud:  # noqa: ARG001 - as all rivals
    return MapClosuresCloud(np.array(submap.points))


def _register(
    query: MapClosuresCloud, database: MapClosuresCloud, params: PipelineParams
) -> Registration:
    """Search for the query in a database of one map; the score is the number of inliers."""
    module: Any = load_library(f"{PACKAGE}.map_closures", "gpgrad[peers]")
    config = module.MapClosuresConfig(
        density_map_resolution=RESOLUTION * params.map.terrain.length_scale
    )
    finder = module.MapClosures(config)
    finder.get_closures(DATABASE_ID, database.points)
    candidates = finder.get_top_k_closures(QUERY_ID, query.points, 1)
    if not candidates:
        return outcome(None, np.zeros(0, bool))
    # The package's pose maps the older map, the database, into the query.
    pose: Any = candidates[0].pose
    T_database_query = np.linalg.inv(np.asarray(pose)).astype(np.float64)
    middle = query.points.mean(axis=0, keepdims=True)
    inliers = np.ones(candidates[0].number_of_inliers, bool)
    return outcome(seen_from_above(T_database_query, middle), inliers)
