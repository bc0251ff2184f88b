# ruff: noqa: T201 - a command that prints a table
"""What each constant decides: ``python -m tests.long.benchmarks.constants [NAME …]``.

Each constant of the registration and of the verdict is halved and doubled, one at a time, and all
pairs of some sets are registered and judged again. A row gives the accepted closures with the right
and with a wrong motion, the mean average precision (surface rule), and how many verdicts are others
than with the constant as it is. ``GPGRAD_DATA`` names the folder of the real sets.
"""

import argparse
import os
import sys
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from statistics import fmean
from typing import Any

from gpgrad_core.detection import (
    MapDetector,
    PipelineParams,
    detect_loop_closures,
    resolve_parameters,
)
from gpgrad_core.detection.pipeline import ExtractedSubmap
from gpgrad_core.evaluation import EvaluationParams, TruePairs, evaluate, measure_pairs
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import Store
from gpgrad_core.types import Dataset, GradientMap, PairOfIds, Registration, Submap
from tests.long.quality.degraded import load_degraded

SETS = {
    "marias": (None, 0.0),
    "dunes": (1000, 0.0),
    "hillside": (5000, 0.1),
    "apollo15": (5000, 0.1),
}
"""The sets, each with the number of points of a submap and the noise of their heights [m]."""
SURFACE = 1
"""Number of the rule on surfaces among those of an evaluation."""

OF_PAIRS = {
    "registration.register": "NUM_ALIGNED NUM_SCORED MIN_FINE_SCORE CLEARLY_BEST COARSE_CELLS "
    "COARSE_ITERATIONS ALIGNED_CELLS ALIGNED_ITERATIONS",
    "registration.params": "RADIUS_IN_SCALES",
    "registration.candidates": "SAME_TURN NUM_YAWS CELL MOST_CELLS LEAST_PATCHES APART",
    "registration.align": "FEWEST_CELLS DRIFT_SHIFT DRIFT_TURN DRIFT_RISE NOISE_SHARE RIGID_TILT "
    "ROBUSTNESS ROUGH_CELLS ROUGH_ITERATIONS FINE_CELLS FINE_ITERATIONS NEAR MOST_REMOVED "
    "WARP_ROUNDS WARP_CELLS LEVEL.tilt_std DRIFTED.tilt_std DRIFTED.bend_std",
    "registration.score": "DRIFT_SHARE FREEDOM INLIER_WEIGHT BAND_WEIGHTS.1 UNRELATED_LEVEL "
    "UNRELATED_SPREAD",
}
"""Constants by module that act on pairs."""
OF_VERDICTS = {
    "detection.consistency": "USUAL_MISFIT USUAL_WEIGHT MISFIT_SPREAD SCORE_CAP NEIGHBOUR_SCORE "
    "TRIED_BESIDE LEAST_LINK NEXT MOST_WRONG MOST_SUPPORT WINDOW LEAST_STD LEAST_YAW_STD FREEDOM "
    "APART PLACE_SCORE CONTRADICTED LEAD REPEATED.0 REPEATED.1 USUAL USUAL_GAP MOST_GAP GAPS_TOLD "
    "FEW_GAPS FACTOR_STEPS MOST_FACTOR",
    "detection.verdict": "SMALL_OVERLAP IMPOSSIBLE SMOOTH",
}
"""Constants by module that act on pairs that were registered."""
OF_MAPS = {
    "registration.surface": "FINE_CELL CELL SHARP_CELL CHECKED_CELLS NUM_DENSITIES NUM_WAVES",
    "features.surf": "OCTAVES LAYERS XY_WEIGHT LEAST_RESPONSE SIGMA_OF_SIDE HEADINGS "
    "HEADING_RADIUS HEADING_WIDTH CELL_WIDTH SQUARE_WIDTH SAMPLES SIGN_DISTANCE",
    "features.slope_field": "SCALES.0 SCALES.1 SPOKES LEAST_WEIGHT LEAST_RESPONSE CELLS",
}
"""Constants by module that act on maps, before any pair."""
OF_FITS = {
    "scale": "RESOLVED CELLS_ACROSS FEWEST_ACROSS",
    "mapping.fitting": "LEAST_SHARE",
    "detection.automatic": "SUBMAP_PATCH_POINTS",
}
"""Constants by module that act on the fit of parameters."""


@dataclass(frozen=True, eq=False)
class Warm(MapDetector):
    """The pipeline's detector with what is there already, and no memo."""

    maps: dict[str, GradientMap] = field(default_factory=dict[str, GradientMap])
    extracted: dict[str, ExtractedSubmap] = field(default_factory=dict[str, ExtractedSubmap])
    registered: dict[tuple[int, int], Registration] = field(
        default_factory=dict[tuple[int, int], Registration]
    )

    def infer(self, submap: Submap, progress: Progress = silent) -> GradientMap:
        if submap.id not in self.maps:
            self.maps[submap.id] = super().infer(submap, progress)
        return self.maps[submap.id]

    def extract(self, inferred: GradientMap, progress: Progress = silent) -> ExtractedSubmap:
        name = next(name for name, known in self.maps.items() if known is inferred)
        if name not in self.extracted:
            self.extracted[name] = super().extract(inferred, progress)
        return self.extracted[name]

    def compare(self, query: ExtractedSubmap, database: ExtractedSubmap) -> Registration:
        pair = id(query), id(database)  # both are kept in `extracted`
        if pair not in self.registered:
            self.registered[pair] = MapDetector(self.params, Memo()).compare(query, database)
        return self.registered[pair]


@dataclass
class Bench:
    """A set with what does not change while constants of pairs do."""

    dataset: Dataset
    true_pairs: TruePairs
    params: PipelineParams
    maps: dict[str, GradientMap]
    extracted: dict[str, ExtractedSubmap]
    registered: dict[tuple[int, int], Registration]


@dataclass(frozen=True)
class Outcome:
    """What became of all pairs of a set, or of several."""

    right: int
    wrong: int
    precisions: tuple[float, ...]
    accepted: frozenset[tuple[str, PairOfIds]]

    @classmethod
    def of(cls, each: Iterable["Outcome"]) -> "Outcome":
        each = list(each)
        return cls(
            sum(one.right for one in each),
            sum(one.wrong for one in each),
            tuple(p for one in each for p in one.precisions),
            frozenset().union(*(one.accepted for one in each)),
        )

    def row(self, usual: "Outcome") -> str:
        """As cells of the table."""
        changed = len(self.accepted ^ usual.accepted)
        return f"{self.right} + {self.wrong} | {fmean(self.precisions):.3f} | {changed}"


def prepare(name: str, data: Path) -> Bench:
    """Load a set, degrade it, fit its parameters, and measure its true pairs on the whole one."""
    points, noise = SETS[name]
    dataset = load_degraded(data / name, points, noise)
    params = resolve_parameters(dataset.submaps, PipelineParams(), Memo(store=Store()))
    return Bench(dataset, measure_pairs(load_dataset(data / name)), params, {}, {}, {})


def detect(bench: Bench) -> Outcome:
    """Register and judge all pairs of a set."""
    detector = Warm(
        bench.params,
        Memo(),
        maps=bench.maps,
        extracted=bench.extracted,
        registered=bench.registered,
    )
    result = detect_loop_closures(bench.dataset, bench.params, detector=detector)
    judged = evaluate(
        bench.dataset, {"": result}, EvaluationParams(num_resamples=0), pairs=bench.true_pairs
    ).methods[0]
    ranked, accepted = judged.rules[SURFACE].ranked, judged.accepted
    return Outcome(
        accepted.right,
        accepted.wrong_motion + accepted.no_overlap,
        (ranked.average_precision.value if ranked else 0.0,),
        frozenset((bench.dataset.name, c.pair) for c in result.closures if c.accepted),
    )


def scaled(value: Any, factor: float) -> Any:
    """Multiply a number; a whole one stays whole and at least one."""
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


def changed(value: Any, part: str, factor: float) -> Any:
    """Multiply a constant, or one part of a tuple or of a dataclass."""
    if not part:
        return scaled(value, factor)
    if not isinstance(value, tuple):
        return replace(value, **{part: scaled(getattr(value, part), factor)})
    each: list[Any] = [*value]
    each[int(part)] = scaled(each[int(part)], factor)
    return tuple(each)


@contextmanager
def with_constant(module: str, path: str, factor: float) -> Generator[None]:
    """Multiply a constant in its module and in all that have imported it."""
    name, _, part = path.partition(".")
    home = import_module(f"gpgrad_core.{module}")
    before = getattr(home, name)
    users = [
        user
        for known, user in sys.modules.items()
        if known.startswith("gpgrad_core")
        and (user is home or (getattr(user, name, None) is before and _imports(user, home)))
    ]
    for user in users:
        setattr(user, name, changed(before, part, factor))
    try:
        yield
    finally:
        for user in users:
            setattr(user, name, before)


def _imports(user: Any, home: Any) -> bool:
    """Tell whether a module has imported from another one, by its text."""
    path = getattr(user, "__file__", None)
    return path is not None and f"from {home.__name__} import" in Path(path).read_text("utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="of constants; all by default")
    parser.add_argument("--sets", nargs="+", default=tuple(SETS), choices=tuple(SETS))
    asked = parser.parse_args()
    data = Path(os.environ.get("GPGRAD_DATA", "../shared/data"))
    benches = [prepare(name, data) for name in asked.sets]
    usual = Outcome.of(map(detect, benches))
    print("| constant | now | half | AP | verdicts | twice | AP | verdicts |")
    print(f"|---|---|---|---|---|---|---|---|\n| as it is | | {usual.row(usual)} | | | |")
    for group in (OF_VERDICTS, OF_PAIRS, OF_MAPS, OF_FITS):
        for module, names in group.items():
            for path in names.split():
                if asked.names and path not in asked.names:
                    continue
                home = getattr(import_module(f"gpgrad_core.{module}"), path.partition(".")[0])
                cells = [f"`{module}.{path}`", str(home)]
                for factor in (0.5, 2.0):
                    with with_constant(module, path, factor):
                        cells.append(_outcome_of(benches, group).row(usual))
                print(f"| {' | '.join(cells)} |", flush=True)


def _outcome_of(benches: list[Bench], group: dict[str, str]) -> Outcome:
    if group is OF_VERDICTS:
        return Outcome.of(map(detect, benches))
    if group is OF_PAIRS:
        return Outcome.of(detect(replace(bench, registered={})) for bench in benches)
    if group is OF_MAPS:
        return Outcome.of(detect(replace(bench, extracted={}, registered={})) for bench in benches)
    fitted = (
        replace(
            bench,
            params=resolve_parameters(bench.dataset.submaps, PipelineParams(), Memo()),
            maps={},
            extracted={},
            registered={},
        )
        for bench in benches
    )
    return Outcome.of(map(detect, fitted))


if __name__ == "__main__":
    main()
