"""What a change of view costs the server: two maps of 300 x 300, process time, medians.

Run it on an idle machine.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from app.viewer.features.pair.scene import PairScene
from app.viewer.session import state as states
from app.viewer.session.state import ViewState
from gpgrad_core.detection import PairResult, PipelineParams
from tests.support.synthetic import make_dataset, make_map, make_result

RESOLUTION = 5.0 / 299
TARGET_MS, TARGET_BYTES = 15.0, 1_400_000
ROUNDS = 25

STATE = states.open_dataset(make_dataset(), PipelineParams())


def fine_result() -> PairResult:
    """The synthetic pair with maps of about 300 x 300, and with the demo's 259 inliers."""
    coarse = make_result(STATE, num_inliers=259, num_outliers=27)
    maps = make_map(STATE.query, RESOLUTION), make_map(STATE.database, RESOLUTION)
    assert all(295 <= side <= 305 for made in maps for side in made.grid.shape)
    return replace(coarse, query_map=maps[0], database_map=maps[1])


def with_ratio(state: ViewState, k: int) -> ViewState:
    features = replace(state.params.features, max_std_ratio=0.25 + 0.002 * k)
    return replace(state, params=replace(state.params, features=features))


def with_options(state: ViewState, **options: Any) -> ViewState:
    return replace(state, options=replace(state.options, **options))


def test_mask_inlier_and_colour_changes_cost_little(server: viser.ViserServer) -> None:
    scene, result = PairScene(server), fine_result()
    scene.show(STATE, result)
    flips = np.arange(len(result.matches))

    def inliers(k: int) -> PairResult:
        agree = result.registration.inliers & (flips % 25 != k)
        return replace(result, registration=replace(result.registration, inliers=agree))

    colours = ("viridis", "cividis", "magma", "turbo", "grey")
    changes: dict[str, Callable[[int], tuple[ViewState, PairResult]]] = {
        "mask": lambda k: (with_ratio(STATE, k), result),
        "inliers": lambda k: (STATE, inliers(k)),
        "colours": lambda k: (with_options(STATE, color_map=colours[k % 5]), result),
        "match": lambda k: (replace(STATE, match=k + 1), result),
        "swipe": lambda k: (
            with_options(STATE, layout="registered", compare="swipe", swipe=0.4 + 0.01 * k),
            result,
        ),
    }
    costs: dict[str, float] = {}
    for name, change in changes.items():
        times: list[float] = []
        for k in range(ROUNDS):
            state, changed = change(k)
            start = time.thread_time()
            scene.show(state, changed)
            times.append(1000 * (time.thread_time() - start))
        costs[name] = statistics.median(times)
    print("\n" + " · ".join(f"{name} {cost:.1f} ms" for name, cost in costs.items()))
    surfaces = [
        server.scene._handle_from_node_name[f"/pair/{role}/surface"]
        for role in ("query", "database")
    ]
    scene.show(with_options(STATE, untrusted="shown"), result)
    sizes = [handle.points.nbytes + handle.colors.nbytes for handle in surfaces]  # type: ignore[union-attr]
    print(f"surfaces: {sizes} bytes")
    assert max(sizes) <= TARGET_BYTES
    for name in ("mask", "inliers", "colours"):
        assert costs[name] <= TARGET_MS, name
