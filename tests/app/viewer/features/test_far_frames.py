"""What a session shows does not depend on where the submaps' frames lie."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import viser
from scipy.spatial.transform import Rotation

from app.viewer.features.session import Session
from app.viewer.session.runner import Capacity
from app.viewer.session.session_file import Opened
from gpgrad_core import demo_path, load_dataset
from gpgrad_core.detection import PipelineParams
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from tests.support.frames import SHIFTS, UTM, in_frame
from tests.support.server import started_server
from tests.support.widgets import find, node, said, user_sets

QUICK = PipelineParams(
    map=MapParams(length_scale=0.5, noise_std=0.04, max_points=1500, resolution=0.2)
)
FRAMES = {"near": SE2(), "60 m": SHIFTS[0], "UTM": UTM, "turned": SE2(UTM.x, UTM.y, 1.3)}
MOVED = ("/pair/query", "/pair/database", *(f"/world/submaps/{k}" for k in range(4)))
TRACKS = ("/world/trajectories/odometry", "/world/trajectories/true")
LINES = (*TRACKS, "/world/trajectories/corrected", "/world/ellipses", "/world/outlines")
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
def walk(frame: str) -> tuple[Shown, Shown]:
    """Look at the map by odometry; and at a pair, and at the map halfway to the corrected one."""
    whole = load_dataset(demo_path())
    some = tuple(whole.submap(name) for name in ("000", "001", "002", "007"))
    dataset = in_frame(replace(whole, submaps=some), FRAMES[frame])
    with started_server() as server:
        session = Session(server, Opened(dataset, QUICK, "", None, QUICK), Memo(), Capacity())

        def after(label: str, value: object = True) -> None:
            user_sets(find(server, label), value)
            assert session.wait_idle(120)

        try:
            after("Mode", "Tune")
            words = {name: told(server, name) for name in ("card", "figures")}
            places = {name: in_scene(server, name) for name in MOVED[:2]}
            places["lines"] = node(server, "/pair/matches/inliers").points.copy()
            after("Mode", "Explore")
            first = (
                {"figures": told(server, "world-figures")},
                {name: node(server, name).points.copy() for name in TRACKS},
            )
            after("Find closures")
            after("Optimise")
            words |= {name: told(server, name) for name in ("graph-result", "world-figures")}
            after("Before → after", 0.5)
            places |= {name: in_scene(server, name) for name in MOVED[2:]}
            places |= {name: node(server, name).points.copy() for name in LINES}
            return first, (words, places)
        finally:
            session.close()


def check_same(near: Shown, far: Shown) -> None:
    assert far[0] == near[0]
    for name, places in near[1].items():
        np.testing.assert_allclose(far[1][name], places, atol=0.001, err_msg=name)


@pytest.mark.parametrize("frame", ["60 m", "UTM"])
def test_it_does_not_matter_where_frames_lie(frame: str) -> None:
    for near, far in zip(walk("near"), walk(frame), strict=True):
        check_same(near, far)
    assert "error (ATE)" in walk(frame)[1][0]["graph-result"]


def test_it_does_not_matter_how_frames_are_turned() -> None:
    # The cells of the maps lie along the frames' axes, so the ground has other ones.
    (words, near), (others, far) = walk("near")[0], walk("turned")[0]
    sentence = re.compile(r"(track|is off by)</td><td[^>]*>([^<]*)")
    assert len(sentence.findall(words["figures"])) == 2
    assert sentence.findall(others["figures"]) == sentence.findall(words["figures"])
    for name in TRACKS:  # how high they stand depends on the width of a submap along its x
        np.testing.assert_allclose(far[name][..., :2], near[name][..., :2], atol=0.001)
