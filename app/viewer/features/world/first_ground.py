"""The ground of the first submap of a drive, before there is a session that shows more."""

import viser

from app.viewer.features.world.scene import World, WorldScene
from app.viewer.features.world.submaps import pose_sources, poses_of, quick_surface
from app.viewer.scene.cameras import set_start, set_view
from app.viewer.server.host import pages
from gpgrad_core.detection import PipelineParams
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Dataset, Submap

AS_OF = 16
"""The ground is as coarse as that of one of so many submaps, so that it is there at once."""


def show_first_ground(server: viser.ViserServer, submap: Submap, memo: Memo) -> None:
    """Show a submap as the map of a drive shows its first one; that map takes its place.

    Args:
        server: Whose pages see it.
        submap: The submap; a smoothed grid stands in for its map.
        memo: Keeps the grid.
    """
    dataset = Dataset(submap.id, (submap,))
    guessed = PipelineParams(map=MapParams().guessed)  # nothing is fitted yet
    surfaces = {submap.id: quick_surface(submap, guessed, memo, AS_OF)}
    scene = WorldScene(server, visible=True)
    scene.show(World(dataset, surfaces, poses_of(dataset, pose_sources(dataset)[0]), {}))
    camera = scene.camera()
    assert camera is not None
    set_start(server, camera)
    for page in pages(server).values():
        set_view(page, camera)
