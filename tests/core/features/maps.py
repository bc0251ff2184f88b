"""Maps as a perfect sensor would make them, of ground seen from anywhere."""

from functools import cache

import numpy as np

from gpgrad_core.features import DetectorParams, FeatureParams, extract_features
from gpgrad_core.matching import match_features
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, Grid
from tests.support.ground import Ground, seen_from


@cache
def ground_turned_by(
    degrees: float, resolution: float = 0.05, seed: int = 2
) -> tuple[GradientMap, SE2]:
    """Make a map of the same ground, turned and shifted; and ``T_world_map``."""
    T_world_map = SE2(0.8, -0.5, np.radians(degrees)) if degrees else SE2()
    side = round(10 / resolution) + 1
    grid = Grid((-5.0, -5.0), resolution, (side, side))
    return seen_from(Ground.random(seed, shortest=0.6), T_world_map, grid), T_world_map


def right_matches(detector: str, degrees: float, seeds: list[int]) -> list[bool]:
    """Say of every mutual match between a ground and the same, turned, whether it is right."""
    params, right = FeatureParams(detector=DetectorParams(detector)), []
    for seed in seeds:
        query, T_world_query = ground_turned_by(degrees, 0.03, seed)
        database, _ = ground_turned_by(0, 0.03, seed)
        features = [extract_features(made, params) for made in (query, database)]
        matches = match_features(*features)
        there = T_world_query.apply(matches.query_xy)
        known = (np.abs(there) < 4.5).all(axis=1)
        right += list(np.hypot(*(there - matches.database_xy).T)[known] <= 0.15)
    return right
