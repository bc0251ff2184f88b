"""The canvas of each page: cameras that fill it with what is shown, and what is written over it."""

import threading
import time
import weakref

import numpy as np
import viser
from jaxtyping import Float

from app.viewer.features.desk import Desk, Feature
from app.viewer.features.pair import BY_HAND, PairScene, headline_of
from app.viewer.features.world import WorldTab
from app.viewer.scene.associations import inlier_color, shown_counts
from app.viewer.scene.cameras import (
    DOWN,
    axes_on_screen,
    length_text,
    place_on_screen,
    scale_bar,
    set_view,
    view_of,
)
from app.viewer.server.host import pages
from app.viewer.session.jobs import Throttle
from app.viewer.session.news import (
    DriveNews,
    PairMoved,
    PairNews,
    PairOutdated,
    PairShown,
    SessionState,
    Subject,
)
from app.viewer.session.state import NEEDS_TWO, Camera, ViewState, same_pair, same_verdict
from app.viewer.widgets.legend import canvas_legend, marks_legend
from gpgrad_core.arrays import Array
from gpgrad_core.errors import count

ARRIVING = 5.0
"""How long the panels of a page that came may take to their place over its canvas [s]."""


class Framing(Feature):
    """Brings cameras to what is new, unless a user has moved them since."""

    def __init__(self, desk: Desk, pair: PairScene, world: WorldTab) -> None:
        self._desk = desk
        self._pair = pair
        self._world = world
        self._subject: Subject = "pair"
        self._framed: tuple[object, ...] | None = None  # what the cameras were brought to
        self._turned = False  # whether the query was turned when they were
        self._is_saved = False  # a saved camera shows it instead
        self._keep_next = False
        self._refit_until = self._arriving_until = 0.0
        self._shown: PairShown | None = None
        self._outdated = self._moved = False
        self._swipe_at: float | None = None  # where pages have its handle
        self._caption: dict[str, str] = {}
        self._watched: weakref.WeakSet[viser.ClientHandle] = weakref.WeakSet()
        self._lock = threading.RLock()  # the pair's worker and the server's loop both frame
        self._throttle: Throttle[viser.ClientHandle] = Throttle(
            desk.jobs,
            self._draw_over,
            0.08,  # [s]
        )
        desk.canvases.tell(self._on_canvas)

    # What the session tells.

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Move the cameras to another pair, layout or canvas; a saved session has its own."""
        opened = state.opened_since(before)
        is_saved = bool(opened and opened.saved and opened.saved.camera)
        with self._lock:
            self._subject = state.subject
            if is_saved or state.subject != before.subject:
                self._framed, self._is_saved = self._present(state.view), is_saved
            else:
                self._frame_if_new(state.view)
            if state.full_screen != before.full_screen:
                self._desk.canvases.show_all("full", {"on": state.full_screen})
            if (state.full_screen, state.left_away) != (before.full_screen, before.left_away):
                self._refit_until = time.monotonic() + 1.5  # by then it has its new size
        self._say()

    def on_pair_result(self, news: PairNews) -> None:
        """Caption the pair, and move the cameras to what needed a motion to be placed."""
        if isinstance(news, PairMoved):
            self._moved = news.by_hand
        elif isinstance(news, PairOutdated):
            self._outdated = True
        else:
            with self._lock:
                self._shown = news if isinstance(news, PairShown) else None
                self._outdated = False
                self._frame_if_new(news.state)
                if self._shown is not None:
                    self._frame_if_turned(news.state)
                self._move_swipe()
        self._say()

    def on_drive(self, news: DriveNews) -> None:
        if news == "drawn":
            self._say()

    def look(self, page: viser.ClientHandle, camera: Camera) -> None:
        """Show a page what is shown from where a link has the camera."""
        with self._lock:
            self._framed, self._is_saved = self._present(self._desk.state), True
            self._arriving_until = time.monotonic() + ARRIVING
            self._refit_until = 0.0  # the panels may have taken another size just before
            set_view(page, camera)

    def keep_cameras(self) -> None:
        self._keep_next = True

    def frame(self, page: viser.ClientHandle | None) -> None:
        """Move the camera of a page, or all, to all that is shown."""
        self._is_saved = False
        for shown in pages(self._desk.host).values() if page is None else (page,):
            self._frame(shown)

    def above(self, page: viser.ClientHandle) -> None:
        """Show all from straight above on a page, without perspective."""
        camera = self._camera(page, DOWN, parallel=True)
        if camera is not None:
            set_view(page, camera)

    # Cameras.

    def _present(self, state: ViewState) -> tuple[object, ...]:
        """Name what is shown; it is framed anew whenever this is another."""
        if self._subject == "world":
            return "world", state.dataset
        pair = state.dataset, state.query_id, state.database_id
        return "pair", *pair, state.options.layout, self._pair.tall, self._pair.is_split

    def _frame_if_new(self, state: ViewState) -> None:
        with self._lock:
            present = self._present(state)
            placed = state.options.layout != "registered" or self._pair.knows_motion(state)
            if self._subject == "world" or present == self._framed or not placed:
                return  # the world is framed once it is drawn
            self._framed, self._is_saved = present, self._keep_next
            self._keep_next, self._turned = False, self._pair.turns(state)
            if not self._is_saved:
                self.frame(None)

    def _frame_if_turned(self, state: ViewState) -> None:
        """Move the cameras to a query that has turned, unless a user or a link moved them."""
        with self._lock:
            turned = self._pair.turns(state)
            if turned == self._turned or self._subject != "pair":
                return
            self._turned = turned
            if not self._is_saved:
                for page in pages(self._desk.host).values():
                    if not self._desk.canvases.is_by_hand(page):
                        self._frame(page)

    def _frame(self, page: viser.ClientHandle, *, from_there: bool = False) -> None:
        """Move a page's camera to all that is shown; it may keep its direction of sight."""
        forward, parallel = None, False
        if from_there:
            view = view_of(page)
            forward, parallel = np.subtract(view.look_at, view.position), view.parallel
        camera = self._camera(page, forward, parallel=parallel)
        if camera is not None:
            self._desk.canvases.bring(page, camera)

    def _camera(
        self, page: viser.ClientHandle, forward: Float[Array, "3"] | None, *, parallel: bool
    ) -> Camera | None:
        canvas = self._desk.canvases.of(page)
        if self._subject == "world":
            return self._world.scene.camera(canvas, forward, parallel=parallel)
        return self._pair.camera(self._desk.state, canvas, forward, parallel=parallel)

    def _on_canvas(self, page: viser.ClientHandle) -> None:
        self._lead()
        with self._lock:
            is_new = page not in self._watched
            if is_new:
                self._watched.add(page)
                self._watch(page)
                self._desk.canvases.show(page, "caption", self._caption)
                self._desk.canvases.show(page, "full", {"on": self._desk.now.full_screen})
            if time.monotonic() < self._refit_until and not is_new:
                self._frame(page, from_there=True)
            elif not self._is_saved and (is_new or not self._desk.canvases.is_by_hand(page)):
                self._frame(page)
        self._throttle.request(page)

    def _watch(self, page: viser.ClientHandle) -> None:
        @page.camera.on_update
        async def _(_camera: viser.CameraHandle) -> None:
            self._desk.canvases.measure(page)
            self._throttle.request(page)

    def _lead(self) -> None:
        canvases = self._desk.canvases
        measured = {
            number: page for number, page in pages(self._desk.host).items() if canvases.knows(page)
        }
        if not measured:
            return
        canvas = canvases.of(measured[min(measured)])
        fitting = canvas.is_tall, canvas.mark_scale
        if fitting != (self._pair.tall, self._pair.mark_scale):
            self._pair.tall, self._pair.mark_scale = fitting
            # A page that comes by a link says its canvas before its panels cover a part of it. The
            # link's camera is that of the canvas that they leave.
            arriving = self._is_saved and time.monotonic() < self._arriving_until
            self._keep_next |= arriving and self._subject == "pair"  # the world is not placed anew
            self._desk.tell_again()

    # What is written over the canvas.

    def _say(self) -> None:
        """Write the caption over all canvases, unless it is there already."""
        with self._lock:
            caption = self._make_caption(self._desk.state)
            if caption == self._caption:
                return
            self._caption = self._desk.canvases.caption = caption
            for page in pages(self._desk.host).values():
                if page in self._watched:
                    self._desk.canvases.show(page, "caption", caption)

    def _make_caption(self, state: ViewState) -> dict[str, str]:
        if self._subject == "world":
            world = self._world.world
            grows = world is not None and world.past is not None and world.past.grows
            shown = len(world.poses if world is not None and grows else state.dataset.submaps)
            title = f"{state.dataset.name}: {count(shown, 'submap')}"
            legend = self._desk.canvases.legends.get("world", "")
            return _caption(title, "", "frame of the poses", legend)
        if not state.is_pair:
            return _caption(f"Submap {state.query_id}", NEEDS_TWO, "frame of the submap")
        line, marks, canvases = "", "", self._desk.canvases
        if self._shown is not None and same_pair(self._shown.state, state):
            result = self._shown.result
            by_hand = self._desk.now.decisions.verdicts.get(self._desk.state.compared_pair)
            line = headline_of(result, with_score=True, decided=by_hand)
            if self._moved:
                line = BY_HAND
            if self._outdated:
                line = f"Out of date: {line}"
            elif not (state.resolved and same_verdict(self._shown.state, state)):
                line = "Computing …"
            counts = shown_counts(result, state.options)
            marks = marks_legend(counts, inlier_color(result)) if counts else ""
            marks = canvases.legends.get("pair") or marks
        return _caption(
            f"Query {state.query_id} → database {state.database_id}",
            line,
            "frame of the database" if self._pair.turns(state) else "frame of each submap",
            marks + canvas_legend(canvases.scales.get("pair"), canvases.note),
        )

    def _move_swipe(self) -> None:
        at = None if self._pair.picture is None else self._pair.picture.swipe_at
        if at != self._swipe_at:
            self._swipe_at = at
            for page in self._watched:
                self._throttle.request(page)

    def _draw_over(self, page: viser.ClientHandle) -> None:
        if page not in pages(self._desk.host).values() or not self._desk.canvases.knows(page):
            return
        camera, canvas = view_of(page), self._desk.canvases.of(page)
        bar, above = scale_bar(camera, canvas), camera.looks_down
        known = self._subject == "world" and self._desk.state.dataset.origin is not None
        picture = self._pair.picture if self._subject == "pair" else None
        way = np.zeros((0, 3)) if picture is None else picture.swipe_way
        places = np.nan_to_num(place_on_screen(camera, canvas, way)).round(1).tolist()
        self._desk.canvases.show(
            page,
            "camera",
            {
                "share": round(bar.pixels / canvas.height, 6),
                "length": length_text(bar.metres),
                "axes": np.round(axes_on_screen(camera), 3).tolist(),
                "above": above,
                "north": above and known,
                "swipe": {"way": places, "share": self._desk.state.options.swipe},
            },
        )


def _caption(title: str, line: str, frame: str, legend: str = "") -> dict[str, str]:
    return {"title": title, "line": line, "frame": frame, "cursor": "followed", "legend": legend}
