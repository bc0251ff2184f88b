# ruff: noqa: T201 - a command that prints a table
"""Closures of all real sets, whole and degraded: ``python -m tests.long.benchmarks.draws``.

Each set is compared whole, with 1,000 points of a submap (thin), and with 5,000 and 10 cm more
noise of heights (noisy); another draw takes other points and other noise. Everything is at its
default, and no method gets the truth, but for the *tuned grid*: it is the smoothed grid with the
blur that gives the set the best average precision (surface rule). ``GPGRAD_DATA`` names the folder
of the sets.
"""

import argparse
import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from gpgrad_core.evaluation import (
    EvaluationParams,
    TruePairs,
    evaluate,
    measure_pairs,
    run_methods,
)
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.methods import find_method
from gpgrad_core.types import Dataset
from tests.long.benchmarks.constants import SURFACE, with_constant
from tests.long.quality.degraded import load_degraded

SETS = ("marsyard2021", "dunes", "apollo15", "sthelens", "hillside", "marias", "ridges")
KINDS = {"whole": (None, 0.0), "thin": (1000, 0.0), "noisy": (5000, 0.1)}
"""Points of a submap and noise of their heights [m]."""
BLURS = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Blurs of which the tuned grid takes the best, in those of the smoothed one."""
METHODS = ("gradient", "smoothed", "tuned")


@dataclass(frozen=True)
class Outcome:
    """The accepted closures of a set, neighbours left out, and how well its scores rank."""

    right: int = 0
    wrong: int = 0
    apart: int = 0
    precision: float = 0.0
    note: str = ""

    def __str__(self) -> str:
        return f"{self.right} + {self.wrong} + {self.apart}, {self.precision:.4f}{self.note}"


@cache
def true_pairs(folder: Path) -> TruePairs:
    """Measure them on the whole set: thinning takes nothing from the truth."""
    return measure_pairs(load_dataset(folder))


def judge(dataset: Dataset, truth: TruePairs, method: str, note: str = "") -> Outcome:
    """Compare all pairs of a dataset, and judge what is accepted."""
    results = run_methods(dataset, [find_method(method)])
    judged = evaluate(dataset, results, EvaluationParams(num_resamples=0), pairs=truth)
    ranked, accepted = judged.methods[0].rules[SURFACE].ranked, judged.methods[0].accepted
    return Outcome(
        accepted.right,
        accepted.wrong_motion,
        accepted.no_overlap,
        ranked.average_precision.value if ranked else 0.0,
        note,
    )


def tuned_grid(dataset: Dataset, truth: TruePairs) -> Outcome:
    """Judge the smoothed grid with each blur, and take the best."""

    def judged(blur: float) -> Outcome:
        with with_constant("methods.smoothed", "BLUR", blur):
            return judge(dataset, truth, "smoothed", f" (blur {blur:g})")

    return max(map(judged, BLURS), key=lambda each: (each.precision, each.right))


def sums(outcomes: Iterable[Outcome]) -> str:
    each = list(outcomes)
    right, wrong, apart = (sum(getattr(o, k) for o in each) for k in ("right", "wrong", "apart"))
    return f"{right} + {wrong} + {apart}"


def main() -> int:
    """Print a table for each kind and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", nargs="+", default=SETS, choices=SETS)
    parser.add_argument("--kinds", nargs="+", default=tuple(KINDS), choices=tuple(KINDS))
    parser.add_argument("--draws", nargs="+", type=int, default=(0,))
    parser.add_argument("--methods", nargs="+", default=("gradient",), choices=METHODS)
    options = parser.parse_args()
    data = Path(os.environ["GPGRAD_DATA"])
    head = "right + wrong motion + apart, average precision"
    for kind in options.kinds:
        for draw in options.draws[:1] if kind == "whole" else options.draws:
            print(f"\n{kind}, draw {draw}: {head}\n")
            print(f"| set | {' | '.join(options.methods)} |")
            print("|---|" + "---|" * len(options.methods))
            table: list[list[Outcome]] = []
            for name in options.sets:
                dataset = load_degraded(data / name, *KINDS[kind], draw)
                truth = true_pairs(data / name)
                row = [
                    tuned_grid(dataset, truth)
                    if method == "tuned"
                    else judge(dataset, truth, method)
                    for method in options.methods
                ]
                table.append(row)
                print(f"| {name} | {' | '.join(map(str, row))} |", flush=True)
            print(f"| all | {' | '.join(sums(column) for column in zip(*table, strict=True))} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
