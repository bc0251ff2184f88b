"""Synthetic ground with known heights, and clouds of points on it."""

from dataclasses import dataclass

import numpy as np

from gpgrad_core.arrays import Array
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, Grid, Submap


@dataclass(frozen=True, eq=False)
class Ground:
    """A sum of plane waves of random direction; no two places look alike."""

    wave_vectors: Array  # (waves, 2) [rad/m]
    phases: Array  # (waves,) [rad]
    amplitudes: Array  # (waves,) [m]

    @classmethod
    def random(
        cls, seed: int, *, shortest: float = 0.8, longest: float = 6.0, std: float = 0.15
    ) -> "Ground":
        rng = np.random.default_rng(seed)
        waves = 80
        wave_lengths = np.exp(rng.uniform(np.log(shortest), np.log(longest), waves))
        headings = rng.uniform(0, 2 * np.pi, waves)
        vectors = 2 * np.pi / wave_lengths * np.array([np.cos(headings), np.sin(headings)])
        amplitudes = wave_lengths * np.sqrt(2) / np.linalg.norm(wave_lengths) * std
        return cls(vectors.T, rng.uniform(0, 2 * np.pi, waves), amplitudes)

    def height(self, xy: Array) -> Array:
        return np.cos(xy @ self.wave_vectors.T + self.phases) @ self.amplitudes


def scatter(seed: int, num: int, size: tuple[float, float], holes: int = 0) -> Array:
    """Draw positions in a box, with some round holes of 0.5 m without any."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, size, (num, 2))
    for centre in rng.uniform(0, size, (holes, 2)):
        xy = xy[np.hypot(*(xy - centre).T) > 0.5]
    return xy


def cloud(
    seed: int,
    num: int,
    size: tuple[float, float] = (5.0, 5.0),
    *,
    noise: float | Array = 0.02,
    holes: int = 0,
) -> Array:
    """Draw (n, 3) points on random ground, with noisy heights."""
    xy = scatter(seed, num, size, holes)
    rng = np.random.default_rng(seed + 1)
    return np.column_stack(
        [xy, Ground.random(seed).height(xy) + noise * rng.standard_normal(len(xy))]
    )


def submap(seed: int, num: int = 800, size: tuple[float, float] = (4.0, 4.0)) -> Submap:
    return Submap.from_points(cloud(seed, num, size), f"ground-{seed}")


SIGNAL_STD = 0.15


def seen_from(
    ground: Ground,
    T_world_map: SE2,
    grid: Grid,
    *,
    length_scale: float = 0.3,
    variance: float | Array = 1e-4,
) -> GradientMap:
    """Make the map that a perfect sensor would, by the ground's own derivatives."""
    phases = T_world_map.apply(grid.positions) @ ground.wave_vectors.T + ground.phases
    height = (np.cos(phases) @ ground.amplitudes).reshape(grid.shape)
    slope_in_world = -(np.sin(phases) * ground.amplitudes) @ ground.wave_vectors
    slope = T_world_map.inverse().rotate(slope_in_world).reshape(*grid.shape, 2)
    known = np.broadcast_to(variance, grid.shape).copy()
    return GradientMap(grid, height, known, slope, SIGNAL_STD, length_scale)


def look(ground: Ground, T_world_submap: SE2, seed: int, name: str = "look") -> Submap:
    """See a disc of 5 m of ground from somewhere, with 2 cm of noise."""
    rng = np.random.default_rng(seed)
    local = rng.uniform(-5, 5, (6000, 2))
    local = local[np.hypot(*local.T) < 5]
    heights = ground.height(T_world_submap.apply(local)) + 0.02 * rng.standard_normal(len(local))
    return Submap.from_points(np.column_stack([local, heights]), name)
