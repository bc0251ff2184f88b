"""One session: wires panels to the runner and the runner to the views.

A widget's callback only takes a new snapshot of the session and submits it; one worker turns
the newest snapshot into a result, shows it, and writes the read-outs. A session is shown on a
server, to all of whose pages alike, or on one page; it never asks which.
"""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import viser

from app.viewer import state as states
from app.viewer.all_pairs.judging import Judged
from app.viewer.all_pairs.tab import AllPairs
from app.viewer.capacity import Turns
from app.viewer.data.panel import DatasetSummary, PairPanel
from app.viewer.data.tab import Opened, Opening
from app.viewer.draw.cameras import set_view
from app.viewer.draw.colors import legend_uri
from app.viewer.draw.picking import Ray
from app.viewer.draw.placement import Camera
from app.viewer.feature import Part
from app.viewer.host import Host, set_theme
from app.viewer.inspect.tab import Inspection
from app.viewer.modes import Stage, StageCalls
from app.viewer.nudge.tab import Nudge
from app.viewer.pair.ground import HistogramOf
from app.viewer.pair.panel import ViewPanel
from app.viewer.pair.scene import PairScene, Shown
from app.viewer.pair.verdict import VerdictCard
from app.viewer.params.fit import Fit, with_fitted
from app.viewer.params.panel import ParamsPanel
from app.viewer.params.presets import Presets
from app.viewer.params.undo import Undo
from app.viewer.permissions import ANYWHERE, Places
from app.viewer.runner import Runner
from app.viewer.save.exports import Exports
from app.viewer.save.tab import Saving
from app.viewer.shortcuts import Actions, add_shortcuts
from app.viewer.state import Probe, ViewOptions, ViewState
from app.viewer.timing import TimedMemo
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.modes import Way, WaysPanel
from app.viewer.widgets.presence import PresenceLine
from app.viewer.widgets.status import StatusLine
from gpgrad_core.errors import InputError
from gpgrad_core.pipeline import PairResult, PipelineParams, register_pair
from gpgrad_core.pipeline.coarse import infer_quick_maps
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress
from gpgrad_core.types import Registration

_log = logging.getLogger(__name__)

MAIN_PARAMETERS = {
    "map.length_scale": "Length-scale",
    "map.noise_std": "Noise",
    "features.max_std_ratio": "Variance mask",
    "registration.inlier_radius": "Inlier radius",
    "closure.min_inliers": "Minimum inliers",
    "closure.min_score": "Minimum score",
}
"""The parameters that stand in the open, and what people call them."""

CONTROL_WIDTH = 310
NOTICED = 0.15
"""What is shown sooner needs no word before it: every word costs the page time [s]."""
LONG = 1.0
"""What takes longer has a bar and can be cancelled [s]."""


@dataclass(frozen=True, eq=False)
class Picture:
    """What the worker has shown.

    Attributes:
        shown: What is to be seen.
        pair: What was found; None in a preview, which has nothing but surfaces.
        coarse: Whether the surfaces are not yet the full ones.
    """

    shown: Shown
    pair: PairResult | None = None
    coarse: bool = False


class Session:
    """Panels, scene and workers of one session."""

    def __init__(
        self,
        host: Host,
        opened: Opened,
        memo: Memo,
        turns: Turns,
        places: Places = ANYWHERE,
    ) -> None:
        """Build it on a host and start on the first picture; returns at once.

        Args:
            host: Whose GUI and scene it fills.
            opened: What to open with; its parameters are what "reset" goes back to.
            memo: Shared by all sessions, so that none computes what another has.
            turns: Shared by all sessions, so that they do not outnumber the processors.
            places: Where may be read from and written to.
        """
        self._state = begin(opened, ViewOptions())
        if self._state.options.dark:
            set_theme(host, dark=True)
        self._lock = threading.Lock()
        self._memo = memo
        self._turns = turns
        self._host = host
        self._parts: list[Part] = []
        self._scene = PairScene(host)
        self._histogram = HistogramOf()
        self._commands = Commands(host)
        self._places = places
        self._timed = TimedMemo(memo)
        self._began = time.monotonic()
        self._fraction = 0.0
        self._word_due = False
        self._patience = threading.Timer(LONG, lambda: None)
        self._build_panels()
        self._params.set_default(opened.params)
        self._start_camera(opened)
        self._painted: ViewState | None = None  # whose full surfaces are to be seen
        self._runner: Runner[ViewState, Picture] = Runner(
            self._compute,
            self._on_result,
            self._on_error,
            on_start=self._on_start,
            on_cancel=lambda state: self._outdate(self._status.cancelled),  # noqa: ARG005
            preview=self._preview,
            turns=turns.pictures,
            name="pair",
        )
        host.scene.on_click(modifier="shift")(self._pick)
        self._runner.submit(self._state)

    @property
    def state(self) -> ViewState:
        """The session as it is now."""
        return self._state

    def show_presence(self, count: int) -> None:
        """Say how many pages show this session."""
        self._presence.show(count)

    def wait_idle(self, timeout: float = 60.0) -> bool:
        """Wait until the picture is up to date; says whether that came true in time [s]."""
        workers = (*self._parts, self._runner, *self._parts)
        return all(worker.wait_idle(timeout) for worker in workers)

    def close(self) -> None:
        """Stop working; what was shown stays until its page goes."""
        self._runner.close()
        self._patience.cancel()
        for part in self._parts:
            part.close()
        self._scene.close()

    # What the user sees: verdict and parameters right, what is drawn left.

    def _build_panels(self) -> None:
        gui, state = self._host.gui, self._state
        gui.set_panel_label("Loop closure")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(CONTROL_WIDTH)
        ways = WaysPanel(self._host, "Tune", self._go)
        self._presence = PresenceLine(self._host)
        self._verdict = VerdictCard(self._host)
        self._status = StatusLine(self._host, on_cancel=self._cancel)
        self._params = ParamsPanel(
            self._host,
            state.params,
            lambda params: self._change(params=params),
            main=MAIN_PARAMETERS,
            on_error=self._status.error,
        )
        self._parts.append(
            Fit(
                self._host,
                state,
                self._turns.long,
                on_fitted=self._take_fitted,
                message_of=message_of,
            )
        )
        self._parts.append(Undo(self._host, state, self._commands, on_params=self._take_params))
        reset = gui.add_button(
            "Reset parameters", hint="Back to the parameters that this dataset started with."
        )

        @reset.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            self._change(params=self._params.reset())

        self._parts.append(
            Presets(self._host, state, self._places.presets, on_params=self._take_params)
        )
        left = gui.add_panel()
        with left.add_tab("View"):
            self._summary = DatasetSummary(self._host)
            self._summary.show(state.dataset)
            self._pair_panel = PairPanel(
                self._host, state, lambda query, database: self._change(pair=(query, database))
            )
            self._view_panel = ViewPanel(
                self._host,
                state.options,
                lambda options: self._change(options=options),
                self._reset_camera,
            )
        with left.add_tab("Inspect"):
            self._inspection = Inspection(
                self._host,
                on_match=lambda number: self._change(match=number),
                on_clear=lambda: self._change(probe=None),
            )
            self._parts.append(self._inspection)
        with left.add_tab("All pairs"):
            all_pairs = AllPairs(
                self._host,
                state,
                self._memo,
                self._turns.long,
                on_pair=self._show_pair,
                message_of=message_of,
                on_judged=self._take_judged,
                on_progress=self._take_progress,
            )
            self._parts.append(all_pairs)
        with left.add_tab("Data"):
            self._opening = Opening(
                self._host,
                state.source,
                self._places,
                on_opened=self._take_opened,
                message_of=message_of,
            )
            self._parts.append(self._opening)
        with left.add_tab("Save"):
            self._saving = Saving(self._host, state, on_restore=self._opening.restore)
            self._parts.append(self._saving)
            self._parts.append(
                Exports(self._host, state, self._memo, self._turns.long, message_of=message_of)
            )
        with left.add_tab("Nudge"):
            nudge = Nudge(
                self._host,
                self._scene,
                on_registered=self._register,
                on_layout=self._change,
                on_motion=self._take_motion,
                message_of=message_of,
            )
        self._stage = Stage(
            self._host,
            state,
            self._memo,
            self._turns,
            self._scene,
            left,
            ways,
            self._commands,
            StageCalls(
                on_tune=self._show_pair,
                on_registered=self._register,
                on_find=all_pairs.run,
                on_cancel_find=all_pairs.cancel,
                message_of=message_of,
            ),
        )
        self._parts += [nudge, self._stage, *self._stage.parts]
        self._add_shortcuts()

    def _add_shortcuts(self) -> None:
        add_shortcuts(
            self._commands,
            Actions(
                options=lambda: self._state.options,
                set_options=self._set_options,
                step_pair=self._pair_panel.step,
                step_match=self._inspection.step,
                clear=lambda: self._change(match=0, probe=None),
                look_at_both=lambda page: set_view(page, self._scene.camera(self._state)),
                look_from_above=lambda page: set_view(page, self._scene.camera_above(self._state)),
            ),
        )

    def _change(
        self,
        *,
        pair: tuple[str, str] | None = None,
        params: PipelineParams | None = None,
        options: ViewOptions | None = None,
        match: int | None = None,
        probe: Probe | Literal["as it is"] | None = "as it is",
    ) -> None:
        """Take a new snapshot and submit it; quick, for callbacks."""
        with self._lock:
            state = self._state
            if pair is not None:
                state = states.with_pair(state, query_id=pair[0], database_id=pair[1])
            if params is not None:
                state = states.with_params(state, params)
            if options is not None:
                state = states.with_options(state, options)
            if match is not None:
                state = states.with_match(state, match)
            if probe != "as it is":
                state = states.with_probe(state, probe)
            self._set(state)

    def _set(self, state: ViewState) -> None:
        """Make a snapshot the present one, and let all who follow know; the lock is held."""
        if state.options.dark != self._state.options.dark:
            set_theme(self._host, dark=state.options.dark)
        self._state = state
        self._runner.submit(state)
        for part in self._parts:
            part.follow(state)

    def _take_params(self, params: PipelineParams) -> None:
        """Go to parameters that no slider gave: the sliders follow."""
        self._params.set(params)
        self._change(params=params)

    def _take_fitted(self, found: dict[str, float]) -> None:
        params = self._params.value
        self._take_params(replace(params, map=with_fitted(params.map, found)))

    def _set_options(self, options: ViewOptions) -> None:
        """Show other options, in the widgets too."""
        self._view_panel.set(options)
        self._change(options=options)

    def _show_pair(self, query_id: str, database_id: str) -> None:
        self._change(pair=(query_id, database_id))
        self._pair_panel.show(self._state)

    # The stage is made last: what is made before it reaches it by these.

    def _go(self, way: Way) -> None:
        self._stage.go(way)

    def _take_judged(self, judged: Judged) -> None:
        self._stage.graph.judged(judged)

    def _take_progress(self, fraction: float | None, message: str) -> None:
        self._stage.graph.finding(fraction, message)

    def _take_motion(self, query_id: str, database_id: str, registration: Registration) -> None:
        self._stage.graph.take_motion(query_id, database_id, registration)

    def _register(self) -> None:
        """Show the pair registered."""
        options = replace(self._state.options, layout="registered", compare="both")
        self._set_options(options)

    def _cancel(self) -> None:
        self._runner.cancel()

    def _pick(self, event: viser.SceneClickEvent) -> None:
        """Read the place of a surface that was clicked on; from one of viser's threads."""
        ray = Ray(np.array(event.ray_origin), np.array(event.ray_direction))
        probe = self._scene.pick(ray)
        if probe is None:
            self._inspection.missed()
        else:
            self._change(probe=probe)

    def _reset_camera(self) -> None:
        self._scene.move_cameras(self._scene.camera(self._state))

    # What the worker does.

    def _preview(self, state: ViewState, progress: Progress) -> Picture | None:
        """Show the surfaces, coarse if need be: what is found on them takes longer."""
        if self._painted is not None and states.same_surfaces(self._painted, state):
            return None
        if state.options.layout == "registered" and not self._scene.knows_motion(state):
            return None  # it would jump as soon as the motion is known
        query_map, database_map = infer_quick_maps(
            state.query,
            state.database,
            state.params.map,
            self._timed,
            self._turns.helper,
            self._reported(progress),
        )
        coarse = any(
            made.grid.resolution != state.params.map.resolution
            for made in (query_map, database_map)
        )
        self._painted = None if coarse else state
        return Picture(self._scene.preview(state, (query_map, database_map)), coarse=coarse)

    def _compute(self, state: ViewState, progress: Progress) -> Picture:
        result = register_pair(
            state.query,
            state.database,
            state.params,
            self._timed,
            self._reported(progress),
            helper=self._turns.helper,
        )
        start = time.perf_counter()
        self._painted = state
        shown = self._scene.show(state, result)
        self._timed.add("drawing", time.perf_counter() - start)
        return Picture(shown, result)

    def _reported(self, progress: Progress) -> Progress:
        """Tell the user what goes on, and how far it is, as soon as there is time to read it."""

        def report(fraction: float) -> None:
            progress(fraction)
            self._fraction = fraction
            taken = time.monotonic() - self._began
            if taken > NOTICED:
                self._say_computing()
            if taken > LONG:
                self._status.progress(fraction)

        return report

    def _say_computing(self) -> None:
        if self._word_due:
            self._word_due = False
            self._status.computing()

    def _be_patient(self) -> None:
        """Show how to stop it, even if it reports nothing for a while."""
        self._say_computing()
        self._status.progress(self._fraction)

    def _on_start(self, state: ViewState) -> None:
        del state
        self._began = time.monotonic()
        self._fraction = 0.0
        self._timed = TimedMemo(self._memo)
        self._word_due = True
        self._patience.cancel()
        self._patience = threading.Timer(LONG, self._be_patient)
        self._patience.daemon = True
        self._patience.start()

    def _on_result(self, state: ViewState, picture: Picture, seconds: float) -> None:
        self._word_due = False
        self._show_legend(picture.shown)
        if picture.pair is None:
            if picture.coarse:
                self._verdict.outdate()
            self._status.preview(seconds, coarse=picture.coarse)
        else:
            self._verdict.show(state, picture.pair)
            if self._runner.newer_waits:
                self._status.stale(seconds)
            else:
                self._status.up_to_date(seconds, details(picture.shown, state), self._timed.seconds)
            for part in self._parts:
                part.show(state, picture.pair)
        self._host.flush()

    def _show_legend(self, shown: Shown) -> None:
        scale = shown.scale
        if scale is None:
            self._view_panel.hide_legend()
            return
        made = self._histogram.of(shown.ground)
        self._view_panel.show_legend(
            legend_uri(scale.color_map),
            scale.label,
            scale.unit,
            low=scale.low,
            high=scale.high,
            histogram=made.svg,
            note=made.note,
        )

    def _on_error(self, state: ViewState, error: Exception) -> None:
        del state
        self._outdate(lambda: self._status.error(message_of(error)))

    def _outdate(self, tell: Callable[[], None]) -> None:
        """Say that what is seen is not what is set: on the card, in the scene, and why."""
        self._word_due = False
        self._verdict.outdate("out of date")
        self._scene.outdate()
        tell()
        self._host.flush()

    # Opening another dataset.

    def _take_opened(self, opened: Opened) -> None:
        with self._lock:
            state = begin(opened, self._state.options)
            self._set(state)
        self._params.set_default(opened.params)
        self._params.set(state.params)
        self._view_panel.set(state.options)
        self._summary.show(state.dataset)
        self._pair_panel.show(state)
        camera = self._start_camera(opened)
        if self._stage.subject == "pair":  # the world brings the cameras to itself
            self._scene.move_cameras(camera)
        if opened.saved is not None:
            self._saving.restored()

    def _start_camera(self, opened: Opened) -> Camera:
        """Set, and give, the view that pages begin with."""
        saved = None if opened.saved is None else opened.saved.camera
        camera = saved or self._scene.camera(self._state)
        self._scene.start_camera(camera)
        return camera


def begin(opened: Opened, options: ViewOptions) -> ViewState:
    """Make the first snapshot of what was opened.

    Args:
        opened: The dataset.
        options: Of the view, unless it comes with its own.
    """
    state = states.open_dataset(opened.dataset, opened.params, options, opened.source)
    return state if opened.saved is None else opened.saved.apply(state)


def message_of(error: Exception) -> str:
    """Say what went wrong in one line; what is not the user's doing goes to the log too."""
    if isinstance(error, InputError):
        return str(error)
    _log.error("unexpected error", exc_info=error)
    return f"Unexpected {type(error).__name__}: {error}"


def details(shown: Shown, state: ViewState) -> str:
    """Count what is drawn."""
    parts: list[str] = []
    if shown.num_surfels:
        parts.append(f"{shown.num_surfels:,} cells")
    if shown.num_points:
        parts.append(f"{shown.num_points:,} points")
    if state.options.layout == "registered" and not shown.registered:
        parts.append("no motion found: shown side by side")
    return " · ".join(parts) or "nothing is switched on"
