from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.viewer.features.world.submaps import figures_of, pose_sources, poses_of
from app.viewer.scene.animation import Animation, ease, frames, play
from gpgrad_core.run.progress import Cancelled
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Dataset, Submap
from tests.support.synthetic import make_dataset

DATASET = make_dataset()


def posed(x: float, yaw: float = 0.0) -> Pose:
    return Pose(np.array([x, 0.0, 0.0]), np.array([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)]))


def without_poses() -> Dataset:
    return replace(
        DATASET, submaps=tuple(replace(submap, pose_odometry=None) for submap in DATASET.submaps)
    )


def test_poses_come_from_what_there_is() -> None:
    corrected = {"000": posed(0.0)}
    assert pose_sources(DATASET) == ("odometry",)
    assert pose_sources(DATASET, corrected) == ("odometry", "corrected")
    assert list(poses_of(DATASET, "odometry")) == ["000", "001", "002", "003"]
    assert poses_of(DATASET, "corrected", corrected) == corrected
    assert poses_of(DATASET, "true") == {}


def test_submaps_without_poses_lie_beside_each_other() -> None:
    dataset = without_poses()
    assert pose_sources(dataset) == ("in rows",)
    poses = poses_of(dataset, "in rows")
    boxes = [
        (low, high)
        for submap in dataset.submaps
        for points in (poses[submap.id].apply(submap.points)[:, :2],)
        for low, high in ((points.min(axis=0), points.max(axis=0)),)
    ]
    for k, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[:k]:
            assert (low >= other_high).any() or (high <= other_low).any()


def test_figures_are_those_of_a_known_cloud() -> None:
    x, y = np.meshgrid(np.arange(0.0, 4.0, 0.1), np.arange(0.0, 2.0, 0.1))
    points = np.column_stack([x.ravel() + 0.05, y.ravel() + 0.05, np.zeros(x.size)])
    points[: len(points) // 2, 2] = 0.5
    cloud = Submap.from_points(points, pose_true=posed(1.0), pose_odometry=posed(1.3, 0.1))
    assert dict(figures_of(cloud)) == {
        "points": "800",
        "extent": "3.9 m x 1.9 m, 0.50 m high",
        "ground seen": "8.0 m²",
        "density": "100 points/m²",
        "height std": "0.250 m",
        "true pose": "1.00, 0.00, 0.00 m; +0.0°",
        "odometry": "1.30, 0.00, 0.00 m; +5.7°",
        "odometry off by": "0.30 m",
    }
    bare = dict(figures_of(replace(cloud, pose_true=None), posed(1.0)))
    assert [name for name in bare if "off by" in name or "pose" in name] == []
    assert bare["corrected"] == "1.00, 0.00, 0.00 m; +0.0°"


def test_an_animation_ends_on_its_last_moment() -> None:
    drawn: list[float] = []
    play(Animation(0.1, drawn.append))
    assert drawn == sorted(drawn)
    assert drawn[-1] == 1.0


def test_frames_of_a_page_rest_at_both_ends() -> None:
    drawn: list[float] = []
    seconds = list(frames(Animation(1.0, drawn.append, rest=2.0)))
    assert (drawn[0], drawn[-1]) == (0.0, 1.0)
    assert seconds[0] == seconds[-1] == pytest.approx(2.0 + seconds[1])
    assert sum(seconds) == pytest.approx(5.0, abs=0.1)


def test_playing_can_be_stopped() -> None:
    def stop(fraction: float) -> None:  # noqa: ARG001
        raise Cancelled

    drawn: list[float] = []
    with pytest.raises(Cancelled):
        play(Animation(1.0, drawn.append), stop)
    assert drawn == []


@given(share=st.floats(0.0, 1.0))
def test_ease_is_monotone_between_its_ends(share: float) -> None:
    assert 0.0 <= ease(share) <= 1.0
    assert ease(share) == pytest.approx(1.0 - ease(1.0 - share))
