"""The Demo tab: plays closures and pose graphs, flies cameras, and writes pages to take away."""

import threading
from functools import partial

import numpy as np
import viser

from app.viewer.features.demo.pages import gliding, write_closure, write_world
from app.viewer.features.demo.panel import DemoCalls, DemoPanel, Playable
from app.viewer.features.desk import Cameras, Desk, Feature, ModeSwitch
from app.viewer.features.pair import PairScene
from app.viewer.features.work import Downloads, message_of, safe_name
from app.viewer.features.world import WorldTab
from app.viewer.scene.animation import Animation, ease, play
from app.viewer.scene.cameras import BOOKMARKS, blend, follow, orbit, set_view, top, view_of
from app.viewer.session.runner import Runner
from app.viewer.session.state import NEEDS_TWO, Camera, ViewState, registered
from gpgrad_core.detection import PairResult
from gpgrad_core.types import GradientMap

FLIGHT_SECONDS = 1.2
TOUR_SECONDS = 12.0


class DemoTab(Feature):
    """What a demonstration can do."""

    def __init__(
        self,
        desk: Desk,
        pair: PairScene,
        world: WorldTab,
        modes: ModeSwitch,
        cameras: Cameras,
    ) -> None:
        """Make the panel in the current container.

        Args:
            desk: Of the session.
            pair: The scene in which closures are played.
            world: The world.
            modes: Turn to either, and to the full screen.
            cameras: Stay where the demonstration brings them.
        """
        self._desk = desk
        self._modes = modes
        self._cameras = cameras
        self._pair = pair
        self._world = world
        self._lock = threading.Lock()
        self._shown: tuple[ViewState, PairResult] | None = None
        self._playing = False  # as soon as the pair is shown registered
        self._views: dict[str, Camera] = {}
        self._panel = DemoPanel(
            desk.host,
            BOOKMARKS,
            DemoCalls(
                on_subject=modes.turn_to,
                on_bookmark=self._fly,
                on_save_view=self._keep,
                on_play=self._play,
                on_full_screen=lambda: modes.set_full_screen(True),
                on_page=self._order,
            ),
        )
        self._bar = self._panel.work_bar
        self._player, self._pilot = (
            Runner[Animation, None](
                play, _nothing, lambda _, error: self._bar.failed(message_of(error)), name=name
            )
            for name in ("closure", "camera")
        )
        self._downloads = Downloads(self._bar, "page", desk.capacity.long)
        self.workers = (self._player, self._pilot, self._downloads)

    def show(self, state: ViewState, result: PairResult) -> None:
        """Take the pair that is shown, and play it if a user asked for that."""
        with self._lock:
            self._shown = state, result
            playing = self._playing and state.options.layout == "registered"
            self._playing = self._playing and not playing
        if playing:
            draw = self._pair.gliding(state, result)
            if draw is None:
                self._bar.failed("No motion was found for this pair.")
                return
            self._bar.idle()
            self._player.submit(gliding(draw))

    def alone(self, state: ViewState, gradient_map: GradientMap) -> None:
        """Forget the pair: there is none to play."""
        del state, gradient_map
        with self._lock:
            self._shown, self._playing = None, False

    def _play(self, client: viser.ClientHandle | None, playable: Playable) -> None:
        if playable == "pose graph":
            if self._world.graph is None:
                self._bar.failed("Optimise the pose graph in Explore first.")
                return
            self._bar.idle()
            self._modes.turn_to("world")
            self._world.relax()
            return
        if not self._desk.state.is_pair:
            self._bar.failed(NEEDS_TWO)
            return
        self._modes.turn_to("pair")
        if client is not None:
            # Both while they are apart; where they come together is in the middle of that.
            canvas = self._desk.canvases.of(client)
            self._to(client, self._pair.camera(self._desk.state, canvas, layout="side by side"))
            self._cameras.keep_cameras()
        with self._lock:
            self._playing = True
        self._desk.change(options=registered(self._desk.state.options))

    # Cameras.

    def _fly(self, client: viser.ClientHandle, name: str) -> None:
        seen = self._whole(client)
        if seen is None:
            return
        if name == "follow loop":
            path = self._world.scene.path() if self._world.scene.visible else np.zeros((0, 3))

            def draw(share: float) -> None:
                along = len(path) >= 2
                set_view(client, follow(path, share) if along else orbit(seen, ease(share)))

            self._pilot.submit(Animation(TOUR_SECONDS, draw))
            return
        with self._lock:
            views = {"top": top(seen), "oblique": seen} | self._views
        if name == "oblique":
            self._desk.canvases.expect(client, seen)
        if name in views:
            self._to(client, views[name])

    def _to(self, client: viser.ClientHandle, camera: Camera) -> None:
        start = view_of(client)
        self._pilot.submit(
            Animation(
                FLIGHT_SECONDS, lambda share: set_view(client, blend(start, camera, ease(share)))
            )
        )

    def _keep(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._views[f"view {len(self._views) + 1}"] = view_of(client)
            names = tuple(self._views)
        self._panel.offer(names)

    def _whole(self, page: viser.ClientHandle) -> Camera | None:
        """Give the view that fills a page with everything in the present scene."""
        canvas = self._desk.canvases.of(page)
        if self._world.scene.visible:
            return self._world.camera(canvas)
        return self._pair.camera(self._desk.state, canvas)

    # Pages.

    def _order(self, client: viser.ClientHandle) -> None:
        with self._lock:
            shown = self._shown
        world = self._world.world
        if self._world.scene.visible and world is not None:
            name = f"{world.dataset.name}_world"
            write = partial(write_world, world, self._world.graph)
        elif shown is not None and not self._world.scene.visible:
            state = shown[0]
            name = f"{state.dataset.name}_{state.query_id}_{state.database_id}"
            write = partial(write_closure, *shown)
        else:
            alone = not (self._world.scene.visible or self._desk.state.is_pair)
            self._bar.failed(NEEDS_TWO if alone else "Wait for the picture first.")
            return
        self._downloads.order(client, f"{safe_name(name, 'page')}.html", write)


def _nothing(job: Animation, result: None, seconds: float) -> None:
    del job, result, seconds
