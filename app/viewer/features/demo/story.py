"""What a demonstration tells: keyframes in turn, on every page, until somebody ends it."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import degrees
from typing import Literal, TypeAlias

from app.viewer.features.desk import Cameras, Desk, ModeSwitch
from app.viewer.features.pair import PairScene, headline_of
from app.viewer.features.world import WorldTab, relaxation
from app.viewer.scene.cameras import Animation, blend, ease, play, set_view, view_of
from app.viewer.server.host import pages
from app.viewer.session.jobs import Lane
from app.viewer.session.layers import COMPARED
from app.viewer.session.session_file import Keyframe
from app.viewer.session.state import NEEDS_TWO, ViewOptions, ViewState, registered
from gpgrad_core.detection import PairResult
from gpgrad_core.detection.verdict import describe_length
from gpgrad_core.errors import InputError, count
from gpgrad_core.run import Cancelled, Progress

Motion: TypeAlias = Literal["flight", "fade", "turn"]
"""The query flies onto the database, colours change, or the camera alone moves."""
MOTION_SECONDS: dict[Motion, float] = {"flight": 4.0, "fade": 1.6, "turn": 1.2}
STILL, LANDED = 4.5, 2.0
"""How long a step stands, and one after which the query stays where it came [s]."""


def motion_between(before: ViewOptions, after: ViewOptions) -> Motion:
    """What moves from one step to the next."""
    if after.layout != "registered":
        return "turn"
    if before.layout != "registered":
        return "flight"
    is_hidden = not (before.surfaces and after.surfaces)
    return "turn" if before.layer == after.layer or is_hidden else "fade"


def story_of(state: ViewState, result: PairResult, *, closes_map: bool) -> tuple[Keyframe, ...]:
    """A closure in five steps, and in a sixth the map that closes."""
    registration, options = result.registration, state.options
    plain = replace(
        options,
        layer="gradient" if options.layer in COMPARED else options.layer,
        layout="side by side",
        compare="both",
        keypoints=False,
        other_keypoints=False,
        inlier_lines=False,
        outlier_lines=False,
        all_lines=False,
    )
    marked = replace(plain, keypoints=True, other_keypoints=True)
    joined = replace(plain, keypoints=True, inlier_lines=True)
    counts = [len(some) for some in result.features]
    verdict, motion = headline_of(result), registration.T_database_query
    agree = f"{registration.num_inliers} of {len(result.matches)} associations agree on one motion"
    steps = [
        Keyframe(
            "The same place?",
            f"Submaps {state.query_id} and {state.database_id} of {state.dataset.name}",
            plain,
        ),
        Keyframe(
            "Keypoints of the gradient",
            f"{counts[0]:,} and {counts[1]:,} places that can be told apart from others",
            marked,
        ),
        Keyframe("Lines join what looks alike", agree, joined),
    ]
    if motion is None:
        last = replace(steps[-1], title=verdict, line="No motion explains both submaps")
        return (*steps[:2], last)
    offset = f"{motion.x:+z.2f} m, {motion.y:+z.2f} m, turned by {degrees(motion.yaw):+z.1f}°"
    left = "White is ground where noise explains the difference of the heights"
    if registration.agreement is not None:
        differ = describe_length(registration.agreement.difference)
        left = f"Heights differ by {differ}. White is what noise explains."
    steps += [
        Keyframe("The query flies in", offset, replace(joined, layout="registered")),
        Keyframe(
            verdict,
            left,
            replace(plain, layout="registered", layer="difference", beyond_noise=True),
        ),
    ]
    if closes_map:
        submaps = count(len(state.dataset.submaps), "submap")
        line = f"{submaps}, from odometry to the corrected poses"
        steps.append(Keyframe("The map closes", line, plain, subject="world"))
    return tuple(steps)


Latest: TypeAlias = Callable[[], tuple[ViewState, PairResult] | None]
"""Gives the result shown last with its state, or None before the first and without a pair."""
LONGEST_WAIT = 60.0
"""For the picture of a step [s]; then what is there is played."""
LARGE = 1.8
"""Of the submaps' names while a story is shown, beside their usual size."""


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
        self.worker = Lane[Ask | None, None](
            desk.jobs, self._run, lambda _a, _n, _s: None, self._failed
        )
        self._on_error = on_error

    @property
    def told(self) -> Ask | None:
        """Where it stands; None while no story runs."""
        return self._at

    # What people ask for.

    def begin(self) -> None:
        """Fill the screen and play from the start, over and over."""
        self._check()
        if self._before is None:
            self._before = self._desk.state.options
        self._desk.canvases.presents = True
        self._modes.set_full_screen(True)
        self._pair.scale_labels(LARGE)
        self._go(Ask(0, going=True))

    def fly_once(self) -> None:
        """Fly the query onto the database as a step does, beside the panels."""
        self._check()
        self.worker.submit(None)

    def rest(self) -> None:
        """Pause, or go on from the same step; does nothing while no story runs."""
        if self._at is not None:
            self._go(Ask(self._at.step, not self._at.going))

    def turn(self, by: int) -> None:
        """Move by so many steps, and pause."""
        if self._at is not None:
            self._go(Ask(self._at.step + by, going=False))

    def end(self) -> None:
        with self._lock:
            before, self._before, self._at = self._before, None, None
            self.worker.cancel()
        if before is not None:
            self._tell({"title": ""})
            self._pair.scale_labels(1.0)
            self._desk.canvases.presents = False
            self._modes.turn_to("pair")
            self._desk.change(options=before)
            self._cameras.frame(None)

    # What it does.

    def _check(self) -> None:
        if not self._desk.state.is_pair:
            raise InputError(NEEDS_TWO)
        if self._latest() is None:
            raise InputError("Wait for the picture first.")

    def _go(self, ask: Ask) -> None:
        self._at = ask
        self.worker.submit(ask)

    def _failed(self, ask: Ask | None, error: Exception) -> None:
        if ask is not None:
            self._modes.set_full_screen(False)
            self.end()
        self._on_error(error)

    def _run(self, ask: Ask | None, progress: Progress) -> None:
        if ask is None:
            together = Keyframe("", "", registered(self._desk.state.options))
            apart = replace(together, options=replace(together.options, layout="side by side"))
            for frame in (apart, together):
                moving = replace(self._enter(frame, progress), rest=0.0)
                shown = self._latest()
                if shown is not None and shown[1].registration.T_database_query is None:
                    raise InputError("No motion was found for this pair.")
                play(moving, lambda _: progress(0.0))
            return
        while True:
            steps = self.steps()
            step = steps[ask.step % len(steps)]
            with self._lock:
                if self._at is None:  # it has been ended
                    return
                self._at = ask = Ask(ask.step % len(steps), ask.going)
            words = {"title": step.title, "line": step.line, "going": ask.going}
            self._tell({**words, "step": ask.step, "count": len(steps)})
            moving = self._enter(step, progress)
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

    def steps(self) -> tuple[Keyframe, ...]:
        """The keyframes of the session; without any, the story of the pair that is shown."""
        shown = self._latest()
        if self._desk.now.keyframes or shown is None:
            return self._desk.now.keyframes
        state, result = shown
        state = replace(state, options=self._before or state.options)
        return story_of(state, result, closes_map=self._world.graph is not None)

    def _enter(self, frame: Keyframe, progress: Progress) -> Animation:
        if frame.subject == "world":
            return self._close_map()
        self._modes.turn_to("pair")
        motion = motion_between(self._desk.state.options, frame.options)
        if motion == "fade":
            return self._fade(frame, progress)
        result = self._picture(progress, frame.options)
        draw = self._pair.gliding(self._desk.state, result) if motion == "flight" else None
        if draw is None:
            return self._flight(frame, lambda _share: None, MOTION_SECONDS["turn"], rest=STILL)
        return self._flight(frame, draw, MOTION_SECONDS["flight"], rest=LANDED)

    def _picture(self, progress: Progress, options: ViewOptions) -> PairResult:
        with self._lock:
            progress(0.0)  # if it has been ended, the view is as it was before
            if options.layout != self._desk.state.options.layout:
                self._cameras.keep_cameras()
            self._desk.update(
                lambda now: replace(now, view=replace(now.view, options=options), moving=False),
                deliver=False,
            )
        self._desk.deliver()  # without the lock, which a feature may need to end the story
        until = time.monotonic() + LONGEST_WAIT
        while True:
            progress(0.0)
            shown = self._latest()
            if shown is None:  # another dataset was opened
                raise Cancelled
            if shown[0] is self._desk.state or time.monotonic() > until:
                return shown[1]
            time.sleep(0.02)

    def _fade(self, frame: Keyframe, progress: Progress) -> Animation:
        """Fade the ground into the colours of the step; the legend follows when they are there."""
        result = self._picture(
            progress, replace(frame.options, layer=self._desk.state.options.layer)
        )
        wanted = replace(self._desk.state, options=frame.options)
        fade = self._pair.fading(self._pair.colors_of(wanted, result), result)

        def draw(share: float) -> None:
            fade(share)
            if share >= 1.0:
                self._picture(progress, frame.options)

        return self._flight(frame, draw, MOTION_SECONDS["fade"], rest=STILL)

    def _close_map(self) -> Animation:
        self._modes.turn_to("world")
        graph = self._world.graph
        if graph is None:
            return Animation(MOTION_SECONDS["turn"], lambda _share: None, rest=STILL)
        self._world.relax()
        return Animation(
            relaxation(graph, lambda _poses: None).seconds, lambda _share: None, rest=STILL
        )

    def _flight(
        self, frame: Keyframe, draw: Callable[[float], None], seconds: float, *, rest: float
    ) -> Animation:
        """Move the cameras of all pages to a keyframe while something is drawn."""
        starts = {page: view_of(page) for page in pages(self._desk.host).values()}
        state, layout = self._desk.state, frame.options.layout

        def at(share: float) -> None:
            draw(ease(share))
            for page, start in starts.items():
                # Read each time: a canvas whose panels go away grows meanwhile.
                canvas = self._desk.canvases.of(page)
                end = frame.camera or self._pair.camera(state, canvas, layout=layout)
                set_view(page, blend(start, end, ease(share)))
            if share >= 1.0 and frame.camera is None:
                self._cameras.frame(None)  # and again when the legend has grown

        return Animation(seconds, at, rest=rest)
