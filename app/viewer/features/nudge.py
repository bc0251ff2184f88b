"""Nudging: a person sets the motion of a pair by hand, and the ground refines it."""

import threading
from dataclasses import dataclass
from math import atan2, degrees

import numpy as np
import viser

from app.viewer.features.desk import Desk, Feature
from app.viewer.features.pair import PAIR, PairScene
from app.viewer.features.work import message_of
from app.viewer.scene.placement import Box, Placement, height_offset, place
from app.viewer.session.decisions import with_motion
from app.viewer.session.jobs import Lane
from app.viewer.session.news import PairMoved, PairNews, PairShown, SessionState, SubmapShown
from app.viewer.session.state import NEEDS_TWO, ViewState, registered, same_pair
from app.viewer.widgets.actions import on_choice, on_press
from app.viewer.widgets.html import BAD, BUSY, FAINT, message_line, paragraph, table
from gpgrad_core.detection import PairResult
from gpgrad_core.errors import score_in_words
from gpgrad_core.registration import refine
from gpgrad_core.run import Progress
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Registration

INTRODUCTION = (
    "Did the search miss a closure, or find a wrong motion? Drag the query to where it belongs, "
    "refine its pose, and hand it to the pose graph."
)


@dataclass(frozen=True, eq=False)
class _Refinement:
    state: ViewState
    result: PairResult
    start: SE2


class NudgeTab(Feature):
    """Lets a person put the query where it belongs."""

    def __init__(self, desk: Desk, scene: PairScene) -> None:
        self._desk = desk
        self._host = desk.host
        self._scene = scene
        self._lock = threading.Lock()
        self._active = False
        self._shown: PairShown | None = None
        self._motion = SE2()
        self._refined: Registration | None = None
        self._gizmo: viser.TransformControlsHandle | None = None
        gui = desk.host.gui
        gui.add_html(paragraph(INTRODUCTION, FAINT))
        self._switch = gui.add_checkbox(
            "Move the query",
            initial_value=False,
            hint="Lays the query onto the database and shows handles: arrows shift it, the arc "
            "turns it.",
        )
        self._refine_button = gui.add_button(
            "Refine",
            disabled=True,
            hint="Aligns the two surfaces, starting from the pose that you set. It should be "
            "right to within a few length-scales.",
        )
        self._back_button = gui.add_button(
            "Reset position", disabled=True, hint="Goes back to the motion that the search found."
        )
        self._use_button = gui.add_button(
            "Use in the pose graph",
            disabled=True,
            hint="Accepts the pair by hand, with the refined motion. See the tab Pose graph in "
            "Explore.",
        )
        self._figures = gui.add_html("")
        self._message = gui.add_html("")
        on_choice(self._switch, self._set_active)
        on_press(self._refine_button, self._refine)
        on_press(self._back_button, self._back)
        on_press(self._use_button, self._use)
        self._refiner: Lane[_Refinement, Registration] = Lane(
            desk.jobs,
            self._align,
            self._on_refined,
            lambda _, error: self._say(message_of(error), bad=True),
        )

    def on_state(self, before: SessionState, state: SessionState) -> None:
        if self._active and not same_pair(before.view, state.view):
            self._drop()

    def on_pair_result(self, news: PairNews) -> None:
        """Begin at the motion of the pair that is shown; without one, there is none to move."""
        if isinstance(news, SubmapShown):
            self._shown = None
        elif isinstance(news, PairShown):
            self._shown = news
            if self._active and news.state.options.layout != "registered":
                self._drop()
            elif self._active:
                self._begin(*news)

    def _set_active(self, active: bool) -> None:
        if active and not self._desk.state.is_pair:
            self._show_active(False)
            self._say(NEEDS_TWO, bad=True)
            return
        self._active = active
        self._show_active(active)
        if active:
            # `on_pair_result` follows.
            self._desk.change(options=registered(self._desk.state.options))
        else:
            self._drop()
            self._desk.tell_again()  # draws the pair where it belongs again

    def _drop(self) -> None:
        self._active = False
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None
        self._refined = None
        self._tell_moved(False)
        self._show_active(False)
        self._show_rows(())
        self._say("")

    def _begin(self, state: ViewState, result: PairResult) -> None:
        if self._gizmo is None:
            self._gizmo = self._add_gizmo(state)
        motion = result.registration.T_database_query or _onto_each_other(state)
        self._put(motion, result.registration, by_hand=False)

    def _tell_moved(self, by_hand: bool) -> None:
        self._desk.notify(lambda feature: feature.on_pair_result(PairMoved(by_hand)))

    def _add_gizmo(self, state: ViewState) -> viser.TransformControlsHandle:
        width = float(Box.of(state.query).size[:2].max())
        gizmo = self._host.scene.add_transform_controls(
            f"{PAIR}/nudge",
            scale=0.3 * width,
            active_axes=(True, True, False),
            line_width=4.0,
            depth_test=False,
        )

        @gizmo.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            if event.client_id is not None:
                self.moved_by_hand()

        return gizmo

    def moved_by_hand(self) -> None:
        gizmo, shown = self._gizmo, self._shown
        if gizmo is None or shown is None:
            return
        state, _ = shown
        w, _, _, z = gizmo.wxyz
        yaw = 2 * atan2(float(z), float(w))
        # The handles sit on the middle of the query's box; the scene's origin on the database's.
        middle = SE2(yaw=yaw).apply(Box.of(state.query).center[None, :2])[0]
        x, y = np.array(gizmo.position)[:2] + Box.of(state.database).center[:2] - middle
        self._put(SE2(float(x), float(y), yaw), None, by_hand=True)

    def _put(self, motion: SE2, found: Registration | None, *, by_hand: bool) -> None:
        """Move the query to a motion, and report the result there; none while it is dragged."""
        shown = self._shown
        if shown is None:
            return
        state, result = shown
        self._refined = found if by_hand else None
        self._use_button.disabled = self._refined is None
        with self._lock:
            self._motion = motion
            ratio = state.params.features.max_std_ratio
            dz = height_offset(result.maps, motion, ratio)
            query = Box.of(state.query)
            boxes, times = (query, Box.of(state.database)), state.options.exaggeration
            places = place(*boxes, "registered", motion, dz, exaggeration=times)
            self._scene.placing(result)(*places)
            if found is not None and self._gizmo is not None:
                above = np.array([[*query.center[:2], query.high[2]]])
                self._gizmo.position = tuple(places[0].apply(above)[0])
                self._gizmo.wxyz = Placement(yaw=motion.yaw).wxyz
        self._tell_moved(by_hand)
        self._show_rows(_rows(motion, found))

    def _show_active(self, active: bool) -> None:
        self._switch.value = active
        self._refine_button.disabled = self._back_button.disabled = not active
        if not active:
            self._use_button.disabled = True

    def _show_rows(self, rows: tuple[tuple[str, str], ...]) -> None:
        self._figures.content = (
            f'<div data-testid="nudge-figures" style="padding:.1em .75em">{table(rows)}</div>'
            if rows
            else ""
        )

    def _say(self, message: str, *, bad: bool = False) -> None:
        self._message.content = message_line("nudge-message", message, BAD if bad else BUSY)

    def _back(self) -> None:
        if self._shown is not None and self._active:
            self._begin(*self._shown)
            self._say("")

    def _refine(self) -> None:
        if self._shown is not None and self._active:
            self._say("Refining …")
            self._refiner.submit(_Refinement(*self._shown, self._motion))

    def _align(self, job: _Refinement, progress: Progress) -> Registration:
        result = job.result
        progress(0.0)
        params = job.state.params.registration
        return refine(*result.maps, result.matches, job.start, params)

    def _on_refined(self, job: _Refinement, registration: Registration, seconds: float) -> None:
        motion = registration.T_database_query
        if not self._active or self._shown is None or self._shown[1] is not job.result:
            return  # another pair is shown
        if motion is None or registration.covariance is None:
            self._say(
                "The two submaps share too little ground there. Move the query closer.", bad=True
            )
            return
        self._put(motion, registration, by_hand=True)
        self._say(f"Refined in {1000 * seconds:.0f} ms.")
        self._host.flush()

    def _use(self) -> None:
        if self._refined is not None and self._shown is not None:
            state = self._shown[0]
            pair, refined = (state.query_id, state.database_id), self._refined
            self._desk.decide(lambda decisions: with_motion(decisions, pair, refined))
            self._say("Accepted by hand: see the tab Pose graph in Explore.")


def _onto_each_other(state: ViewState) -> SE2:
    x, y, _ = Box.of(state.database).center - Box.of(state.query).center
    return SE2(float(x), float(y), 0.0)


def _rows(motion: SE2, found: Registration | None) -> tuple[tuple[str, str], ...]:
    place = (
        ("offset", f"{motion.x:+z.2f} m, {motion.y:+z.2f} m"),
        ("yaw", f"{degrees(motion.yaw):+z.1f}°"),
    )
    if found is None:
        return (*place, ("", "not refined yet"))
    return (
        *place,
        ("score", score_in_words(found.score)),
        ("inliers", f"{found.num_inliers}"),
        ("overlap", f"{found.overlap_area:.1f} m²"),
        ("correlation", f"{found.correlation:z.2f}"),
    )
