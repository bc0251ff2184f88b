"""What a session shows does not depend on where the submaps' frames lie."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import viser
from scipy.spatial.transform import Rotation

from app.viewer.features.session import Session
from app.viewer.features.world import tab as world_module
from app.viewer.features.world.scene import ELLIPSE_STDS
from app.viewer.session.jobs import Capacity
from app.viewer.session.session_file import Opened
from gpgrad_core import demo_path, load_dataset
from gpgrad_core.detection import PipelineParams
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset
from tests.support.frames import SHIFTS, UTM, in_frame
from tests.support.server import started_server
from tests.support.widgets import find, node, said, user_sets

QUICK = PipelineParams(
    map=MapParams(length_scale=0.5, noise_std=0.04, signal_std=0.2, max_points=1500, resolution=0.2)
)
FRAMES = {"near": SE2(), "60 m": SHIFTS[0], "UTM": UTM, "turned": SE2(UTM.x, UTM.y, 1.3)}
MOVED = ("/pair/query", "/pair/database", *(f"/world/submaps/{k}" for k in range(4)))
TRACKS = ("/world/trajectories/odometry", "/world/trajectories/true")
LINES = (*TRACKS, "/world/trajectories/corrected", "/world/ellipses")
Shown = tuple[dict[str, str], dict[str, np.ndarray]]
"""Words and places [m], by what they are of."""


def in_scene(server: viser.ViserServer, name: str) -> np.ndarray:
    """Give where the ground beneath a frame is (n, 3) [m]."""
    frame, points = node(server, name), node(server, f"{name}/surface").points
    assert np.abs(points).max() < 20.0  # of which float32 has a micrometre
    turn = Rotation.from_quat(frame.wxyz, scalar_first=True)
    return np.asarray(turn.apply(points) + frame.position)


def told(server: viser.ViserServer, name: str) -> str:
    """Give the text of a part, without the motion between frames and without times."""
    rows = said(server, name).split("<tr>")
    return "".join(row for row in rows if ">motion<" not in row and ">solved in<" not in row)


@cache
def ground() -> Dataset:
    """Load four submaps of the demo, of which the last is a revisit."""
    whole = load_dataset(demo_path())
    return replace(whole, submaps=tuple(map(whole.submap, ("000", "001", "002", "007"))))


class Walk:
    """A person's way through a session, whose submaps have other frames."""

    def __init__(self, server: viser.ViserServer, frame: str) -> None:
        opened = Opened(in_frame(ground(), FRAMES[frame]), QUICK, "", None, QUICK)
        self.server = server
        self.session = Session(server, opened, Memo(), Capacity())

    def uses(self, label: str, value: object = True) -> None:
        user_sets(find(self.server, label), value)
        assert self.session.wait_idle(120)

    def by_odometry(self) -> Shown:
        """Look at the map as it was driven."""
        self.uses("Mode", "Tune")  # so that the pair's full maps are made before the coarse ones
        self.uses("Mode", "Explore")
        tracks = {name: node(self.server, name).points.copy() for name in TRACKS}
        return {"figures": told(self.server, "world-figures")}, tracks

    def closed(self) -> Shown:
        """Look at a pair, and at the map halfway to the corrected one."""
        server = self.server
        self.uses("Mode", "Tune")
        words = {name: told(server, name) for name in ("card", "figures")}
        places = {name: in_scene(server, name) for name in MOVED[:2]}
        places["lines"] = node(server, "/pair/matches/inliers").points.copy()
        self.uses("Mode", "Explore")
        self.uses("Find closures")
        self.uses("Optimise")
        words |= {name: told(server, name) for name in ("graph-result", "world-figures")}
        self.uses("Before → after", 0.5)
        places |= {name: in_scene(server, name) for name in MOVED[2:]}
        places |= {name: node(server, name).points.copy() for name in LINES}
        return words, places


@contextmanager
def walk(frame: str) -> Iterator[Walk]:
    with pytest.MonkeyPatch.context() as patch, started_server() as server:
        patch.setattr(world_module, "RELAXING_SECONDS", 0.1)
        made = Walk(server, frame)
        try:
            yield made
        finally:
            made.session.close()


@pytest.fixture(scope="module")
def near() -> tuple[Shown, Shown]:
    with walk("near") as here:
        return here.by_odometry(), here.closed()


def check_same(near: Shown, far: Shown) -> None:
    assert far[0] == near[0]
    for name, places in near[1].items():
        stds = ELLIPSE_STDS if name == "/world/ellipses" else 1.0  # by how many it is drawn large
        np.testing.assert_allclose(far[1][name], places, atol=0.001 * stds, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("frame", ["60 m", "UTM"])
def test_it_does_not_matter_where_frames_lie(near: tuple[Shown, Shown], frame: str) -> None:
    with walk(frame) as there:
        check_same(near[0], there.by_odometry())
        far = there.closed()
    check_same(near[1], far)
    assert "error (ATE)" in far[0]["graph-result"]


@pytest.mark.slow
def test_it_does_not_matter_how_frames_are_turned(near: tuple[Shown, Shown]) -> None:
    # The cells of the maps lie along the frames' axes, so the ground has other ones.
    words, tracks = near[0]
    with walk("turned") as there:
        others, far = there.by_odometry()
    sentence = re.compile(r"(track|is off by)</td><td[^>]*>([^<]*)")
    assert len(sentence.findall(words["figures"])) == 2
    assert sentence.findall(others["figures"]) == sentence.findall(words["figures"])
    for name in TRACKS:  # how high they stand depends on the width of a submap along its x
        np.testing.assert_allclose(far[name][..., :2], tracks[name][..., :2], atol=0.001)
