"""Nudging: wires a gizmo on the query to the scene, and the refinement to the pose graph."""

import threading
from dataclasses import dataclass
from math import atan2, degrees

import numpy as np
import viser

from app.viewer.features.desk import Desk, Feature
from app.viewer.features.nudge.panel import NudgePanel
from app.viewer.features.pair import PAIR, PairScene
from app.viewer.features.work import message_of
from app.viewer.scene.placement import Extent, Placement, height_offset, place
from app.viewer.session.decisions import with_motion
from app.viewer.session.runner import Runner
from app.viewer.session.state import NEEDS_TWO, ViewState, registered, same_pair
from app.viewer.widgets.actions import on_choice, on_press
from gpgrad_core.detection import PairResult
from gpgrad_core.registration import refine
from gpgrad_core.run.progress import Progress
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, Registration

GIZMO_SHARE = 0.3
"""Size of the handles, as a share of the query's width."""


@dataclass(frozen=True, eq=False)
class _Refinement:
    state: ViewState
    result: PairResult
    start: SE2


class NudgeTab(Feature):
    """Lets a person put the query where it belongs."""

    def __init__(self, desk: Desk, scene: PairScene) -> None:
        """Make the panel in the current container."""
        self._desk = desk
        self._host = desk.host
        self._scene = scene
        self._lock = threading.Lock()
        self._active = False
        self._shown: tuple[ViewState, PairResult] | None = None
        self._motion = SE2()
        self._refined: Registration | None = None
        self._gizmo: viser.TransformControlsHandle | None = None
        self._panel = NudgePanel(desk.host)
        on_choice(self._panel.active, self._set_active)
        on_press(self._panel.refine, self._refine)
        on_press(self._panel.back, self._back)
        on_press(self._panel.use, self._use)
        self._refiner: Runner[_Refinement, Registration] = Runner(
            self._align,
            self._on_refined,
            lambda _, error: self._panel.say(message_of(error), bad=True),
            name="refine",
        )
        self.workers = (self._refiner,)

    def follow(self, state: ViewState) -> None:
        """Follow the session: another pair is not the one that was being moved."""
        shown = self._shown
        if self._active and shown is not None and not same_pair(shown[0], state):
            self._drop()

    def show(self, state: ViewState, result: PairResult) -> None:
        """Take what is shown; begin where it was found."""
        self._shown = state, result
        if self._active:
            if state.options.layout != "registered":
                self._drop()
            else:
                self._begin(state, result)

    def alone(self, state: ViewState, gradient_map: GradientMap) -> None:
        """Forget the pair: there is none to move."""
        del state, gradient_map
        self._shown = None

    def _set_active(self, active: bool) -> None:
        if active and not self._desk.state.is_pair:
            self._panel.set_active(False)
            self._panel.say(NEEDS_TWO, bad=True)
            return
        self._active = active
        self._panel.set_active(active)
        if active:
            # `show` follows.
            self._desk.change(options=registered(self._desk.state.options))
        else:
            self._drop()
            self._desk.change()  # draws the pair where it belongs again

    def _drop(self) -> None:
        """Take the handles off."""
        self._active = False
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None
        self._refined = None
        self._desk.tell(lambda feature: feature.moved(False))
        self._panel.set_active(False)
        self._panel.show(())
        self._panel.say("")

    def _begin(self, state: ViewState, result: PairResult) -> None:
        motion = result.registration.T_database_query or _onto_each_other(state)
        self._refined = None
        self._panel.use.disabled = True
        if self._gizmo is None:
            self._gizmo = self._add_gizmo(state)
        self._put(motion, with_gizmo=True)
        self._desk.tell(lambda feature: feature.moved(False))
        self._panel.show(_rows(motion, result.registration))

    def _add_gizmo(self, state: ViewState) -> viser.TransformControlsHandle:
        width = float(Extent.of(state.query).size[:2].max())
        gizmo = self._host.scene.add_transform_controls(
            f"{PAIR}/nudge",
            scale=GIZMO_SHARE * width,
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
        """Put the query where the handles are."""
        gizmo, shown = self._gizmo, self._shown
        if gizmo is None or shown is None:
            return
        state, _ = shown
        w, _, _, z = gizmo.wxyz
        yaw = 2 * atan2(float(z), float(w))
        # The handles sit on the middle of the query's box; the scene's origin on the database's.
        middle = SE2(yaw=yaw).apply(Extent.of(state.query).center[None, :2])[0]
        x, y = np.array(gizmo.position)[:2] + Extent.of(state.database).center[:2] - middle
        self._refined = None
        self._panel.use.disabled = True
        self._put(SE2(float(x), float(y), yaw), with_gizmo=False)
        self._desk.tell(lambda feature: feature.moved(True))
        self._panel.show((*_motion_rows(self._motion), ("", "not refined yet")))

    def _put(self, motion: SE2, *, with_gizmo: bool) -> None:
        """Put the query where a motion has it, and the handles on it."""
        shown = self._shown
        if shown is None:
            return
        state, result = shown
        with self._lock:
            self._motion = motion
            ratio = state.params.features.max_std_ratio
            dz = height_offset(result.query_map, result.database_map, motion, ratio)
            query = Extent.of(state.query)
            places = place(query, Extent.of(state.database), "registered", motion, dz)
            self._scene.placing(state, result)(*places)
            if with_gizmo and self._gizmo is not None:
                above = np.array([[*query.center[:2], query.high[2]]])
                self._gizmo.position = tuple(places[0].apply(above)[0])
                self._gizmo.wxyz = Placement(yaw=motion.yaw).wxyz

    def _back(self) -> None:
        if self._shown is not None and self._active:
            self._begin(*self._shown)
            self._panel.say("")

    def _refine(self) -> None:
        if self._shown is not None and self._active:
            self._panel.say("Refining …")
            self._refiner.submit(_Refinement(*self._shown, self._motion))

    def _align(self, job: _Refinement, progress: Progress) -> Registration:
        result = job.result
        progress(0.0)
        return refine(
            result.query_map,
            result.database_map,
            result.matches,
            job.start,
            job.state.params.registration,
        )

    def _on_refined(self, job: _Refinement, registration: Registration, seconds: float) -> None:
        motion = registration.T_database_query
        if not self._active or self._shown is None or self._shown[1] is not job.result:
            return  # another pair is shown
        if motion is None or registration.covariance is None:
            self._panel.say(
                "The two submaps share too little ground there. Move the query closer.", bad=True
            )
            return
        self._refined = registration
        self._put(motion, with_gizmo=True)
        self._desk.tell(lambda feature: feature.moved(True))
        self._panel.show(_rows(motion, registration))
        self._panel.use.disabled = False
        self._panel.say(f"Refined in {1000 * seconds:.0f} ms.")
        self._host.flush()

    def _use(self) -> None:
        if self._refined is not None and self._shown is not None:
            state = self._shown[0]
            pair, refined = (state.query_id, state.database_id), self._refined
            self._desk.decide(lambda decisions: with_motion(decisions, pair, refined))
            self._panel.say("Accepted by hand: see the tab Pose graph in Explore.")


def _onto_each_other(state: ViewState) -> SE2:
    """Lay the middle of the query onto the middle of the database."""
    x, y, _ = Extent.of(state.database).center - Extent.of(state.query).center
    return SE2(float(x), float(y), 0.0)


def _motion_rows(motion: SE2) -> tuple[tuple[str, str], ...]:
    return (
        ("offset", f"{motion.x:+z.2f} m, {motion.y:+z.2f} m"),
        ("yaw", f"{degrees(motion.yaw):+z.1f}°"),
    )


def _rows(motion: SE2, registration: Registration) -> tuple[tuple[str, str], ...]:
    return (
        *_motion_rows(motion),
        ("score", f"{registration.score:.2f}"),
        ("inliers", f"{registration.num_inliers}"),
        ("overlap", f"{registration.overlap_area:.1f} m²"),
        ("correlation", f"{registration.correlation:z.2f}"),
    )
