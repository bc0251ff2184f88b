"""How far the uncertainty of maps and of closures can be believed.

Ten minutes.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float

import gpgrad_core as gg
from gpgrad_core.arrays import Array
from gpgrad_core.evaluation import calibrate, describe_calibration
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.se2 import SE2
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.simulate import simulate_dataset
from gpgrad_core.types import Dataset, Registration
from tests.long.quality.degraded import load_degraded
from tests.long.quality.test_hard_ground import HILLS, KINDS, detect
from tests.long.quality.test_noise import LIDAR, ROUGH, SMOOTH

REAL = ("marsyard2021", "sthelens", "apollo15", "hillside", "ridges")
SIMULATED: dict[str, SimulationParams] = {
    "rough": replace(ROUGH, num_submaps=16),
    "smooth": replace(SMOOTH, num_submaps=16),
    "LiDAR": replace(LIDAR, num_submaps=16),
    "hills": replace(HILLS, scan_density=30.0),
    "smaller rover": SimulationParams(seed=31, num_submaps=20),
}


@pytest.mark.parametrize("name", ["marsyard2021", "sthelens", "apollo15"])
def test_measured_noise_is_honest_and_tells_more(name: str, real_data: Path) -> None:
    found = calibrate(load_dataset(real_data / name))
    print(f"\n{name}\n{describe_calibration(found).text}")
    judged = {one.name: one for one in found}
    measured, fitted = judged["measured noise"], judged["measured noise, fitted"]
    assert fitted.within_68 == pytest.approx(0.6827, abs=0.03)
    assert fitted.within_95 == pytest.approx(0.95, abs=0.03)
    assert measured.density < judged["constant noise"].density
    assert fitted.density < judged["constant noise, fitted"].density
    # A fit tells unseen points better than where it started.
    assert judged["constant noise, fitted"].density < judged["constant noise"].density


WORST_68, WORST_95 = 0.40, 0.45
"""Least share of a single set's closures; some sets have only 15 to 20."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of right closures, over what is claimed of them.

    Attributes:
        squared: Squared Mahalanobis error of x, y and yaw (n,).
        height: Error of the height in standard deviations (n,).
    """

    squared: Float[Array, "n"]
    height: Float[Array, "n"]

    @property
    def shares(self) -> tuple[float, float, float, float]:
        """Shares within the 68 % and the 95 % ellipse, and of the heights within 1 and 1.96."""
        return (
            float(np.mean(self.squared < 3.506)),
            float(np.mean(self.squared < 7.815)),
            float(np.mean(self.height < 1)),
            float(np.mean(self.height < 1.96)),
        )


def squared_error(registration: Registration, true: SE2) -> float:
    """Compute the squared Mahalanobis error of x, y and yaw, all at the query's origin."""
    motion = registration.T_database_query
    assert motion is not None
    turn = (true.inverse() @ motion).yaw
    error = np.array([motion.x - true.x, motion.y - true.y, turn])
    return float(error @ np.linalg.solve(registration.covariance_at(np.zeros(2)), error))


def errors_of(dataset: Dataset) -> Errors:
    """Compare the accepted closures whose motion is right (0.5 m, 5 degrees) with the truth."""
    submaps = {submap.id: submap for submap in dataset.submaps}
    squared: list[float] = []
    height: list[float] = []
    for closure in detect(dataset).closures:
        said, motion = closure.registration, closure.registration.T_database_query
        if not closure.accepted:
            continue
        query, database = (
            submaps[closure.query_id].pose_true,
            submaps[closure.database_id].pose_true,
        )
        assert motion is not None
        assert said.z_std is not None
        assert query is not None
        assert database is not None
        true = database.planar.inverse() @ query.planar
        left = true.inverse() @ motion
        if np.hypot(left.x, left.y) > 0.5 or abs(left.yaw) > np.radians(5):
            continue
        squared.append(squared_error(said, true))
        rise = float((database.inverse() @ query).translation[2])
        height.append(abs(said.z_offset - rise) / said.z_std)
    return Errors(np.array(squared), np.array(height))


def test_closures_are_as_certain_as_they_say(real_data: Path) -> None:
    folders = {name: real_data / name for name in REAL} | {"demo": gg.demo_path()}
    sets = {
        f"{name}, {kind}": load_degraded(folder, *how)
        for name, folder in folders.items()
        for kind, how in KINDS.items()
        if (name, kind) != ("demo", "noisy")
    }
    sets |= {name: load_dataset(real_data / "real_scans" / name) for name in ("marv", "tradr")}
    sets |= {name: simulate_dataset(params) for name, params in SIMULATED.items()}
    each: list[Errors] = []
    for name, dataset in sets.items():
        each.append(errors_of(dataset))
        tell(name, each[-1])
    together = Errors(
        np.concatenate([errors.squared for errors in each]),
        np.concatenate([errors.height for errors in each]),
    )
    tell("together", together)
    for errors in each:
        in_68, in_95, *_ = errors.shares
        assert in_68 >= WORST_68
        assert in_95 >= WORST_95
    in_68, in_95, height_68, height_95 = together.shares
    assert 0.60 <= in_68 <= 0.76
    assert 0.91 <= in_95 <= 0.98
    assert 0.60 <= height_68 <= 0.76
    assert 0.91 <= height_95 <= 0.98


def tell(name: str, errors: Errors) -> None:
    in_68, in_95, height_68, height_95 = errors.shares
    print(
        f"{name:24} {len(errors.squared):4} right; x, y, yaw: {in_68:4.0%} in the 68 % ellipse, "
        f"{in_95:4.0%} in the 95 % one; height: {height_68:4.0%}, {height_95:4.0%}; squared "
        f"Mahalanobis / 3 {np.mean(errors.squared) / 3:.2f}",
        flush=True,
    )
