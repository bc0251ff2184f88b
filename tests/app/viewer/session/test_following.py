"""A viewer that follows a robot: what comes is compared, shown, kept and told."""

import multiprocessing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gpgrad_core as gg
from app.viewer.session import following as drives
from app.viewer.session.following import Following
from app.viewer.viewer import Viewer
from gpgrad_core.detection import MapDetector
from gpgrad_core.live.server import Server
from gpgrad_core.run import silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.simulation.demo import loop_params
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.simulate import simulate_dataset
from gpgrad_core.slam import Drive, read_run
from gpgrad_core.types import Submap
from tests.support.waiting import PATIENCE, until

pytestmark = pytest.mark.slow
CHOSEN = ("000", "001", "002", "008")
PARAMS = gg.PipelineParams(
    map=gg.MapParams(length_scale=0.3, noise_std=0.05, signal_std=0.3, resolution=0.08)
)


def test_a_drive_is_followed_from_its_first_submap_to_its_record(tmp_path: Path) -> None:
    pytest.importorskip("gtsam", reason="GTSAM has no wheels for this system")
    demo = gg.load_dataset(gg.demo_path())
    record, said = tmp_path / "run.gpgrad", list[str]()
    server = Server(port=0)
    following = Following(server, PARAMS, said.append, record=record, track=tmp_path / "track.txt")
    viewer = Viewer(following.open, port=0)
    try:
        with gg.Live(f"localhost:{server.port}", patience=PATIENCE) as live:
            for k, name in enumerate(CHOSEN):
                submap = demo.submap(name)
                if name == CHOSEN[-1]:  # the comparisons outlive their processes
                    for worker in multiprocessing.active_children():
                        worker.kill()
                assert submap.pose_odometry is not None
                track = live.add(submap.points, submap.pose_odometry, id=name)
                assert list(track) == list(CHOSEN[: k + 1])
                until(lambda: viewer.sessions, "the first picture")
            closures = live.closures
        assert ("008", "001") in closures
        assert any("008 closes a loop with" in line for line in said)
        assert sum("the comparisons go on in the viewer itself" in line for line in said) == 1
        (session,) = viewer.sessions
        until(lambda: len(session.timeline.moments) == len(CHOSEN), "the last moment")
        session.desk.catch_up()
        assert [submap.id for submap in session.state.dataset.submaps] == list(CHOSEN)
        assert session.state.is_pair
        assert session.wait_idle(PATIENCE)
    finally:
        viewer.close()
        following.close()
    assert following.failure is None
    run = read_run(record)
    assert [moment.submap_id for moment in run.moments] == list(CHOSEN)
    with Drive(
        run.settings.params,
        detector=MapDetector(run.settings.params, Memo(100_000_000)),
        candidates=run.settings.candidates,
        incremental=run.settings.incremental,
    ) as drive:
        for submap in run.submaps:
            drive.add(submap)
        drive.settle()
        for again, moment in zip(drive.moments, run.moments, strict=True):
            np.testing.assert_array_equal(again.places, moment.places)
            assert [c.accepted for c in again.closures] == [c.accepted for c in moment.closures]
    rows = (tmp_path / "track.txt").read_text().splitlines()[1:]
    assert [row.split()[0] for row in rows] == ["0", "1", "2", "8"]


def test_the_rover_drives_on_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    def short(seed: int) -> SimulationParams:
        return replace(loop_params(seed), num_submaps=4, max_points=2000, rock_density=0.1)

    monkeypatch.setattr(drives, "loop_params", short)
    told, shown = list[str](), list[Submap]()

    def stage(words: str) -> object:
        told.append(words)
        return silent

    opened = drives.begin_drive(1, Memo(), stage, shown.append)  # type: ignore[arg-type]
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
