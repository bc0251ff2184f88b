"""Demo: plays closures and pose graphs, flies cameras, and writes pages to take away."""

import re
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import degrees

import numpy as np
import viser

from app.viewer.capacity import Turns
from app.viewer.demo.page import Composed, save_page
from app.viewer.demo.panel import Act, DemoCalls, DemoPanel, Subject
from app.viewer.draw.animation import Animation, ease, play
from app.viewer.draw.cameras import BOOKMARKS, blend, follow, orbit, set_view, top, view_of
from app.viewer.draw.placement import Camera
from app.viewer.feature import Part
from app.viewer.host import Host
from app.viewer.pair.scene import PairScene
from app.viewer.runner import Runner
from app.viewer.state import ViewState, with_options
from app.viewer.world.scene import WorldScene
from app.viewer.world.tab import Explore, relaxation, world_legend
from gpgrad_core.pipeline import PairResult
from gpgrad_core.run.progress import Progress

GLIDING_SECONDS = 3.5
FLIGHT_SECONDS = 1.2
TOUR_SECONDS = 12.0


@dataclass(frozen=True, eq=False)
class _Order:
    """A page that somebody asked for."""

    client: viser.ClientHandle
    subject: Subject
    state: ViewState
    result: PairResult | None


@dataclass(frozen=True, eq=False)
class _Page:
    name: str
    content: bytes


class Demo(Part):
    """What a demonstration can do; the session tells it what is shown."""

    def __init__(
        self,
        host: Host,
        state: ViewState,
        turns: Turns,
        pair: PairScene,
        explore: Explore,
        *,
        on_subject: Callable[[Subject], None],
        on_registered: Callable[[], None],
        on_full_screen: Callable[[], None],
        message_of: Callable[[Exception], str],
    ) -> None:
        """Make the panel in the current container.

        Args:
            host: Whose GUI it joins.
            state: The session as it is.
            turns: Held while a page is written.
            pair: The scene in which closures are played.
            explore: The world.
            on_subject: Given what is to be seen.
            on_registered: Called when the pair is to be shown registered.
            on_full_screen: Called when the panels are to go away.
            message_of: Says what went wrong in one line.
        """
        self._pair = pair
        self._explore = explore
        self._on_registered = on_registered
        self._on_subject = on_subject
        self._lock = threading.Lock()
        self._state = state
        self._result: PairResult | None = None
        self._shown: ViewState | None = None
        self._playing = False  # as soon as the pair is shown registered
        self._views: dict[str, Camera] = {}
        self._panel = DemoPanel(
            host,
            BOOKMARKS,
            DemoCalls(
                on_subject=on_subject,
                on_bookmark=self._fly,
                on_save_view=self._keep,
                on_play=self._play,
                on_full_screen=on_full_screen,
                on_page=self._order,
                on_cancel=self._cancel,
            ),
        )

        def failed(job: object, error: Exception) -> None:
            del job
            self._panel.stopped(message_of(error), bad=True)

        self._player: Runner[Animation, None] = Runner(play, _nothing, failed, name="closure")
        self._pilot: Runner[Animation, None] = Runner(play, _nothing, failed, name="camera")
        self._writer: Runner[_Order, _Page] = Runner(
            self._write,
            self._hand_over,
            failed,
            on_cancel=lambda order: self._panel.stopped("Cancelled."),  # noqa: ARG005
            turns=turns.long,
            name="page",
        )

    def follow(self, state: ViewState) -> None:
        """Follow the session."""
        with self._lock:
            self._state = state

    def show(self, state: ViewState, result: PairResult) -> None:
        """Take what is shown; play it if that was asked for."""
        with self._lock:
            self._shown, self._result = state, result
            playing = self._playing and state.options.layout == "registered"
            self._playing = self._playing and not playing
        if playing:
            draw = self._pair.gliding(state, result)
            if draw is None:
                self._panel.stopped("No motion was found for this pair.", bad=True)
                return
            self._panel.stopped()
            self._player.submit(gliding(draw))

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nothing moves; says whether that came true within the timeout [s]."""
        workers = (self._player, self._pilot, self._writer)
        return all(worker.wait_idle(timeout) for worker in workers)

    def close(self) -> None:
        """Stop."""
        for worker in (self._player, self._pilot, self._writer):
            worker.close()

    def _play(self, client: viser.ClientHandle | None, act: Act) -> None:
        if act == "pose graph":
            if self._explore.graph is None:
                self._panel.stopped("Optimise the pose graph first, in Explore.", bad=True)
                return
            self._panel.stopped()
            self._on_subject("world")
            self._explore.relax()
            return
        self._on_subject("pair")
        if client is not None:
            self._to(client, self._pair.camera(self._state))
        with self._lock:
            self._playing = True
        self._on_registered()

    # Cameras.

    def _fly(self, client: viser.ClientHandle | None, name: str) -> None:
        if client is None:
            return
        seen = self._whole()
        if seen is None:
            return
        if name == "follow loop":
            path = self._explore.scene.path() if self._explore.scene.visible else np.zeros((0, 3))

            def draw(share: float) -> None:
                along = len(path) >= 2
                set_view(client, follow(path, share) if along else orbit(seen, ease(share)))

            self._pilot.submit(Animation(TOUR_SECONDS, draw))
            return
        with self._lock:
            views = {"top": top(seen), "oblique": seen} | self._views
        if name in views:
            self._to(client, views[name])

    def _to(self, client: viser.ClientHandle, camera: Camera) -> None:
        start = view_of(client)
        self._pilot.submit(
            Animation(
                FLIGHT_SECONDS, lambda share: set_view(client, blend(start, camera, ease(share)))
            )
        )

    def _keep(self, client: viser.ClientHandle | None) -> None:
        if client is None:
            return
        with self._lock:
            self._views[f"view {len(self._views) + 1}"] = view_of(client)
            names = tuple(self._views)
        self._panel.offer(names)

    def _whole(self) -> Camera | None:
        """Give the view that shows all of what is seen now."""
        if self._explore.scene.visible:
            return self._explore.camera()
        return self._pair.camera(self._state)

    # Pages.

    def _order(self, client: viser.ClientHandle | None) -> None:
        if client is None:
            return
        subject: Subject = "world" if self._explore.scene.visible else "pair"
        with self._lock:
            order = _Order(client, subject, self._shown or self._state, self._result)
        if (order.result if subject == "pair" else self._explore.world) is None:
            self._panel.stopped("Wait until there is a picture.", bad=True)
            return
        self._panel.running(0.0)
        self._writer.submit(order)

    def _cancel(self) -> None:
        self._writer.cancel()

    def _write(self, order: _Order, progress: Progress) -> _Page:
        def report(fraction: float) -> None:
            progress(fraction)
            self._panel.running(fraction)

        if order.subject == "world":
            return _world_page(self._explore, report)
        assert order.result is not None
        return _closure_page(order.state, order.result, report)

    def _hand_over(self, order: _Order, page: _Page, seconds: float) -> None:
        order.client.send_file_download(page.name, page.content, save_immediately=True)
        size = len(page.content) / 1e6
        self._panel.stopped(f"{page.name}: {size:.1f} MB, written in {seconds:.1f} s.")


def gliding(draw: Callable[[float], None]) -> Animation:
    """Let a query glide into place."""
    return Animation(GLIDING_SECONDS, lambda share: draw(ease(share)), rest=1.5)


def _closure_page(state: ViewState, result: PairResult, progress: Progress) -> _Page:
    registered = with_options(state, replace(state.options, layout="registered", compare="both"))

    def compose(server: viser.ViserServer) -> Composed:
        scene = PairScene(server)
        shown = scene.show(registered, result)
        draw = scene.gliding(registered, result)
        moving = None if draw is None else gliding(draw)
        return Composed(scene.camera(state), world_legend(shown.scale), moving)

    title = f"{state.dataset.name}: submap {state.query_id} onto {state.database_id}"
    content = save_page(
        compose,
        title=title,
        caption=_verdict(result),
        progress=progress,
    )
    return _Page(_file_name(state, f"{state.query_id}_{state.database_id}"), content)


def _world_page(explore: Explore, progress: Progress) -> _Page:
    world = explore.world
    assert world is not None
    graph = explore.graph if world.options.poses == "corrected" else None

    def compose(server: viser.ViserServer) -> Composed:
        scene = WorldScene(server, visible=True)
        scale = scene.show(world)
        camera = scene.camera()
        assert camera is not None
        moving = None if graph is None else relaxation(graph, scene.mover())
        return Composed(camera, world_legend(scale), moving)

    count = len(world.poses)
    words = {
        "odometry": "as odometry has them",
        "true": "where they truly are",
        "in rows": "in rows, for they have no poses",
        "corrected": "moving from odometry to the corrected poses",
    }
    content = save_page(
        compose,
        title=f"{world.dataset.name}: {count} submaps",
        caption=f"All submaps {words[world.options.poses]}; coloured by {world.options.color}.",
        progress=progress,
    )
    return _Page(_safe(f"{world.dataset.name}_world.html"), content)


def _verdict(result: PairResult) -> str:
    """Say in one line what was found."""
    registration = result.registration
    verdict = "Loop closure" if result.closure.accepted else "No loop closure"
    motion = registration.T_database_query
    if motion is None:
        return f"{verdict}: no motion found."
    return (
        f"{verdict}: {registration.num_inliers} inliers, score {registration.score:.2f}; "
        f"offset {motion.x:+.2f} m, {motion.y:+.2f} m, turn {degrees(motion.yaw):+.1f}°."
    )


def _file_name(state: ViewState, what: str) -> str:
    return _safe(f"{state.dataset.name}_{what}.html")


def _safe(name: str) -> str:
    """Keep of a name what every file system takes."""
    return re.sub(r"[^\w.-]+", "_", name).strip("._") or "page.html"


def _nothing(job: Animation, result: None, seconds: float) -> None:
    del job, result, seconds
