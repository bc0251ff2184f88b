"""What a demonstration tells: a closure in six steps, on every page, until somebody ends it."""

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import degrees
from typing import TypeAlias

from app.viewer.features.desk import Cameras, Desk, ModeSwitch
from app.viewer.features.pair import PairScene, headline_of
from app.viewer.features.world import WorldTab, relaxation
from app.viewer.scene.cameras import Animation, blend, ease, play, set_view, view_of
from app.viewer.server.host import pages
from app.viewer.session.jobs import Lane
from app.viewer.session.state import COMPARED, NEEDS_TWO, Layout, ViewOptions, ViewState
from gpgrad_core.detection import PairResult
from gpgrad_core.errors import InputError
from gpgrad_core.run import Cancelled, Progress

Latest: TypeAlias = Callable[[], tuple[ViewState, PairResult] | None]
"""Gives the result shown last with its state, or None before the first and without a pair."""
LONGEST_WAIT = 60.0
"""For the picture of a step [s]; then what is there is played."""
FLIGHT_SECONDS, FADE_SECONDS = 4.0, 4.0
STILL, HELD = 4.5, 0.35
"""How long a step stands that does not move [s], and which share of its time the difference does
before it fades."""


@dataclass(frozen=True, eq=False)
class StoryStep:
    """A step of a story."""

    title: str  # what is to be seen, in a few words
    line: str  # the figures of it
    enter: Callable[[Progress], Animation]  # changes what is shown; gives what moves then


@dataclass(frozen=True)
class Ask:
    """Where a story is to go on, and whether it goes on by itself from there."""

    step: int
    going: bool


class Story:
    """Plays the steps in turn and begins again, so that it can run on a stand by itself."""

    def __init__(
        self,
        desk: Desk,
        pair: PairScene,
        world: WorldTab,
        modes: ModeSwitch,
        cameras: Cameras,
        latest: Latest,
        on_error: Callable[[Exception], None],
    ) -> None:
        self._desk, self._pair, self._world = desk, pair, world
        self._modes, self._cameras, self._latest = modes, cameras, latest
        self._lock = threading.RLock()  # a change of the view may end it
        self._at: Ask | None = None
        self._before: ViewOptions | None = None
        self.worker = Lane[Ask, None](desk.jobs, self._run, lambda _a, _n, _s: None, self._failed)
        self._on_error = on_error

    @property
    def told(self) -> Ask | None:
        """Where it stands; None while nothing is told."""
        return self._at

    # What people ask for.

    def begin(self) -> None:
        """Fill the screen and play from the start, over and over."""
        self._check()
        if self._before is None:
            self._before = self._desk.state.options
        self._modes.set_full_screen(True)
        self._go(Ask(0, going=True))

    def rest(self) -> None:
        """Stand still, or go on from the same step; does nothing while nothing is told."""
        if self._at is not None:
            self._go(Ask(self._at.step, not self._at.going))

    def turn(self, by: int) -> None:
        """Go steps on or back, and rest there."""
        if self._at is not None:
            self._go(Ask(self._at.step + by, going=False))

    def end(self) -> None:
        with self._lock:
            before, self._before, self._at = self._before, None, None
        self.worker.cancel()
        if before is not None:
            self._tell({"title": ""})
            self._modes.turn_to("pair")
            self._desk.change(options=before)
            self._cameras.frame(None)

    def film(
        self, frames_a_second: float, progress: Progress
    ) -> Iterator[tuple[StoryStep, float, float]]:
        """Show each moment of the pair's steps once, as long as it takes to take its picture.

        Yields the step, how long the moment stands [s], and the share of the whole that is done.
        The map is no part of it, because it moves by itself.
        """
        self._check()
        self._before = self._desk.state.options
        self._at = Ask(0, going=False)
        try:
            steps = [step for step in self.steps() if step.enter != self._close_map]
            for number, step in enumerate(steps):
                moving = step.enter(progress)
                count = max(round(moving.seconds * frames_a_second), 1)
                for k in range(count + 1):
                    moving.draw(k / count)
                    still = moving.rest if k == count else 1.0 / frames_a_second
                    yield step, still, (number + (k + 1) / (count + 1)) / len(steps)
        finally:
            self.end()

    # What it does.

    def _check(self) -> None:
        if not self._desk.state.is_pair:
            raise InputError(NEEDS_TWO)
        if self._latest() is None:
            raise InputError("Wait for the picture first.")

    def _go(self, ask: Ask) -> None:
        self._at = ask
        self.worker.submit(ask)

    def _failed(self, _ask: Ask, error: Exception) -> None:
        self._modes.set_full_screen(False)
        self.end()
        self._on_error(error)

    def _run(self, ask: Ask, progress: Progress) -> None:
        while True:
            steps = self.steps()
            step = steps[ask.step % len(steps)]
            with self._lock:
                if self._at is None:  # it has been ended
                    return
                self._at = ask = Ask(ask.step % len(steps), ask.going)
            words = {"title": step.title, "line": step.line, "going": ask.going}
            self._tell({**words, "step": ask.step, "count": len(steps)})
            moving = step.enter(progress)
            play(moving, lambda _: progress(0.0))
            if not ask.going:
                return
            still = Animation(moving.rest, lambda _share: None)
            play(still, lambda _: progress(0.0))
            ask = Ask(ask.step + 1, going=True)

    def _tell(self, words: dict[str, object]) -> None:
        for page in pages(self._desk.host).values():
            self._desk.canvases.show(page, "story", words)

    # The steps.

    def steps(self) -> tuple[StoryStep, ...]:
        """Give the steps for the pair that is shown, and for the map if that was optimised."""
        shown = self._latest()
        assert shown is not None  # `begin` has checked it, and the pair stays
        state, result = shown
        registration = result.registration
        counts = [len(some) for some in (result.query_features, result.database_features)]
        of_pair = f"submaps {state.query_id} and {state.database_id} of {state.dataset.name}"
        verdict = headline_of(result)
        num_matches = len(result.matches.query_xy)
        agree = f"{registration.num_inliers} of {num_matches} associations agree on one motion"
        steps = [
            StoryStep("The same place?", of_pair[0].upper() + of_pair[1:], self._apart()),
            StoryStep(
                "Keypoints of the gradient",
                f"{counts[0]:,} and {counts[1]:,} places that can be told apart from others",
                self._apart(keypoints=True),
            ),
            StoryStep(
                "Lines join what looks alike",
                agree,
                self._apart(keypoints=True, inlier_lines=True),
            ),
        ]
        motion = registration.T_database_query
        if motion is None:
            last = replace(steps[-1], title=verdict, line="No motion explains both submaps")
            return (*steps[:2], last)
        offset = f"{motion.x:+z.2f} m, {motion.y:+z.2f} m, turned by {degrees(motion.yaw):+z.1f}°"
        steps += [
            StoryStep("The query flies in", offset, self._fly_in),
            StoryStep(verdict, "What is left between the heights, and then the ground", self._fade),
        ]
        graph = self._world.graph
        if graph is not None:
            count = f"{len(state.dataset.submaps)} submaps, from odometry to the corrected poses"
            steps.append(StoryStep("The map closes", count, self._close_map))
        return tuple(steps)

    def _picture(
        self,
        progress: Progress,
        layout: Layout,
        *,
        keypoints: bool = False,
        inlier_lines: bool = False,
        difference: bool = False,
    ) -> PairResult:
        self._modes.turn_to("pair")
        before = self._before or self._desk.state.options
        ground = "gradient" if before.layer in COMPARED else before.layer
        plain = replace(
            before,
            layer="difference" if difference else ground,
            layout=layout,
            compare="both",
            keypoints=keypoints,
            inlier_lines=inlier_lines,
            outlier_lines=False,
            all_lines=False,
        )
        with self._lock:
            if self._at is None:  # it has been ended, and the view is as it was before
                raise Cancelled
            if plain.layout != self._desk.state.options.layout:
                self._cameras.keep_cameras()
            self._desk.update(
                lambda now: replace(now, view=replace(now.view, options=plain), moving=False),
                deliver=False,
            )
        self._desk.deliver()  # without the lock, which who is told may need to end the story
        until = time.monotonic() + LONGEST_WAIT
        while True:
            progress(0.0)
            shown = self._latest()
            assert shown is not None
            if shown[0] is self._desk.state or time.monotonic() > until:
                return shown[1]
            time.sleep(0.02)

    def _apart(
        self, *, keypoints: bool = False, inlier_lines: bool = False
    ) -> Callable[[Progress], Animation]:
        def enter(progress: Progress) -> Animation:
            self._picture(progress, "side by side", keypoints=keypoints, inlier_lines=inlier_lines)
            return self._flight("side by side", lambda _share: None, 1.2, rest=STILL)

        return enter

    def _fly_in(self, progress: Progress) -> Animation:
        result = self._picture(progress, "registered", keypoints=True, inlier_lines=True)
        draw = self._pair.gliding(self._desk.state, result)
        assert draw is not None  # of a pair with a motion
        return self._flight("registered", draw, FLIGHT_SECONDS, rest=2.0)

    def _fade(self, progress: Progress) -> Animation:
        self._picture(progress, "registered")
        ground = self._pair.colors
        result = self._picture(progress, "registered", difference=True)
        fade = self._pair.fading(ground, result)

        def draw(share: float) -> None:
            if share > HELD:
                fade(ease((share - HELD) / (1.0 - HELD)))

        return Animation(FADE_SECONDS, draw, rest=2.0)

    def _close_map(self, _progress: Progress) -> Animation:
        graph = self._world.graph
        assert graph is not None
        self._modes.turn_to("world")
        self._world.relax()
        return Animation(
            relaxation(graph, lambda _poses: None).seconds, lambda _share: None, rest=STILL
        )

    def _flight(
        self, layout: Layout, draw: Callable[[float], None], seconds: float, *, rest: float
    ) -> Animation:
        """Bring the cameras of all pages to a layout while something is drawn."""
        starts = {page: view_of(page) for page in pages(self._desk.host).values()}

        def at(share: float) -> None:
            eased = ease(share)
            draw(eased)
            for page, start in starts.items():
                # Asked for each time: a canvas whose panels go away grows meanwhile.
                canvas = self._desk.canvases.of(page)
                set_view(
                    page,
                    blend(start, self._pair.camera(self._desk.state, canvas, layout=layout), eased),
                )

        return Animation(seconds, at, rest=rest)
