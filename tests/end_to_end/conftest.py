"""A small traverse on disk."""

import shutil
from pathlib import Path

import numpy as np
import pytest


def ground(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of a terrain of mounds and hollows, the same wherever it is asked for."""
    rng = np.random.default_rng(5)
    z = np.zeros_like(x)
    for _ in range(600):
        cx, cy = rng.uniform(-5, 20, 2)
        width, height = rng.uniform(0.25, 0.6), rng.normal(0, 0.25)
        z += height * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * width**2))
    return z


def patch(x: float, y: float, yaw: float, *, seed: int, side: float = 7.0) -> np.ndarray:
    """Points of the ground around a pose, in its own frame."""
    rng = np.random.default_rng(seed)
    local = rng.uniform(-side / 2, side / 2, (5000, 2))
    c, s = np.cos(yaw), np.sin(yaw)
    world = local @ np.array([[c, s], [-s, c]]) + [x, y]
    z = ground(world[:, 0], world[:, 1]) + rng.normal(0, 0.01, len(local))
    return np.column_stack([local, z])


ABOUT = """name = "small traverse"
[preferred.map]
resolution = 0.06
length_scale = 0.25
noise_std = 0.02
scale = 0.2
"""
"""Its numbers are given, so that nothing need be fitted."""
POSES = [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (15.0, 10.0, 1.5), (0.5, 0.4, 3.0)]
"""The last lies on the first, turned about; the others overlap with nothing."""


@pytest.fixture(scope="session")
def traverse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of four submaps whose last closes a loop with its first."""
    folder = tmp_path_factory.mktemp("data") / "traverse"
    (folder / "submaps").mkdir(parents=True)
    rows = []
    for index, (x, y, yaw) in enumerate(POSES):
        points = patch(x, y, yaw, seed=index)
        np.savetxt(folder / "submaps" / f"{index:03d}.xyz", points, fmt="%.4f")
        rows.append(f"{index} {x} {y} 0 0 0 {np.sin(yaw / 2):.9f} {np.cos(yaw / 2):.9f}")
    (folder / "poses_odom.txt").write_text("\n".join(rows) + "\n")
    (folder / "dataset.toml").write_text(ABOUT)
    return folder


@pytest.fixture(scope="session")
def with_truth(traverse: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same dataset, with its truth."""
    folder = shutil.copytree(traverse, tmp_path_factory.mktemp("truth") / "traverse")
    shutil.copy(folder / "poses_odom.txt", folder / "poses_gt.txt")
    return folder
