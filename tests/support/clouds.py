"""Twelve kinds of odd clouds, parameters within their bounds, and the whole pipeline over both."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gpgrad_core.arrays import Array
from gpgrad_core.detection import PairResult, PipelineParams, register_pair, resolve_parameters
from gpgrad_core.params import Bounds, parameters_of, with_path
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Submap

Rng = np.random.Generator


def _log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _blobs(rng: Rng, n: int, size: float) -> Array:
    centres = rng.uniform(0, size, (int(rng.integers(1, 8)), 2))
    spread = size * _log_uniform(rng, 0.003, 0.3)
    return centres[rng.integers(len(centres), size=n)] + spread * rng.standard_normal((n, 2))


def _lines(rng: Rng, n: int, size: float) -> Array:
    along, thickness = rng.uniform(0, size, n), size * _log_uniform(rng, 1e-5, 0.05)
    angle = rng.choice([0.0, np.pi / 2, np.pi / 4, 1.0], n if rng.random() < 0.5 else 1)
    across = thickness * rng.standard_normal(n)
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([c * along - s * across, s * along + c * across])


def _rings(rng: Rng, n: int, size: float) -> Array:
    radius = size * rng.choice([0.2, 0.35, 0.5], n) + 0.003 * size * rng.standard_normal(n)
    angle = rng.uniform(0, 2 * np.pi, n)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _one_spot(rng: Rng, n: int, size: float) -> Array:
    return np.full((n, 2), size) + _log_uniform(rng, 1e-7, 0.01) * rng.standard_normal((n, 2))


def _wide_and_sparse(rng: Rng, n: int, size: float) -> Array:
    return rng.uniform(0, max(size, 100.0), (min(n, 500), 2))


def _duplicate(rng: Rng, n: int, size: float) -> Array:
    few = rng.uniform(0, size, (max(3, n // int(rng.integers(2, 50))), 2))
    return few[rng.integers(len(few), size=n)]


def _far_away(rng: Rng, n: int, size: float) -> Array:
    return rng.uniform(0, size, (n, 2)) + rng.choice([-1.0, 1.0], 2) * _log_uniform(rng, 1e3, 1e7)


def _even(rng: Rng, n: int, size: float) -> Array:
    return rng.uniform(0, size, (n, 2)) * [1.0, _log_uniform(rng, 0.02, 1.0)]


def _wall(rng: Rng, n: int, size: float) -> Array:
    xy = rng.uniform(0, size, (n, 2))
    xy[rng.random(n) < rng.choice([0.5, 0.99, 1.0]), 0] = size / 3
    return xy


def _far_apart(rng: Rng, n: int, size: float) -> Array:
    apart = float(rng.choice([10.0, 100.0, 141.0, 1000.0]))
    side = rng.integers(2, size=n)[:, None]
    spread = min(size, 5.0) * rng.standard_normal((n, 2))
    return spread + side * apart * np.array([1.0, rng.choice([0.0, 1.0])])


def _radial(rng: Rng, n: int, size: float) -> Array:
    radius = size * rng.random(n) ** rng.choice([1.0, 2.0, 4.0])
    angle = 2 * np.pi * rng.integers(0, int(rng.choice([7, 64, 1000])), n) / 64
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _grid(rng: Rng, n: int, size: float) -> Array:
    size *= float(rng.choice([1.0, 0.1]))
    side = max(2, int(np.sqrt(n)))
    x, y = np.meshgrid(np.linspace(0, size, side), np.linspace(0, size, side))
    return np.column_stack([x.ravel(), y.ravel()])


KINDS: dict[str, Callable[[Rng, int, float], Array]] = {
    "blobs": _blobs,
    "lines": _lines,
    "rings": _rings,
    "one spot": _one_spot,
    "wide and sparse": _wide_and_sparse,
    "duplicate": _duplicate,
    "far away": _far_away,
    "flat": _even,
    "wall": _wall,
    "two far apart": _far_apart,
    "radial": _radial,
    "grid": _grid,
}


def draw_cloud(kind: str, rng: Rng, most_points: int, most_size: float = 300.0) -> Array:
    """Draw (n, 3) points of a kind; flat ones have no relief at all."""
    n = int(_log_uniform(rng, 3, most_points))
    size = _log_uniform(rng, 0.01, most_size)
    xy = KINDS[kind](rng, n, size)
    wave = max(size, 1e-3) * _log_uniform(rng, 0.05, 2.0)
    relief = wave * _log_uniform(rng, 1e-4, 1.0)
    z = relief * np.cos(xy @ (rng.standard_normal((2, 3)) / wave)).sum(axis=1)
    z += _log_uniform(rng, 1e-4, 0.5) * rng.standard_normal(len(xy))
    if kind == "flat":
        z = np.full(len(xy), float(rng.choice([0.0, -12.5, 8848.0])))
    if rng.random() < 0.1:  # wild points
        wild = rng.random(len(z)) < 0.05
        z[wild] += 100.0 * rng.standard_normal(int(wild.sum()))
    return np.column_stack([xy, z])


def draw_submaps(
    kind: str, rng: Rng, most_points: int, *, with_noise: bool = False
) -> tuple[Submap, Submap]:
    """Draw a cloud, and the same turned, moved and in part."""
    points = draw_cloud(kind, rng, most_points)
    yaw = rng.uniform(-np.pi, np.pi)
    c, s = np.cos(yaw), np.sin(yaw)
    moved = points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    moved = moved[: max(min(4, len(moved)), int(len(moved) * rng.uniform(0.3, 1.0)))]
    noise = 10.0 ** rng.uniform(-4, 0, len(points)) if with_noise else None
    return (
        Submap.from_points(points, "query", noise_std=noise),
        Submap.from_points(
            moved, "database", noise_std=None if noise is None else noise[: len(moved)]
        ),
    )


def draw_value(bounds: Bounds, rng: Rng) -> float:
    """Draw from the slider's range or from all of the bounds, evenly or by decades; ends too."""
    low, high = bounds.slider_range if rng.random() < 0.6 else (bounds.low, bounds.high)
    if rng.random() < 0.05:
        return float(rng.choice([bounds.low, bounds.high]))
    if low > 0 and rng.random() < 0.7:
        return _log_uniform(rng, low, high)
    return float(rng.uniform(low, high))


def draw_params(rng: Rng) -> PipelineParams:
    """Draw parameters within their bounds; each keeps its default with some chance."""
    params = PipelineParams()
    kept = rng.random()
    for field in parameters_of(PipelineParams):
        if rng.random() < kept:
            continue
        if field.optional and rng.random() < 0.3:
            value: Any = None
        elif isinstance(field.kind, tuple):
            value = str(rng.choice(field.kind))
        elif field.kind is bool:
            value = bool(rng.random() < 0.5)
        elif field.bounds is None:
            value = int(rng.integers(2**31))
        else:
            value = field.kind(draw_value(field.bounds, rng))
            value = min(max(value, field.kind(field.bounds.low)), field.kind(field.bounds.high))
        params = with_path(params, field.path, value)
    # The number of trials is what a user asks for; it takes its time by itself.
    return replace(
        params,
        registration=replace(params.registration, trials=min(5000, params.registration.trials)),
    )


def run_pipeline(query: Submap, database: Submap, params: PipelineParams) -> PairResult:
    """Run every stage; check that what comes out is finite."""
    memo = Memo()
    params = resolve_parameters([query, database], params, memo)
    result = register_pair(query, database, params, memo)
    for made in (result.query_map, result.database_map):
        assert np.isfinite(made.elevation).all()
        assert np.isfinite(made.slope).all()
        assert np.isfinite(made.variance).all()
        assert (made.variance >= 0).all()
        assert made.std.max() <= made.signal_std * (1 + 1e-9)
        assert made.scale > 0
    assert np.isfinite(result.registration.score)
    assert result.closure.reason
    return result
