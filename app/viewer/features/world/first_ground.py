"""The ground of the submaps that are there, before there is a session that shows more."""

import time

import viser

from app.viewer.features.world.model import World
from app.viewer.features.world.scene import WorldScene
from app.viewer.features.world.submaps import Terrain, WorldOptions, first_surface
from app.viewer.scene.cameras import set_start, set_view
from app.viewer.server.host import pages
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Dataset, Submap


class Pace:
    """Says when to show what grows, so that showing takes a small part of the time."""

    RESTS_FOR, LEAST = 6.0, 0.3
    """Pause after a showing: so many times as long as that took, and at least so long [s]."""

    def __init__(self) -> None:
        self._due = self._began = 0.0

    @property
    def is_due(self) -> bool:
        """Whether to show now; `rest` ends the showing."""
        self._began = time.monotonic()
        return self._began >= self._due

    def rest(self) -> None:
        now = time.monotonic()
        self._due = now + max(self.LEAST, self.RESTS_FOR * (now - self._began))


class FirstGround:
    """Shows submaps straight from their points, until the session's map takes its place."""

    def __init__(self, server: viser.ViserServer, memo: Memo) -> None:
        self._server, self._memo = server, memo
        self._scene = WorldScene(server, visible=True)
        self._submaps: list[Submap] = []
        self._surfaces: dict[str, Terrain] = {}
        self._pace = Pace()

    def add(self, submap: Submap) -> None:
        """Add one more submap, and show all so far if that is due."""
        self._submaps.append(submap)
        self._surfaces[submap.id] = self._memo(first_surface, submap)
        if not self._pace.is_due:
            return
        dataset = Dataset("", tuple(self._submaps))
        world = World.of(dataset, WorldOptions(trajectories=False, names=False))
        self._scene.show(world.with_surfaces(self._surfaces))
        camera = self._scene.camera()
        assert camera is not None
        set_start(self._server, camera)
        for page in pages(self._server).values():
            set_view(page, camera)
        self._pace.rest()
