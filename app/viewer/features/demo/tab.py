"""The Demo tab: views, motion, full screen, and pages to take away."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import viser

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
from app.viewer.session.session_file import MOST_KEYFRAMES, MOST_LETTERS, Keyframe
from app.viewer.session.state import NEEDS_TWO, Camera
from app.viewer.widgets.actions import (
    on_choice,
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

Playable: TypeAlias = Literal["closure", "pose graph"]

PLAYABLE: tuple[Playable, ...] = get_args(Playable)
SUBJECTS: tuple[Subject, ...] = get_args(Subject)
FILMS = {"MP4": ".mp4", "WebM": ".webm", "GIF": ".gif"}
"""Ending by format. MP4 is of the kind that every page plays where ffmpeg is installed."""
SLIDES = {"PDF": ".pdf", "PNG": ".zip"}
NO_STEPS: tuple[str, ...] = ("1",)
ADD, EARLIER, LATER, REMOVE = EDITS = ("Add this view", "Earlier", "Later", "Remove")
"""What the list of steps offers."""


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
        self._desk, self._modes = desk, modes
        self._pair, self._world = pair, world
        self.shown: PairShown | None = None
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
        acts = gui.add_button_group(
            "Play",
            PLAYABLE,
            hint="closure: the query glides onto the database along the estimated motion. pose "
            "graph: the submaps move from odometry to the corrected poses; optimise them in "
            "Explore first.",
        )
        present = gui.add_button(
            "Present",
            hint="Fills the screen and tells the steps below, over and over. Space rests, the "
            "arrows go a step on or back, Esc ends.",
        )
        with gui.add_folder("Steps", expand_by_default=False):
            self._step: viser.GuiDropdownHandle[str] = gui.add_dropdown(
                "Step",
                NO_STEPS,
                hint="What Present, film and slides show, in turn. They begin as the story of the "
                "pair, and are saved with the session. Choose one to see it.",
            )
            self._title = gui.add_text("Title", "")
            self._line = gui.add_text("Words", "", hint="The line below the title.")
            edits = gui.add_button_group(
                "Edit", EDITS, hint="Adds what this page shows, moves the step, or removes it."
            )
        full = gui.add_button("Full screen", hint="Hides the panels. Press Esc to bring them back.")
        with gui.add_folder("Take it along", expand_by_default=False):
            page = gui.add_button(
                "Save page",
                hint="Saves the steps, or the map while that is shown, as one HTML file. It opens "
                "from disk, without a server or a network.",
            )
            film_kind = gui.add_dropdown("Film as", tuple(FILMS), initial_value="MP4")
            film = gui.add_button("Save film", hint="Saves the steps of the pair as a film.")
            slide_kind = gui.add_dropdown("Slides as", tuple(SLIDES), initial_value="PDF")
            slides = gui.add_button("Save slides", hint="Saves a slide for each step of the pair.")
        self._bar = WorkBar(
            desk.host, "Cancel page", "demo", starts=(page, film, slides), done_color=GOOD
        )
        on_option(subject, lambda label: modes.turn_to(one_of(SUBJECTS, label)))
        on_option_by(views, self._fly)
        on_choice_by(self._step, self._show_step)
        on_choice(self._title, lambda text: self._rename(title=text))
        on_choice(self._line, lambda text: self._rename(line=text))
        on_option_by(edits, self._edit)
        on_press(full, lambda: modes.set_full_screen(True))
        on_press_by(page, self._order)
        on_option(acts, lambda label: self._play(one_of(PLAYABLE, label)))

        def fail(error: Exception) -> None:
            self._bar.failed(message_of(error))

        self._pilot = Lane[Animation, None](
            desk.jobs, play, lambda _a, _n, _s: None, lambda _, error: fail(error)
        )
        self._downloads = Downloads(desk.jobs, self._bar, desk.capacity.long)
        self.story = Story(desk, pair, world, modes, cameras, lambda: self.shown, fail)
        on_press(present, self._present)
        on_press_by(film, lambda client: self._take(client, FILMS[film_kind.value]))
        on_press_by(slides, lambda client: self._take(client, SLIDES[slide_kind.value]))

    def add_commands(self, commands: Commands) -> None:
        """Add what the keyboard does while a story is shown; scripts handle the arrows."""
        for label, act, key in (
            ("Present", self._present, None),
            ("Rest, or go on", self.story.rest, "space"),
            ("Next step", lambda: self.story.turn(1), "pagedown"),
            ("Step before", lambda: self.story.turn(-1), "pageup"),
        ):
            commands.add("Demo", label, act, key=key)

    def _take(self, client: viser.ClientHandle, ending: str) -> None:
        """Save the steps as a film, as slides, or as a page."""
        shown, steps = self.shown, self.story.steps()
        if shown is None:
            self._bar.failed("Wait for the picture first.")
            return
        if not any(step.subject == "pair" for step in steps):
            self._bar.failed("No step shows the pair.")
            return
        state = shown.state
        name = safe_name(f"{state.dataset.name}_{state.query_id}_{state.database_id}", "film")
        is_dark = self._desk.canvases.is_dark(client)
        write = partial(_write_steps, *shown, steps, self._desk.memo, is_dark)
        self._downloads.order(client, f"{name}{ending}", write)

    # The steps.

    @property
    def _at(self) -> int:
        return max(int(self._step.value.partition(" ")[0]) - 1, 0)

    def _list(self, at: int | None = None) -> None:
        """Show the list of steps, and the words of one."""
        steps = self.story.steps() or (Keyframe(""),)
        at = min(self._at if at is None else at, len(steps) - 1)
        names = tuple(f"{k + 1} {step.title}" for k, step in enumerate(steps))
        with self._desk.host.atomic():
            if self._step.options != names:
                self._step.options = names
            self._step.value = names[at]
            self._title.value, self._line.value = steps[at].title, steps[at].line

    def _set(self, steps: tuple[Keyframe, ...], at: int) -> None:
        self._desk.update(lambda now: replace(now, keyframes=steps))
        self._list(at)

    def _rename(self, **words: str) -> None:
        steps, at = list(self.story.steps()), self._at
        if at < len(steps):
            words = {name: text[:MOST_LETTERS] for name, text in words.items()}
            steps[at] = replace(steps[at], **words)
            self._set(tuple(steps), at)

    def _edit(self, client: viser.ClientHandle, act: str) -> None:
        steps, at, now = list(self.story.steps()), self._at, self._desk.now
        if act == ADD and len(steps) < MOST_KEYFRAMES:
            titled = self._desk.canvases.caption.get("title", "")[:MOST_LETTERS]
            added = Keyframe(titled, "", now.view.options, view_of(client), now.subject)
            at = min(at + 1, len(steps))
            steps.insert(at, added)
        elif act == REMOVE and steps:
            steps.pop(at)
        elif act in (EARLIER, LATER):
            there = at + (1 if act == LATER else -1)
            if 0 <= there < len(steps):
                steps[at], steps[there] = steps[there], steps[at]
                at = there
        self._set(tuple(steps), at)

    def _show_step(self, client: viser.ClientHandle, _name: str) -> None:
        steps, at = self.story.steps(), self._at
        if at < len(steps):
            self._list(at)
            frame = steps[at]
            self._modes.turn_to(frame.subject)
            self._desk.change(options=frame.options)
            if frame.camera is not None:
                self._to(client, frame.camera)

    def _present(self) -> None:
        self._try(self.story.begin)

    def _try(self, act: Callable[[], None]) -> None:
        try:
            act()
        except InputError as error:
            self._bar.failed(str(error))
        else:
            self._bar.idle()

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """End the story when the panels are back."""
        if before.full_screen and not state.full_screen:
            self.story.end()
        if before.keyframes is not state.keyframes:
            self._list()

    def on_pair_result(self, news: PairNews) -> None:
        """Store the pair that is shown, or forget it."""
        if isinstance(news, SubmapShown):
            self.shown = None
        elif isinstance(news, PairShown):
            self.shown = news
            if self.story.told is None:
                self._list()

    def _play(self, playable: Playable) -> None:
        if playable == "closure":
            self._try(self.story.fly_once)
        elif self._world.graph is None:
            self._bar.failed("Optimise the pose graph in Explore first.")
        else:
            self._bar.idle()
            self._modes.turn_to("world")
            self._world.relax()

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
        if name == "oblique":
            self._desk.canvases.expect(client, seen)
        self._to(client, top(seen) if name == "top" else seen)

    def _to(self, client: viser.ClientHandle, camera: Camera) -> None:
        start = view_of(client)
        self._pilot.submit(
            Animation(1.2, lambda share: set_view(client, blend(start, camera, ease(share))))
        )

    def _whole(self, page: viser.ClientHandle) -> Camera | None:
        canvas = self._desk.canvases.of(page)
        if self._world.scene.visible:
            return self._world.scene.camera(canvas)
        return self._pair.camera(self._desk.state, canvas)

    # Pages.

    def _order(self, client: viser.ClientHandle) -> None:
        world = self._world.world
        if self._world.scene.visible and world is not None:
            name = f"{world.dataset.name}_world"
            write = partial(_write_world, world, self._world.graph)
            self._downloads.order(client, f"{safe_name(name, 'page')}.html", write)
        elif self._world.scene.visible or self._desk.state.is_pair:
            self._take(client, ".html")
        else:
            self._bar.failed(NEEDS_TWO)


def _write_steps(*what: Any) -> None:
    from app.viewer.features.demo.film import write_steps  # noqa: PLC0415 - loads matplotlib
    from app.viewer.features.demo.pages import write_story  # noqa: PLC0415

    *_, path, _progress = what
    (write_story if path.suffix == ".html" else write_steps)(*what)


def _write_world(*what: Any) -> None:
    from app.viewer.features.demo.pages import write_world  # noqa: PLC0415 - loads matplotlib

    write_world(*what)
