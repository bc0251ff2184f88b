"""Ground that repeats: what is accepted is right, and places that only look alike stay apart.

Everything is at its default, so that all parameters are fitted to each set, and odometry is not
used. It simulates 20 sets, as

    gpgrad simulate DIR --num-submaps 30 --ground spurs --seed 1 --row-variety 0.1

and half an hour on two cores passes.
"""

from dataclasses import dataclass, replace

import numpy as np

from gpgrad_core.evaluation import EvaluationParams, evaluate, measure_pairs
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.simulate import simulate_dataset
from gpgrad_core.simulation.terrain import params_on
from tests.long.quality.test_hard_ground import detect

NUM_SUBMAPS = 30
ALIKE = {"row_variety": 0.0}
"""With so little relief besides, that only the ends of what is seen tell one row from another."""
SPINNING = {"sensor": "lidar", "max_range": 8.0, "extent": 80.0, "noise_constant": 0.02}
SETS: dict[str, SimulationParams] = {
    f"{ground}, {kind}": params_on(ground, num_submaps=NUM_SUBMAPS, seed=seed, **changes)
    for ground, kind, seed, changes in (
        ("spurs", "varied", 1, {"row_variety": 0.1}),
        ("dunes", "varied", 2, {"row_variety": 0.1}),
        ("furrows", "varied", 3, {}),
        ("ripples", "varied", 4, {}),
        ("spurs", "alike", 5, {**ALIKE, "relief": 0.02}),
        ("dunes", "alike", 6, {**ALIKE, "relief": 0.01}),
        ("furrows", "alike", 7, {**ALIKE, "relief": 0.005}),
        ("ripples", "alike", 8, {**ALIKE, "relief": 0.005}),
        ("spurs", "wide and forked", 9, {"row_spacing": 12.0, "row_variety": 0.3}),
        ("dunes", "wide", 10,
         {"row_spacing": 9.0, "row_height": 0.8, "row_variety": 0.05, "relief": 0.03}),
        ("furrows", "wide", 11, {"row_spacing": 1.5, "row_variety": 0.05, "relief": 0.03}),
        ("ripples", "wide and forked", 12,
         {"row_spacing": 0.9, "row_height": 0.1, "row_variety": 0.4}),
        ("spurs", "LiDAR", 13, SPINNING),
        ("dunes", "LiDAR", 14, SPINNING),
        ("furrows", "LiDAR of few rings", 15, {**SPINNING, "lidar_rings": 12}),
        ("spurs", "errors of patches", 16, {"noise_common": 0.7}),
        ("dunes", "errors of patches", 17, {"noise_common": 0.7}),
        ("spurs", "constant noise", 18, {"noise_constant": 0.03, "noise_quadratic": 0.0}),
        ("dunes", "narrow", 19, {"row_spacing": 4.0, "row_height": 0.4, "row_variety": 0.05}),
        ("spurs", "1,000 points", 20, {"max_points": 1000}),
    )
}  # fmt: skip
LEAST_ACCEPTED, LEAST_APART = 200, 5_000
MOST_WRONG, MOST_ABOVE_3 = 1 / 200, 1 / 1000
"""Asked: shares of what is accepted, and of the pairs without common ground."""


@dataclass(frozen=True)
class Outcome:
    """What detection made of one set or of several."""

    true: int = 0  # pairs that share more than a fifth of the surface, neighbours left out
    right: int = 0  # accepted, with the right motion
    wrong: int = 0  # accepted, with a wrong motion on common ground
    no_ground: int = 0  # accepted, without common ground
    apart: int = 0  # pairs without common ground
    above_3: int = 0  # of these, with a score that promises one in a thousand

    def __add__(self, other: "Outcome") -> "Outcome":
        mine, others = vars(self), vars(other)
        return Outcome(**{name: mine[name] + others[name] for name in mine})

    @property
    def accepted(self) -> int:
        return self.right + self.wrong + self.no_ground

    def __str__(self) -> str:
        return (
            f"{self.true:4} true; accepted {self.right:4} right, {self.wrong:3} with a wrong "
            f"motion, {self.no_ground:3} without common ground; {self.above_3:3} of "
            f"{self.apart:5} apart above 3"
        )


def try_on(params: SimulationParams) -> Outcome:
    dataset = simulate_dataset(params)
    # Thinning takes nothing from the truth.
    whole = replace(params, max_points=max(params.max_points, 30_000))
    truth = measure_pairs(dataset if whole == params else simulate_dataset(whole))
    evaluation = evaluate(
        dataset, {"gradient": detect(dataset)}, EvaluationParams(num_resamples=0), pairs=truth
    )
    method, pairs = evaluation.methods[0], evaluation.pairs
    accepted = method.accepted
    apart = pairs.surface_overlap == 0
    return Outcome(
        int(np.sum((pairs.surface_overlap > 0.2) & (pairs.steps > 1))),
        accepted.right,
        accepted.wrong_motion,
        accepted.no_overlap,
        int(np.sum(apart)),
        int(np.sum(method.ranking.score[apart] > 3)),
    )


def test_what_is_accepted_on_ground_that_repeats_is_right() -> None:
    total = Outcome()
    for name, params in SETS.items():
        outcome = try_on(params)
        print(f"{name:26} {outcome}", flush=True)
        total += outcome
    print(f"{'together':26} {total}")
    assert total.accepted >= LEAST_ACCEPTED
    assert total.apart >= LEAST_APART
    assert total.wrong + total.no_ground <= MOST_WRONG * total.accepted
    assert total.above_3 <= MOST_ABOVE_3 * total.apart
