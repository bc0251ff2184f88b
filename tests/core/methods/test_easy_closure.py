"""Every rival recognises rocks that it has seen before: none is a straw man."""

import numpy as np
import pytest

from gpgrad_core.arrays import Array
from gpgrad_core.detection import PipelineParams
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods import METHODS, find_method
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Submap


def rocks(seed: int, xy: Array) -> Array:
    """Heights [m] of gently rolling ground with half-buried rocks of 10 to 60 cm."""
    rng = np.random.default_rng(seed)
    z = 0.1 * np.sin(0.7 * xy[:, 0] + rng.uniform(0, 6)) * np.cos(0.6 * xy[:, 1])
    for _ in range(120):
        centre, radius = rng.uniform(-6, 6, 2), rng.uniform(0.1, 0.6)
        above = radius**2 - np.sum((xy - centre) ** 2, axis=1)
        z = np.maximum(z, np.sqrt(np.maximum(above, 0)) * rng.uniform(0.4, 0.9))
    return z


def look(T_world_submap: SE2, name: str, *, seed: int, ground: int = 1) -> Submap:
    """Sample a disc of 3 m around a pose, then thin it to one point a voxel of 5 cm.

    As in clouds of real sensors, steep sides thus hold more points than what lies flat.
    """
    rng = np.random.default_rng(seed)
    local = rng.uniform(-3, 3, (60_000, 2))
    local = local[np.hypot(*local.T) < 3]
    heights = rocks(ground, T_world_submap.apply(local))
    points = np.column_stack([local, heights])
    _, first = np.unique(np.floor(points / 0.05).astype(int), axis=0, return_index=True)
    kept = points[np.sort(first)]
    world = T_world_submap.apply(kept[:, :2])
    stains = [rocks(ground + 10 * k, world) for k in (1, 2, 3)]  # no relation to the shape
    colors = np.clip(0.3 + np.column_stack(stains), 0, 1)
    return Submap.from_points(kept, name, colors=colors)


PARAMS = PipelineParams(map=MapParams(length_scale=0.3, noise_std=0.05, resolution=0.05))
T_WORLD_DATABASE = SE2(0.5, -0.3, 0.4)
T_WORLD_QUERY = SE2(1.1, 0.6, -2.1)


@pytest.fixture(scope="module")
def seen() -> tuple[Submap, Submap, Submap]:
    """A query, the database's submap of the same place, and one of another."""
    return (
        look(T_WORLD_QUERY, "query", seed=2),
        look(T_WORLD_DATABASE, "database", seed=1),
        look(SE2(), "stranger", seed=3, ground=4),
    )


@pytest.mark.parametrize(
    "name",
    [
        "scan-context",  # the only one whose own tests find no motion
        *(
            pytest.param(name, marks=pytest.mark.nightly)
            for name in sorted(METHODS.keys() - {"scan-context", "chance", "appearance"})
        ),
    ],
)
def test_a_rocky_place_seen_again_is_found_and_ranks_above_another(
    name: str, seen: tuple[Submap, Submap, Submap]
) -> None:
    if not METHODS[name].installed:
        pytest.skip(f"{METHODS[name].package} is not installed")
    method = find_method(name)
    detector = method.detector(method.adapt(PARAMS), Memo())
    query, database, stranger = seen
    again, other = detector(query, database), detector(stranger, database)
    found = again.T_database_query
    assert found is not None
    error = (T_WORLD_DATABASE.inverse() @ T_WORLD_QUERY).inverse() @ found
    assert np.hypot(error.x, error.y) < 0.2
    assert abs(np.degrees(error.yaw)) < 3
    assert again.score > 1.5 * other.score
