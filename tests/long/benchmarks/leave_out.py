# ruff: noqa: T201 - a command that prints a table
"""The constants of what other pairs say, each chosen again with one set left out.

``GPGRAD_DATA=... python -m tests.long.benchmarks.leave_out``; an hour on two cores. It detects on
the real datasets, whole, thinned and noisy, and on the simulated ones whose ground repeats. Then
each constant of `detection.consistency` is tried at other values, and chosen for each set by
all the others. Right closures count 1, accepted ones that are wrong -10; neighbours do not count.
"""

import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from gpgrad_core.detection import consistency as others
from gpgrad_core.evaluation import TruePairs, measure_pairs
from gpgrad_core.evaluation.rules import MAX_OFFSET, MAX_TURN
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.simulation.simulate import simulate_dataset
from gpgrad_core.types import Dataset, Registration
from tests.long.quality.degraded import SETS, load_degraded
from tests.long.quality.test_hard_ground import KINDS, detect
from tests.long.quality.test_repeated_ground import SETS as REPEATED

Compared: TypeAlias = tuple[Mapping[others.Pair, Registration], Mapping[others.Pair, bool]]
"""The registrations of a set, and of those that are judged whether the motion is right."""
FACTORS = (0.7, 1.0, 1.4)
MISTAKE = 10
CONSTANTS = (
    "USUAL_MISFIT", "USUAL_WEIGHT", "MISFIT_SPREAD", "SCORE_CAP", "NEIGHBOUR_SCORE", "TRIED_BESIDE",
    "LEAST_LINK", "NEXT", "MOST_SUPPORT", "WINDOW", "LEAST_STD", "LEAST_YAW_STD", "FREEDOM",
    "APART", "PLACE_SCORE", "LEAD", "USUAL",
)  # fmt: skip


def compared(dataset: Dataset, truth: TruePairs) -> Compared:
    """Detect, and tell right motions from wrong ones."""
    place = dataset.index
    registrations = {
        (place[closure.query_id], place[closure.database_id]): others.own_registration(closure)
        for closure in detect(dataset).closures
    }
    right: dict[others.Pair, bool] = {}
    for k, T_true in enumerate(truth.T_database_query):
        pair = place[truth.ids[truth.query[k]]], place[truth.ids[truth.database[k]]]
        motion = registrations[pair].T_database_query if pair in registrations else None
        if motion is not None and truth.steps[k] > 1:
            off = T_true.inverse() @ motion
            near = np.hypot(off.x, off.y) < MAX_OFFSET and abs(np.degrees(off.yaw)) < MAX_TURN
            right[pair] = bool(near and truth.surface_overlap[k] > 0)
    return registrations, right


def all_sets(folder: Path) -> Iterator[tuple[str, Compared]]:
    """Detect on every set."""
    for name in (*SETS, "ridges"):
        truth = measure_pairs(load_dataset(folder / name))
        for kind, (points, noise_std) in KINDS.items():
            yield (
                f"{name}, {kind}",
                compared(load_degraded(folder / name, points, noise_std), truth),
            )
    for name, params in REPEATED.items():
        whole = replace(params, max_points=max(params.max_points, 30_000))
        yield name, compared(simulate_dataset(params), measure_pairs(simulate_dataset(whole)))


def worth(sets: Mapping[str, Compared]) -> dict[str, int]:
    """Count what is accepted of each set."""
    counts: dict[str, int] = {}
    for name, (registrations, right) in sets.items():
        contexts = others.Consistency().weigh(registrations)
        accepted = [right[pair] for pair in right if pair in contexts and contexts[pair].score >= 3]
        counts[name] = sum(accepted) - MISTAKE * (len(accepted) - sum(accepted))
    return counts


def main() -> None:
    """Print what each constant would be, and what that would be worth."""
    sets: dict[str, Compared] = {}
    for name, detected in all_sets(Path(os.environ.get("GPGRAD_DATA", "../shared/data"))):
        sets[name] = detected
        print(f"{name}: {worth({name: detected})[name]}", flush=True)
    print("constant, value; worth at 0.7, 1 and 1.4 times; and on each set as the others choose")
    for constant in CONSTANTS:
        value, tried = getattr(others, constant), dict[float, dict[str, int]]()
        for factor in FACTORS:
            setattr(others, constant, value * factor)
            tried[factor] = worth(sets)
        setattr(others, constant, value)
        left_out = 0
        for name in sets:
            rest = {factor: sum(t.values()) - t[name] for factor, t in tried.items()}
            left_out += tried[max(rest, key=lambda factor: (rest[factor], factor == 1))][name]
        worths = ", ".join(str(sum(counts.values())) for counts in tried.values())
        print(f"{constant} {value:g}: {worths}; {left_out}", flush=True)


if __name__ == "__main__":
    main()
