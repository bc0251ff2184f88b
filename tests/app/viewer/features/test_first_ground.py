"""The first submap of a drive, shown before there is a session."""

import numpy as np
import viser

from app.viewer.features.world.first_ground import show_first_ground
from app.viewer.features.world.scene import WorldScene
from gpgrad_core.run.memo import Memo
from tests.support.synthetic import make_dataset
from tests.support.widgets import node


def test_it_lies_at_its_pose_and_the_map_of_the_session_takes_its_place(
    server: viser.ViserServer,
) -> None:
    submap = make_dataset().submaps[2]
    pose = submap.pose_odometry
    assert pose is not None
    start = np.array(server.initial_camera.position)
    show_first_ground(server, submap, Memo())
    assert node(server, "/world").visible
    ground = node(server, "/world/submaps/0")
    np.testing.assert_allclose(ground.position, (0, 0, 0), atol=1e-9)
    assert (np.array(server.initial_camera.position) != start).any()
    # The scene of a session has the same nodes, so nothing of the first one is left.
    WorldScene(server)
    assert not node(server, "/world").visible
