# ruff: noqa: T201 - a command that prints tables
"""What the shortlist holds, and what it takes: ``python -m tests.long.benchmarks.bench_shortlist``.

All given sets lie in one pot with distractors: simulated submaps of other ground, and the mirror
images of all keypoints, which look like the same ground but are other places. The distractors come
first, so that the vocabulary is learned from them. Maps take most of the time; their keypoints are
kept in ``--cache``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import tyro

from gpgrad_core.detection import (
    PipelineParams,
    detect_loop_closures,
    infer_features,
    resolve_parameters,
)
from gpgrad_core.detection.shortlist import DEFAULT_CANDIDATES, Shortlist
from gpgrad_core.evaluation import EvaluationParams, measure_pairs
from gpgrad_core.features.slope_field import RINGS, SPOKES
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.fitting import representative
from gpgrad_core.params import preferred_parameters
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.threads import num_workers
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.simulate import simulate_dataset
from gpgrad_core.types import Dataset, Features
from tests.core.detection.places import features as any_features

COUNTS = (10, 30, 50)
SIZES = (1_000, 10_000)
GROUNDS = (
    SimulationParams(extent=100.0),
    SimulationParams(extent=100.0, roughness=0.7, rock_density=0.5, crater_density=0.0),
    SimulationParams(
        extent=100.0, relief=0.15, crater_density=0.1, dune_height=0.3, rock_density=3.0
    ),
    SimulationParams(
        extent=100.0,
        hill_height=1.5,
        roughness=0.1,
        crater_density=0.01,
        rock_density=0.3,
        dune_height=0.05,
    ),
)


@dataclass(frozen=True)
class Bench:
    """Arguments.

    Attributes:
        data: Folder of datasets with true poses, beside the four simulated ones.
        cache: Folder to keep keypoints in.
        distractors: Number of distractors, mirror images included.
    """

    data: Path = Path("../shared/data")
    cache: Path = Path("build/bench_shortlist")
    distractors: int = 2_000


@dataclass(frozen=True, eq=False)
class Keypoints:
    """The keypoints of a set, its true pairs (query, database) without neighbours, and the pairs
    that are accepted when all are compared."""

    features: list[Features]
    true: list[tuple[int, int]]
    accepted: list[tuple[int, int]]


def main() -> None:
    """Measure, and print two tables."""
    bench = tyro.cli(Bench)
    bench.cache.mkdir(parents=True, exist_ok=True)
    folders = sorted(folder for folder in bench.data.glob("*") if (folder / "submaps").is_dir())
    sets = {folder.name: _kept(bench.cache, folder.name, _loader(folder)) for folder in folders}
    for k, ground in enumerate(GROUNDS):
        params = SimulationParams(**(vars(ground) | {"seed": 100 + k}))
        sets[f"simulated {k}"] = _kept(bench.cache, f"simulated_{k}", _simulator(params))
    pot = _distractors(bench, list(sets.values()))
    shortlist = Shortlist()
    for k, one in enumerate(pot):
        shortlist.add(f"distractor {k}", one)
    columns = "".join(f" K = {count} |" for count in COUNTS) + " automatic |"
    print(f"| set, among {len(pot):,} distractors | true |{columns} accepted |{columns} named |")
    print("|---" * (6 + 2 * len(COUNTS)) + "|")
    every: list[Found] = []
    for name, held in sets.items():
        found = [_find(shortlist, name, held, k) for k in range(len(held.features))]
        every += found
        print(_row(name, found))
    print(_row("all", every))
    _time()


@dataclass(frozen=True)
class Found:
    """Where a shortlist has a query's pairs.

    Attributes:
        true: Rank of each true pair.
        accepted: Rank of each pair that is accepted when all are compared.
        promising: Number of candidates that ``automatic`` names.
    """

    true: list[int]
    accepted: list[int]
    promising: int


def _loader(folder: Path) -> Callable[[], Dataset]:
    return lambda: load_dataset(folder)


def _simulator(params: SimulationParams) -> Callable[[], Dataset]:
    return lambda: simulate_dataset(params)


def _row(name: str, found: list[Found]) -> str:
    cells: list[str] = []
    for ranks in (
        [(r, one.promising) for one in found for r in one.true],
        [(r, one.promising) for one in found for r in one.accepted],
    ):
        cells.append(str(len(ranks)))
        rank, promising = np.array(ranks).T
        cells += [f"{np.mean(rank < count):.3f}" for count in (*COUNTS, promising)]
    cells.append(f"{np.mean([one.promising for one in found]):.0f}")
    return f"| {name} | {' | '.join(cells)} |"


def _find(shortlist: Shortlist, name: str, held: Keypoints, query: int) -> Found:
    """Look for a query's pairs, and add it."""
    features = held.features[query]
    best = [one.id for one in shortlist.candidates(features, max(COUNTS))]
    promising = shortlist.candidates(features, DEFAULT_CANDIDATES, promising=True)
    true, accepted = (
        [
            best.index(wanted) if (wanted := f"{name} {database}") in best else max(COUNTS)
            for later, database in pairs
            if later == query
        ]
        for pairs in (held.true, held.accepted)
    )
    shortlist.add(f"{name} {query}", features)
    return Found(true, accepted, len(promising))


def _kept(cache: Path, name: str, make: Callable[[], Dataset]) -> Keypoints:
    """Make the keypoints of a dataset, or read them."""
    file = cache / f"{name}.npz"
    if not file.exists():
        dataset = make()
        params = preferred_parameters(dataset, PipelineParams())
        some = [dataset.submaps[k] for k in representative(len(dataset.submaps))]
        params = resolve_parameters(some, params)
        found = [infer_features(submap, params, Memo()) for submap in dataset.submaps]
        accepted = np.zeros((0, 2), int)
        if not name.startswith("distractors"):
            with workers(num_workers(), 10_000) as executor:
                result = detect_loop_closures(dataset, params, candidates="all", executor=executor)
            place = dataset.index
            accepted = np.array(
                [
                    (place[one.query_id], place[one.database_id])
                    for one in result.closures
                    if one.accepted
                ]
            )
        pairs = measure_pairs(dataset)
        surface = EvaluationParams().rules[1].label(pairs).positive
        np.savez(
            file,
            counts=[len(one) for one in found],
            positions=np.concatenate([one.positions for one in found]),
            scales=np.concatenate([one.scales for one in found]),
            responses=np.concatenate([one.responses for one in found]),
            descriptors=np.concatenate([one.descriptors for one in found]),
            true=np.column_stack([pairs.query, pairs.database])[surface],
            accepted=accepted,
        )
    with np.load(file) as archive:
        held = dict(archive)
    ends = np.cumsum(held["counts"])
    rows = [slice(end - count, end) for end, count in zip(ends, held["counts"], strict=True)]
    features = [
        Features(
            held["positions"][row],
            held["scales"][row],
            held["responses"][row],
            np.zeros(row.stop - row.start),
            held["descriptors"][row],
        )
        for row in rows
    ]
    true, accepted = (
        [(int(query), int(database)) for query, database in held[name]]
        for name in ("true", "accepted")
    )
    return Keypoints(features, true, accepted)


def _distractors(bench: Bench, sets: list[Keypoints]) -> list[Features]:
    plain: list[Features] = []
    own = [mirrored(one) for held in sets for one in held.features]
    seed = 0
    while 2 * len(plain) + len(own) < bench.distractors:
        ground = vars(GROUNDS[seed % len(GROUNDS)])
        params = ground | {
            "seed": 1000 + seed,
            "num_submaps": 200,
            "extent": 240.0,
            "max_points": 15_000,
        }
        made = _kept(bench.cache, f"distractors_{seed}", _simulator(SimulationParams(**params)))
        plain += made.features
        seed += 1
    return [*plain, *map(mirrored, plain), *own][: bench.distractors]


def mirrored(features: Features) -> Features:
    """Mirror keypoints of the slope detector: ground that is as likely, but another place."""
    order = [0]
    for ring in range(len(RINGS)):
        first = 1 + SPOKES * ring
        order += [first + (SPOKES - ring % 2 - k) % SPOKES for k in range(SPOKES)]
    along, across = np.split(features.descriptors, 2, axis=1)
    return Features(
        features.positions * [1.0, -1.0],
        features.scales,
        features.responses,
        features.std_ratios,
        np.hstack([along[:, order], -across[:, order]]).astype(np.float32),
    )


def _time() -> None:
    """Time a submap among many that are made of random numbers."""
    print("\n| submaps | ms a submap: candidates | ms a submap: added | MB |\n|---|---|---|---|")
    shortlist, queries = Shortlist(), 20
    for size in SIZES:
        start, before = perf_counter(), len(shortlist)
        for k in range(before, size):
            shortlist.add(str(k), any_features(k, 754))
        added = (perf_counter() - start) / (size - before)
        asked = [any_features(20_000 + k, 754) for k in range(queries)]
        start = perf_counter()
        for one in asked:
            shortlist.candidates(one, 30)
        taken = (perf_counter() - start) / queries
        state = shortlist.state
        kept = state.global_vectors.nbytes + state.descriptors.nbytes + state.positions.nbytes
        print(f"| {size:,} | {1000 * taken:.0f} | {1000 * added:.1f} | {kept / 1e6:.0f} |")


if __name__ == "__main__":
    main()
