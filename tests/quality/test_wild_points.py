"""One wild point among tens of thousands changes no verdict and no motion.

``GPGRAD_DATA=... pytest tests/quality/test_wild_points.py -n 0 -s``; ten minutes. A point that is
found leaves the submap as it was, to the last bit. One that is kept is tried twice: with the map's
parameters given, and with all of them fitted to the dataset.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float

import gpgrad_core as gg
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import resolve_parameters
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Dataset, LoopClosure, Submap

INSERTIONS = 200
"""Number of wild points in each set."""
MOVED = 0.01
"""The middle of the query may move by this much at most [m]."""
GIVEN = gg.PipelineParams(
    map=gg.MapParams(length_scale=0.395, noise_std=0.0358, signal_std=0.188, resolution=0.05)
)
AUTOMATIC = gg.PipelineParams(map=gg.MapParams(resolution=0.05))


@pytest.mark.parametrize("name", ["demo", "marsyard2021", "sthelens"])
def test_a_wild_point_changes_no_verdict_and_no_motion(name: str, real_data: Path) -> None:
    dataset = gg.load_dataset(gg.demo_path() if name == "demo" else real_data / name)
    rng, memo = np.random.default_rng(20), Memo()
    usual = resolve_parameters(dataset.submaps, AUTOMATIC, memo)
    verdicts = gg.detect_loop_closures(dataset, usual, memo=memo).closures
    # Those that a small change would turn, too: accepted or refused by little.
    by_margin = sorted(verdicts, key=lambda one: abs(one.registration.score - 3.0))
    chosen = by_margin[:10] + [one for one in verdicts if one.accepted][:20]
    kept, changed, furthest = 0, [], 0.0
    for _ in range(INSERTIONS):
        pair = chosen[rng.integers(len(chosen))]
        wild_id = (pair.query_id, pair.database_id)[rng.integers(2)]
        before = dataset.submap(wild_id)
        point = _wild_point(before, rng)
        after = Submap.from_points(np.vstack([before.points, point]), wild_id)
        if after.fingerprint == before.fingerprint:
            continue
        kept, spoilt = kept + 1, _with(dataset, after)
        for params in (GIVEN, AUTOMATIC):
            expected = _verdict(dataset, params, pair, memo)
            got = _verdict(spoilt, params, pair, memo)
            moved = _moved(expected, got, dataset.submap(pair.query_id))
            furthest = max(furthest, moved if got.accepted else 0.0)
            if got.accepted != expected.accepted or (got.accepted and moved > MOVED):
                how = "given" if params is GIVEN else "automatic"
                changed.append(
                    f"{pair.query_id}-{pair.database_id}, {how}: {wild_id} with {point.round(2)}: "
                    f"score {expected.registration.score:.2f} -> {got.registration.score:.2f}, "
                    f"{100 * moved:.1f} cm"
                )
    print(
        f"\n{name}: {INSERTIONS} points, {kept} of them kept; {len(changed)} verdicts or motions "
        f"changed; no other moved by more than {1000 * furthest:.2f} mm"
    )
    assert not changed, "\n".join(changed)


def _wild_point(submap: Submap, rng: np.random.Generator) -> Float[NDArray[np.float64], "3"]:
    """Draw a place in the submap's box or far around it, at a height of 1 m to 1e9 m."""
    low, high = submap.corners
    width = 1.0 if rng.random() < 0.7 else 10 ** rng.uniform(0, 6)
    x, y = (low + high) / 2 + width * (high - low) * rng.uniform(-0.5, 0.5, 2)
    most = 9 if rng.random() < 0.5 else 1.5  # the lower ones are harder to find
    return np.array([x, y, rng.choice([-1, 1]) * 10 ** rng.uniform(0, most)])


def _with(dataset: Dataset, submap: Submap) -> Dataset:
    """Put a submap in the place of that of the same name."""
    submaps = tuple(submap if one.id == submap.id else one for one in dataset.submaps)
    return replace(dataset, submaps=submaps)


def _verdict(
    dataset: Dataset, params: gg.PipelineParams, pair: LoopClosure, memo: Memo
) -> LoopClosure:
    used = resolve_parameters(dataset.submaps, params, memo)
    only = [(pair.query_id, pair.database_id)]
    return gg.detect_loop_closures(dataset, used, memo=memo, only=only).closures[0]


def _moved(before: LoopClosure, after: LoopClosure, query: Submap) -> float:
    """Measure how far two motions put the middle of the query apart [m]."""
    motions = before.registration.T_database_query, after.registration.T_database_query
    if None in motions:
        return np.inf if motions[0] is not motions[1] else 0.0
    middle = query.corners.mean(axis=0)
    first, second = (motion.apply(middle[None])[0] for motion in motions if motion is not None)
    return float(np.hypot(*(first - second)))
