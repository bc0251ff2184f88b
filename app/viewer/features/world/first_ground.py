"""The ground of the first submap of a drive, before there is a session that shows more."""

import viser

from app.viewer.features.world.model import World
from app.viewer.features.world.scene import WorldScene
from app.viewer.features.world.submaps import WorldOptions, quick_surface
from app.viewer.scene.cameras import set_start, set_view
from app.viewer.server.host import pages
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Dataset, Submap

AS_OF = 16
"""The ground is as coarse as that of one of so many submaps, so that it is there at once."""


def show_first_ground(server: viser.ViserServer, submap: Submap, memo: Memo) -> None:
    """Show a submap as the map of a drive shows its first one; that map takes its place.

    A smoothed grid, which the memo keeps, stands in for its map.
    """
    dataset = Dataset(submap.id, (submap,))
    guessed = MapParams().guessed  # nothing is fitted yet
    surfaces = {submap.id: quick_surface(submap, guessed, AS_OF, memo=memo)}
    scene = WorldScene(server, visible=True)
    world = World.of(dataset, WorldOptions(trajectories=False))
    scene.show(world.with_surfaces(surfaces))
    camera = scene.camera()
    assert camera is not None
    set_start(server, camera)
    for page in pages(server).values():
        set_view(page, camera)
