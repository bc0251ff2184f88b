"""A simulated drive, which goes on by itself."""

from dataclasses import replace

import pytest

from app.viewer.session import simulated
from gpgrad_core.run import silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.simulation.demo import loop_params
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.simulate import simulate_dataset
from gpgrad_core.slam import Drive
from gpgrad_core.types import Submap
from tests.support.waiting import until


@pytest.mark.slow
def test_the_rover_drives_on_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    def short(seed: int) -> SimulationParams:
        return replace(loop_params(seed), num_submaps=4, max_points=2000, rock_density=0.1)

    monkeypatch.setattr(simulated, "loop_params", short)
    told, shown = list[str](), list[Submap]()

    def stage(words: str) -> object:
        told.append(words)
        return silent

    opened = simulated.begin_drive(1, Memo(), stage, shown.append)  # type: ignore[arg-type]
    drive = opened.drive
    assert isinstance(drive, Drive)
    assert [submap.id for submap in opened.dataset.submaps] == ["000"]
    assert [submap.id for submap in shown] == ["000"]
    assert told == ["Making the ground", "Looking at the first of it"]
    until(lambda: drive.finished, "the end of the drive")
    # What is driven live is what gpgrad simulate makes of the same parameters.
    whole = simulate_dataset(short(1))
    assert [s.fingerprint for s in drive.submaps] == [s.fingerprint for s in whole.submaps]
    for live, made in zip(drive.submaps, whole.submaps, strict=True):
        assert live.pose_odometry is not None
        assert made.pose_odometry is not None
        assert (live.pose_odometry.translation == made.pose_odometry.translation).all()
    assert [moment.number for moment in drive.moments] == [0, 1, 2, 3]
