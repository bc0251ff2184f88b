"""Every rival recognises rocks that it has seen before: none is a straw man."""

import numpy as np
import pytest

from gpgrad_core.detection import PipelineParams
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods import METHODS, find_method
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Submap
from tests.core.methods.rocks import look

PARAMS = PipelineParams(map=MapParams(length_scale=0.3, noise_std=0.05, resolution=0.05))
T_WORLD_DATABASE = SE2(0.5, -0.3, 0.4)
T_WORLD_QUERY = SE2(1.1, 0.6, -2.1)
ELSEWHERE = {"chance", "appearance"}
"""What guesses, and what looks at images."""


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
            for name in sorted(METHODS.keys() - ELSEWHERE - {"scan-context"})
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
