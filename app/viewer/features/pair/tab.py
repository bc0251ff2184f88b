"""The pair: wires the choice of two submaps to the pipeline, and its result to the picture."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Literal, TypeAlias

import msgspec
import viser

from app.viewer.features.desk import Desk, Feature, Frame
from app.viewer.features.pair.panel import DatasetSummary, ViewPanel
from app.viewer.features.pair.picture import Picture, draw_histogram
from app.viewer.features.pair.scene import PairScene
from app.viewer.features.pair.status import PictureStatus
from app.viewer.features.pair.verdict import VerdictCard
from app.viewer.features.work import message_of
from app.viewer.scene.cameras import set_start, set_view
from app.viewer.server.host import pages
from app.viewer.session.jobs import Lane
from app.viewer.session.layers import COMPARED, LAYERS
from app.viewer.session.methods import METHODS, register_pair
from app.viewer.session.news import (
    AllPairs,
    PairMoved,
    PairNews,
    PairOutdated,
    PairShown,
    SessionState,
    SubmapShown,
    Verdicts,
)
from app.viewer.session.session_file import Opened
from app.viewer.session.state import (
    FROM_ABOVE,
    Camera,
    Role,
    ViewOptions,
    ViewState,
    registered,
    same_search,
    same_surfaces,
)
from app.viewer.widgets.bridge import page_script
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import PageTitle
from gpgrad_core.detection import PairResult, infer_map, judge_pair
from gpgrad_core.detection.pipeline import infer_quick_map, infer_quick_maps
from gpgrad_core.errors import count
from gpgrad_core.run import Cancelled, Progress
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Context

BEFORE_FIT = 0.3
"""Seconds between a whole picture and the fit of the numbers that are automatic."""


@dataclass(frozen=True, eq=False)
class Shown:
    """What the worker has shown."""

    picture: Picture
    # whether it is all there; or the rest is under way, and its surfaces are coarse or whole; or
    # numbers of before stand in for automatic ones, which are being fitted
    progress: Literal["coarse", "surfaces", "fit due", "all"] = "all"


def say_of(verdicts: Verdicts | None, state: ViewState) -> Context | None:
    """The context of the pair shown; None if the pairs were judged otherwise."""
    registered_by = METHODS[state.method].registered_by
    if (
        verdicts is None
        or not same_search(verdicts.state, state)
        or registered_by(state.given) != registered_by(verdicts.params)
        or state.given.closure.others != verdicts.params.closure.others
    ):
        return None
    pair = state.query_id, state.database_id
    return next((one.context for one in verdicts.found.closures if one.pair == pair), None)


def judged_pair(desk: Desk, state: ViewState, memo: Memo, progress: Progress) -> PairResult:
    """Register the pair of a state, and judge it, also by what the other pairs say of it."""
    helper = desk.capacity.helper
    result = register_pair(
        *state.pair, state.given, memo, progress, helper=helper, method=state.method
    )
    context, own = say_of(desk.verdicts, state), result.registration
    if context is not None and own.agreement is not None:  # it is judged once more
        closure = judge_pair(*state.pair, own, state.given, memo, context)
        result = replace(result, registration=closure.registration, closure=closure)
    return result


Share: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]


class CellsMsg(msgspec.Struct):
    """Ends of a stretch of the histogram, as shares of its width."""

    low: Share
    high: Share


class SwipeMsg(msgspec.Struct):
    """Where the swipe is dragged to, as a share of its way."""

    share: Share


class PairTab(Feature):
    """Shows the pair of the session: one worker turns the newest state into a picture."""

    def __init__(self, desk: Desk, opened: Opened, view: viser.GuiTabHandle) -> None:
        """Make verdict and status in the current container, and the options in the view's tab."""
        self._desk = desk
        host, state = desk.host, desk.state
        self.scene = PairScene(host, desk.memo, standalone=False)
        self._title = PageTitle(host)
        self._verdict = VerdictCard(host)
        self._status = PictureStatus(
            host, desk.bridge, desk.jobs, desk.memo, self._cancel, self._mark_outdated
        )
        with view:
            self._summary = DatasetSummary(host)
            self._summary.show(state.dataset)
            self._view = ViewPanel(host, state.options, self._choose_options, desk.numbers)
            host.gui.add_html(page_script("histogram.js"))
        desk.bridge.on_message("cells", CellsMsg, lambda _, at: self._view.pick(at.low, at.high))
        desk.bridge.on_message("swipe", SwipeMsg, self._swipe)
        self._verdict.decide(desk.now.decisions)
        self._painted: ViewState | None = None  # whose full surfaces are shown
        self._fitted: ViewState | None = None  # the last one whose automatic numbers were fitted
        self._stood_in: ViewState | None = None  # shown with those of before
        self._preview_shown: Picture | None = None  # while the rest is being computed
        self._start_camera(opened)
        self._runner: Lane[ViewState, Shown] = Lane(
            desk.jobs,
            self.compute,
            self._on_result,
            self._on_error,
            on_cancel=lambda _: self._outdate(self._status.cancelled),
            previews=(self.preview, self.stand_in),
            slots=desk.capacity.pictures,
        )

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Compute and draw the new state, and show it in the widgets.

        The rail is left to the map: a pair that is not on the canvas has no card beside it.
        """
        view, on_canvas = state.view, state.subject == "pair"
        let_go = state.moving != before.moving and self.scene.hold_range(on=state.moving)
        if view is not before.view or state is before or let_go:
            self._runner.submit(view)
        if view.options != self._view.value:
            self._view.set(view.options)
        self._title.show(view.names if on_canvas else "All submaps", view.dataset.name)
        if opened := state.opened_since(before):
            self._on_opened(opened)
        if state.subject != before.subject:
            self._verdict.visible = self._status.visible = on_canvas
        if state.decisions is not before.decisions:
            self._verdict.decide(state.decisions)

    def _on_opened(self, opened: Opened) -> None:
        """Show what is open, and move the cameras to it."""
        self._summary.show(opened.dataset)
        self._start_camera(opened)
        saved = None if opened.saved is None else opened.saved.camera
        if saved is not None and self.scene.visible:
            self._move_cameras(saved)

    def on_pair_result(self, news: PairNews) -> None:
        """Show that the placement is not judged."""
        if isinstance(news, PairMoved):
            self._verdict.set_moved(news.by_hand)

    def on_pairs(self, before: AllPairs, pairs: AllPairs) -> None:
        """Judge the pair shown once more, if the others say something new of it."""
        state = self._desk.state
        if pairs.verdicts is not before.verdicts and (
            say_of(pairs.verdicts, state) != say_of(before.verdicts, state)
        ):
            self._desk.tell_again()

    def close(self) -> None:
        """Stop blinking; what was shown stays until its page goes."""
        self.scene.close()

    def refuse(self, message: str) -> None:
        self._status.refused(message)
        if not self._status.visible:
            for page in pages(self._desk.host).values():
                page.add_notification("Not taken", message, with_close_button=True, color="red")

    def _cancel(self) -> None:
        self._runner.cancel()

    def _choose_options(self, options: ViewOptions) -> None:
        self._desk.change(options=options)

    def _swipe(self, _page: viser.ClientHandle, to: SwipeMsg) -> None:
        self._choose_options(replace(self._desk.state.options, swipe=round(to.share, 2)))

    # What the worker does.

    def preview(self, state: ViewState, progress: Progress) -> Shown | None:
        """Show the surfaces, coarse if need be: what follows from them takes longer."""
        self._status.begin()
        if self._painted is not None and same_surfaces(self._painted, state):
            return None
        if state.options.layout == "registered" and not self.scene.knows_motion(state):
            return None  # it would jump as soon as the motion is there
        memo, told = self._status.memo, self._status.reported(progress)
        # Until they are fitted, the numbers of before stand in.
        submaps = state.pair if state.is_pair else (state.query,)
        params = [
            METHODS[state.method].of_submap(submap, state.given, memo, told).map
            if state.resolved
            else state.params.map
            for submap in submaps
        ]
        if state.is_pair and params[0] == params[1]:
            maps = infer_quick_maps(*state.pair, params[0], memo, self._desk.capacity.helper, told)
        else:
            maps = tuple(
                infer_quick_map(submap, numbers, memo, told)
                for submap, numbers in zip(submaps, params, strict=True)
            )
        coarse = any(made.grid.resolution != state.params.map.resolution for made in maps)
        self._painted = None if coarse else state
        return Shown(self.scene.preview(state, maps), "coarse" if coarse else "surfaces")

    def stand_in(self, state: ViewState, progress: Progress) -> Shown | None:
        """Show all that comes of the pair with the last fitted numbers: a fit takes seconds."""
        before = self._fitted
        if (
            state.resolved
            or before is None
            or before.dataset is not state.dataset
            or before.method != state.method
            or METHODS[state.method].fits_each
        ):
            return None
        self._stood_in = state
        return Shown(self._picture_of(state, progress), "fit due")

    def compute(self, state: ViewState, progress: Progress) -> Shown:
        """Register the pair, and show all that comes of it."""
        if state.resolved:
            self._fitted = state
            return Shown(self._picture_of(state, progress))
        submaps, memo = state.dataset.submaps, self._desk.memo
        resolve = METHODS[state.method].resolve
        told = self._status.reported(progress)
        if self._stood_in is state:  # the hand may move on, and pages draw: a fit takes all cores
            end = time.monotonic() + BEFORE_FIT
            while time.monotonic() < end:
                told(0.0)
                time.sleep(0.02)
        self._desk.resolve(state, resolve(submaps, state.query, state.asked, memo, told))
        raise Cancelled  # the state with the fitted numbers waits by now, or a newer one

    def _picture_of(self, state: ViewState, progress: Progress) -> Picture:
        told = self._status.reported(progress)
        if not state.is_pair:
            params = METHODS[state.method].of_submap(
                state.query, state.given, self._status.memo, told
            )
            alone = infer_map(state.query, params, self._status.memo, told)
            self._painted = state
            with self._status.drawing():
                return self.scene.preview(state, (alone,))
        result = judged_pair(self._desk, state, self._status.memo, told)
        self._painted = state
        with self._status.drawing():
            self.scene.ease_range(state, result, told)
            return self.scene.show(state, result)

    def _on_result(self, state: ViewState, shown: Shown, seconds: float) -> None:
        picture, result = shown.picture, shown.picture.result
        if shown.progress in ("coarse", "surfaces"):
            self._preview_shown = picture
            self._status.preview(seconds, coarse=shown.progress == "coarse")
        else:
            self._preview_shown = None
            self._show_legend(picture)
            fits, waits = shown.progress == "fit due", self._runner.newer_waits
            with self._desk.host.atomic():
                coming = "fitting …" if fits else "computing …" if waits else ""
                self._verdict.show(state, result, coming=coming if result else "")
                if fits:
                    self._status.fitting(seconds)
                else:
                    self._status.finished(seconds, details(picture, state), newer_waits=waits)
            if result is not None:
                self._tell(PairShown(state, result))
            else:
                self._tell(SubmapShown(state, picture.maps[0]))
        self._desk.host.flush()

    def _mark_outdated(self) -> None:
        """Fade the verdict, and show the legend of the preview: the rest takes a while."""
        if self._preview_shown is not None:
            self._show_legend(self._preview_shown)
        self._verdict.wait_for(self._desk.state)
        self._desk.host.flush()

    def _show_legend(self, picture: Picture) -> None:
        scale = picture.scale
        self._desk.canvases.scales["pair"], self._desk.canvases.note = scale, picture.note
        self._view.show_range(scale)
        self._view.show_legend(scale, *(draw_histogram(picture, scale) if scale else ()))

    def _on_error(self, _state: ViewState, error: Exception) -> None:
        self._outdate(lambda: self._status.failed(message_of(error)))

    def _outdate(self, tell: Callable[[], None]) -> None:
        """Mark the picture as out of date: on the card, in the scene, and why."""
        self._mark_outdated()
        self._verdict.outdate("out of date")
        self._tell(PairOutdated())
        tell()
        self._desk.host.flush()

    def _tell(self, news: PairNews) -> None:
        self._desk.notify(lambda feature: feature.on_pair_result(news))

    def _start_camera(self, opened: Opened) -> None:
        """Set the view that pages begin with, before they say how large their canvas is."""
        saved = None if opened.saved is None else opened.saved.camera
        camera = saved or self.scene.camera(self._desk.state)
        if isinstance(self._desk.host, viser.ViserServer):
            set_start(self._desk.host, camera)
        else:
            self._move_cameras(camera)  # the page is open already

    def _move_cameras(self, camera: Camera) -> None:
        for page in pages(self._desk.host).values():
            set_view(page, camera)


def details(picture: Picture, state: ViewState) -> str:
    """Count what is drawn."""
    parts: list[str] = []
    if picture.num_surfels:
        parts.append(count(picture.num_surfels, "cell"))
    if picture.num_points:
        parts.append(count(picture.num_points, "point"))
    if not state.is_pair:
        if state.options.layer in COMPARED:
            parts.append("this layer compares two submaps, and there is one")
    elif state.options.layout == "registered" and not picture.is_registered:
        parts.append("no motion found: shown side by side")
    return " · ".join(parts) or "everything is hidden"


SWITCHES = (
    ("Inlier lines", "I", "inlier_lines"),
    ("Outlier lines", "O", "outlier_lines"),
    ("All lines, or a few of each kind", "shift+O", "all_lines"),
    ("Keypoints", "K", "keypoints"),
    ("Other keypoints: outliers, and those without a partner", None, "other_keypoints"),
    ("Frames of the submaps", None, "frames"),
    ("Point clouds", "C", "clouds"),
    ("Surfaces", None, "surfaces"),
    ("Hillshade", None, "hillshade"),
    ("Raw frames: each submap in its own", None, "raw_frames"),
)
"""Options that a key shows or hides."""
STEPS: tuple[tuple[Role, int, str, str | None], ...] = (
    ("query", 1, "J", None),
    ("query", -1, "J", "shift"),
    ("database", 1, "M", None),
    ("database", -1, "M", "shift"),
)
"""Keys that step through the submaps in a role."""


def add_shortcuts(
    commands: Commands,
    desk: Desk,
    frame: Frame,
    above: Callable[[viser.ClientHandle], None],
    step_match: Callable[[int], None],
) -> None:
    """Add the commands to the palette: keys for what people do often.

    ``above`` has a page look straight down, and ``step_match`` points at the next (1) or the
    previous (-1) association.
    """

    def show(**changes: object) -> None:
        desk.change(options=changed(desk.state.options, **changes))

    def choose(group: str, label: str, key: str | None, **changes: object) -> None:
        commands.add(group, label, lambda: show(**changes), key=key)

    def compare(label: str, key: str | None, **changes: object) -> None:
        choose("Compare", label, key, layout="registered", **changes)

    def other_layout() -> None:
        is_registered = desk.state.options.layout == "registered"
        show(layout="side by side" if is_registered else "registered")

    def both() -> None:
        options = registered(desk.state.options)
        # Out of what compares them too: it shows neither of the two.
        layer = ViewOptions.layer if options.layer in COMPARED else options.layer
        desk.change(options=changed(options, layer=layer))

    def switch(name: str) -> None:
        show(**{name: not getattr(desk.state.options, name)})

    commands.add_for_page("View", "All of it in view", frame, key="R")
    commands.add_for_page("View", "From above, without perspective", above, key="T")
    for theme, name in (("dark", "dark"), ("light", "light"), ("system", "as the system is")):
        choose_theme = partial(desk.canvases.show, act="theme", data=theme)
        commands.add_for_page("View", f"Theme: {name}", choose_theme)
    commands.add("View", "Side by side or registered", other_layout, key="L")
    choose("View", "Gradient of both from above", None, layout=FROM_ABOVE)
    compare("Blink: one after the other", "B", compare="blink")
    compare("Swipe: left and right of a line", "V", compare="swipe")
    compare("Height difference of the registered maps", "Y", compare="both", layer="difference")
    compare("Agreement of the registered maps", None, compare="both", layer="agreement")
    commands.add("Compare", "Both at once", both, key="Z")
    commands.add("Association", "Next association", partial(step_match, 1), key="N")
    commands.add("Association", "Previous association", partial(step_match, -1), key="P")
    no_choice = partial(desk.change, match=0, probe=None)
    commands.add("Association", "Choose no association and no place", no_choice, key="U")
    for role, step, key, modifier in STEPS:
        label = f"{'Next' if step > 0 else 'Previous'} {role}"
        commands.add("Pair", label, partial(desk.step, role, step), key=key, modifier=modifier)
    for label, key, name in SWITCHES:
        modifier, _, letter = (key or "").rpartition("+")
        act = partial(switch, name)
        commands.add("Show or hide", label, act, key=letter or None, modifier=modifier or None)
    for number, layer in enumerate(LAYERS.values(), start=1):
        key = str(number) if number <= 8 else None  # 9 and 0 have another meaning
        choose("Layer", layer.words.capitalize(), key, layer=layer.name)


def changed(options: ViewOptions, **changes: object) -> ViewOptions:
    """Copy options with some of them changed; a layer also switches the surfaces on."""
    if "layer" in changes:
        changes = {"surfaces": True} | changes
    return replace(options, **changes)
