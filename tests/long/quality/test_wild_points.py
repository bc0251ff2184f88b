"""Points that no terrain explains change no verdict, and no motion by more than a millimetre.

Twenty minutes. Points that are found leave the submap as it was, to the last bit. Where one is
kept, the pair is tried twice: with the map's parameters given, and with all of them fitted to the
dataset.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float
from scipy.spatial import cKDTree

import gpgrad_core as gg
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import resolve_parameters
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Dataset, LoopClosure, Submap

INSERTIONS = 250
"""Number of insertions into each set: one point, up to 1 % of the points, or a swarm of them."""
MOVED = 0.001
"""The middle of the query may move by this much at most [m]."""
STEEP = 2.0
"""A point beside the others is explained by no terrain if this slope does not reach it [m/m]."""
GIVEN = gg.PipelineParams(
    map=gg.MapParams(length_scale=0.395, noise_std=0.0358, signal_std=0.188, resolution=0.05)
)
AUTOMATIC = gg.PipelineParams(map=gg.MapParams(resolution=0.05))


@pytest.mark.parametrize("name", ["demo", "marsyard2021", "sthelens", "hillside"])
def test_wild_points_change_no_verdict_and_no_motion(name: str, real_data: Path) -> None:
    dataset = gg.load_dataset(gg.demo_path() if name == "demo" else real_data / name)
    rng, memo = np.random.default_rng(20), Memo()
    usual = resolve_parameters(dataset.submaps, AUTOMATIC, memo)
    verdicts = gg.detect_loop_closures(dataset, usual, memo=memo).closures
    # Those that a small change would turn, too: accepted or refused by little.
    by_margin = sorted(verdicts, key=lambda one: abs(one.registration.score - 3.0))
    chosen = by_margin[:10] + [one for one in verdicts if one.accepted][:20]
    inserted, kept, spoilt_trials, changed, furthest = 0, 0, 0, [], 0.0
    for _ in range(INSERTIONS):
        pair = chosen[rng.integers(len(chosen))]
        wild_id = (pair.query_id, pair.database_id)[rng.integers(2)]
        before = dataset.submap(wild_id)
        points = _wild_points(before, rng)
        inserted += len(points)
        after = Submap.from_points(np.vstack([before.points, points]), wild_id)
        if after.fingerprint == before.fingerprint:
            continue
        kept += after.num_points - before.num_points
        spoilt_trials += 1
        spoilt = _with(dataset, after)
        for params in (GIVEN, AUTOMATIC):
            expected = _verdict(dataset, params, pair, memo)
            got = _verdict(spoilt, params, pair, memo)
            moved = _moved(expected, got, dataset.submap(pair.query_id))
            furthest = max(furthest, moved if got.accepted else 0.0)
            if got.accepted != expected.accepted or (got.accepted and moved > MOVED):
                how = "given" if params is GIVEN else "automatic"
                changed.append(
                    f"{pair.query_id}-{pair.database_id}, {how}: {wild_id} with {len(points)}, "
                    f"{after.num_points - before.num_points} of them kept: score "
                    f"{expected.registration.score:.2f} -> {got.registration.score:.2f}, "
                    f"{1000 * moved:.1f} mm"
                )
    print(
        f"\n{name}: {INSERTIONS} insertions of {inserted:,} points, {kept} of them kept in "
        f"{spoilt_trials}; {len(changed)} verdicts or motions changed; the furthest moved by "
        f"{1000 * furthest:.2f} mm"
    )
    assert not changed, "\n".join(changed)


def _wild_points(submap: Submap, rng: np.random.Generator) -> Float[NDArray[np.float64], "k 3"]:
    """Draw points that are further from the ground than noise and slopes explain, to 1e9 m.

    They are in the submap's box or far around it, above or below: one, many apart, or one swarm.
    """
    kind = rng.integers(3)
    most = max(2, len(submap.points) // 100)
    count = 1 if kind == 0 else int(rng.integers(1, most + 1))
    at = 1 if kind == 2 else count
    low, high = submap.corners
    width = np.where(rng.random(at) < 0.7, 1.0, 10 ** rng.uniform(0, 6, at))[:, None]
    xy = (low + high) / 2 + width * (high - low) * rng.uniform(-0.5, 0.5, (at, 2))
    distances, near = map(np.asarray, cKDTree(submap.points[:, :2]).query(xy, 24))
    ground = submap.points[near, 2]
    # The lower ones are harder to find.
    height = 1.0 * 10 ** rng.uniform(0, np.where(rng.random(at) < 0.5, 9.0, 1.5))
    beyond = np.where(rng.random(at) < 0.5, ground.max(axis=1), ground.min(axis=1))
    sign = np.where(beyond == ground.max(axis=1), 1.0, -1.0)
    reach = STEEP * distances[:, 3]
    z = np.clip(beyond + sign * (height + reach), -1e9, 1e9)
    centres = np.column_stack([xy, z])
    if kind != 2:
        return centres
    # One that reaches down to the ground is a bush, and no swarm.
    spread = min(10 ** rng.uniform(-2, -0.5), float(height[0]) / 8)
    return centres + rng.normal(0, spread, (count, 3))


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
