"""The Demo tab: views, motion, full screen, and pages to take away."""

import threading
from functools import partial
from pathlib import Path
from typing import Literal, TypeAlias, get_args

import numpy as np
import viser

from app.viewer.features.demo.film import film_formats, write_film
from app.viewer.features.demo.pages import gliding, write_closure, write_world
from app.viewer.features.demo.story import Story
from app.viewer.features.desk import Cameras, Desk, Feature, ModeSwitch
from app.viewer.features.pair import PairScene
from app.viewer.features.work import Downloads, message_of, safe_name
from app.viewer.features.world import WorldTab
from app.viewer.scene.cameras import (
    BOOKMARKS,
    Animation,
    blend,
    ease,
    follow,
    orbit,
    play,
    set_view,
    top,
    view_of,
)
from app.viewer.session.jobs import Lane
from app.viewer.session.news import PairNews, PairShown, SessionState, Subject, SubmapShown
from app.viewer.session.state import NEEDS_TWO, Camera, registered
from app.viewer.widgets.actions import (
    on_choice_by,
    on_option,
    on_option_by,
    on_press,
    on_press_by,
    one_of,
)
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import GOOD
from app.viewer.widgets.status import WorkBar
from gpgrad_core.errors import InputError
from gpgrad_core.run import Progress

Playable: TypeAlias = Literal["closure", "pose graph"]

PLAYABLE: tuple[Playable, ...] = get_args(Playable)
SUBJECTS: tuple[Subject, ...] = get_args(Subject)
NO_VIEW: str = "none saved"


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
        self._desk, self._modes, self._cameras = desk, modes, cameras
        self._pair, self._world = pair, world
        self._lock = threading.Lock()
        self.shown: PairShown | None = None
        self._playing = False  # as soon as the pair is shown registered
        self._views: dict[str, Camera] = {}
        gui = desk.host.gui
        subject = gui.add_button_group(
            "Show", SUBJECTS, hint="Show the two submaps chosen in Tune, or all submaps."
        )
        views = gui.add_button_group(
            "View",
            BOOKMARKS,
            hint="From above, from the side, or along the trajectory. It moves the camera of this "
            "page only.",
        )
        keep = gui.add_button("Save this view", hint="Adds the present view to the list below.")
        self._kept: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Saved views",
            (NO_VIEW,),
            initial_value=NO_VIEW,
            visible=False,  # until there is one
            hint="Go back to a saved view.",
        )
        acts = gui.add_button_group(
            "Play",
            PLAYABLE,
            hint="closure: the query glides onto the database along the estimated motion. pose "
            "graph: the submaps move from odometry to the corrected poses; optimise them in "
            "Explore first.",
        )
        present = gui.add_button(
            "Present",
            hint="Fills the screen and tells the closure in steps, over and over: apart, "
            "keypoints, lines, the query flies in, the difference fades, and the map closes if "
            "the pose graph was optimised. Space rests, the arrows go a step on or back, Esc "
            "ends.",
        )
        full = gui.add_button("Full screen", hint="Hides the panels. Press Esc to bring them back.")
        with gui.add_folder("Take it along", expand_by_default=False):
            page = gui.add_button(
                "Save page",
                hint="Saves what is shown, with its motion, as one HTML file. It opens from disk, "
                "without a server or a network.",
            )
            formats = film_formats()
            film_kind = gui.add_dropdown("Film as", tuple(formats), initial_value="GIF")
            film = gui.add_button(
                "Save film",
                hint="Saves the steps of the pair, from apart to the difference that fades, as "
                "this page shows them. Keep its window in front meanwhile. MP4 needs ffmpeg.",
            )
        self._bar = WorkBar(desk.host, "Cancel page", "demo", starts=(page, film), done_color=GOOD)
        on_option(subject, lambda label: modes.turn_to(one_of(SUBJECTS, label)))
        on_option_by(views, self._fly)
        on_press_by(keep, self._keep)
        on_choice_by(self._kept, self._fly)
        on_press(full, lambda: modes.set_full_screen(True))
        on_press_by(page, self._order)

        @acts.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            self._play(event.client, one_of(PLAYABLE, event.target.value))

        def fail(error: Exception) -> None:
            self._bar.failed(message_of(error))

        self._player, self._pilot = (
            Lane[Animation, None](
                desk.jobs, play, lambda _a, _n, _s: None, lambda _, error: fail(error)
            )
            for _ in ("closure", "camera")
        )
        self._downloads = Downloads(desk.jobs, self._bar, desk.capacity.long)
        self.story = Story(desk, pair, world, modes, cameras, lambda: self.shown, fail)
        on_press(present, self._present)
        on_press_by(film, lambda client: self._film(client, formats[film_kind.value]))

    def add_commands(self, commands: Commands) -> None:
        """Add what the keyboard does while a story is told; scripts hear the arrows."""
        for label, act, key in (
            ("Present", self._present, None),
            ("Rest, or go on", self.story.rest, "space"),
            ("Next step", lambda: self.story.turn(1), "pagedown"),
            ("Step before", lambda: self.story.turn(-1), "pageup"),
        ):
            commands.add("Demo", label, act, key=key)

    def _film(self, client: viser.ClientHandle, ending: str) -> None:
        state = self._desk.state
        name = safe_name(f"{state.dataset.name}_{state.query_id}_{state.database_id}", "film")

        is_dark = self._desk.canvases.is_dark(client)

        def write(path: Path, progress: Progress) -> None:
            write_film(self.story, client, is_dark, path, progress)

        self._downloads.order(client, f"{name}{ending}", write)

    def _present(self) -> None:
        try:
            self.story.begin()
        except InputError as error:
            self._bar.failed(str(error))

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """End the story when the panels are back."""
        if before.full_screen and not state.full_screen:
            self.story.end()

    def on_pair_result(self, news: PairNews) -> None:
        """Take the pair that is shown, and play it if a user asked for that; or forget it."""
        if isinstance(news, SubmapShown):
            with self._lock:
                self.shown, self._playing = None, False
        if not isinstance(news, PairShown):
            return
        with self._lock:
            self.shown = news
            playing = self._playing and news.state.options.layout == "registered"
            self._playing = self._playing and not playing
        if playing:
            draw = self._pair.gliding(*news)
            if draw is None:
                self._bar.failed("No motion was found for this pair.")
                return
            self._bar.idle()
            self._player.submit(gliding(draw))

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

            self._pilot.submit(Animation(12.0, draw))
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
            Animation(1.2, lambda share: set_view(client, blend(start, camera, ease(share))))
        )

    def _keep(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._views[f"view {len(self._views) + 1}"] = view_of(client)
            names = tuple(self._views)
        self._kept.options = names
        self._kept.value = names[-1]
        self._kept.visible = True

    def _whole(self, page: viser.ClientHandle) -> Camera | None:
        canvas = self._desk.canvases.of(page)
        if self._world.scene.visible:
            return self._world.scene.camera(canvas)
        return self._pair.camera(self._desk.state, canvas)

    # Pages.

    def _order(self, client: viser.ClientHandle) -> None:
        shown, world = self.shown, self._world.world
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
