"""Pictures of synthetic ground, as a camera of a rover takes them."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from gpgrad_core.arrays import Array, NDArray

CELL = 0.02
"""Side of a cell of the ground [m]."""
SIZE = (320, 240)
"""Width and height of a picture [pixels]."""
FIELD = np.radians(70.0)
"""Horizontal field of view."""
DOWN = np.radians(30.0)
"""How far the camera looks down from the horizon."""
ABOVE = 1.2
"""Height of the camera over the ground [m]."""


@dataclass(frozen=True, eq=False)
class Scenery:
    """Ground with relief and shades of its own, the same kind everywhere."""

    height: Array  # (n, n) [m]
    shade: Array  # (n, n), in 0 to 1

    @classmethod
    def random(cls, seed: int, *, pebbles: int = 1500, side: float = 12.0) -> "Scenery":
        rng = np.random.default_rng(seed)
        count = int(side / CELL)
        waves = [
            gaussian_filter(rng.standard_normal((count, count)), sigma, mode="wrap") * sigma
            for sigma in (2, 8, 32)
        ]
        height = 0.004 * waves[0] + 0.008 * waves[1] + 0.015 * waves[2]
        shade = 0.45 + 0.10 * waves[0] + 0.06 * waves[1]
        x, y = np.meshgrid(np.arange(-9, 10), np.arange(-9, 10))
        for _ in range(pebbles):
            row, column = rng.integers(9, count - 10, 2)
            radius = rng.uniform(1.0, 5.0)
            bump = np.clip(1.0 - (x**2 + y**2) / radius**2, 0.0, 1.0)
            place = (slice(row - 9, row + 10), slice(column - 9, column + 10))
            height[place] += CELL * radius * np.sqrt(bump)
            shade[place] = np.where(bump > 0, rng.uniform(0.15, 0.9), shade[place])
        return cls(height, shade)

    def lit(self, azimuth: float, elevation: float = np.radians(35.0)) -> Array:
        """Brightness of the ground under a sun that casts no shadows."""
        slope_y, slope_x = np.gradient(self.height, CELL)
        sun = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
        towards = np.sin(elevation) - slope_x * sun[0] - slope_y * sun[1]
        return self.shade * np.clip(towards / np.sqrt(1 + slope_x**2 + slope_y**2), 0.05, 1.0)

    def seen(
        self, x: float, y: float, yaw: float, *, seed: int = 0, noise: float = 2.0, sun: float = 0.5
    ) -> NDArray[np.uint8]:
        """Take a picture from a place [m] towards a heading [rad]."""
        width, rows = SIZE
        focal = 0.5 * width / np.tan(0.5 * FIELD)
        u, v = np.meshgrid(np.arange(width) - width / 2, np.arange(rows) - rows / 2)
        ahead = np.cos(DOWN) * focal - np.sin(DOWN) * v
        drop = np.sin(DOWN) * focal + np.cos(DOWN) * v
        c, s = np.cos(yaw), np.sin(yaw)
        along_x, along_y = c * ahead + s * u, s * ahead - c * u
        eye = self._at(self.height, np.array([x]), np.array([y]))[0] + ABOVE
        reach = np.where(drop > 0, ABOVE / np.maximum(drop, 1e-6), 0.0)
        for _ in range(12):  # walk along each ray to the ground
            z = self._at(self.height, x + reach * along_x, y + reach * along_y)
            reach = np.where(drop > 0, (eye - z) / np.maximum(drop, 1e-6), 0.0)
        picture = self._at(self.lit(sun), x + reach * along_x, y + reach * along_y)
        picture[drop <= 0] = 0.9
        rng = np.random.default_rng(seed)
        grey = 255.0 * picture + noise * rng.standard_normal(picture.shape)
        return np.clip(grey, 0, 255).astype(np.uint8)

    def _at(self, field: Array, x: Array, y: Array) -> Array:
        return np.asarray(map_coordinates(field, [y / CELL, x / CELL], order=1, mode="grid-wrap"))
