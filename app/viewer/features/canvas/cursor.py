"""From above, the place under the cursor is shown in both submaps, as far as a motion is known."""

import threading
import weakref
from typing import Annotated, TypeAlias

import numpy as np
import viser
from msgspec import Meta, Struct

from app.viewer.features.desk import Desk, Feature
from app.viewer.features.pair import PairScene
from app.viewer.scene.cameras import view_of
from app.viewer.scene.colors import CHOSEN, css
from app.viewer.scene.overlay import line_of_sight, place_on_screen
from app.viewer.scene.picking import Ray
from app.viewer.server.host import pages
from app.viewer.session.runner import Pacer
from app.viewer.session.state import FROM_ABOVE

BETWEEN = 0.05
"""Pause between two answers to a cursor that moves [s]."""
Pixels: TypeAlias = Annotated[float, Meta(ge=-100_000.0, le=100_000.0)]


class CursorSaid(Struct):
    """Where a page's cursor is: pixels from the upper left corner of its canvas."""

    x: Pixels
    y: Pixels


class Cursor(Feature):
    """Marks what is under the cursor of a page, and the same place of the other submap."""

    def __init__(self, desk: Desk, pair: PairScene) -> None:
        """Begin to listen.

        Args:
            desk: Of the session.
            pair: Scene of the pair.
        """
        self._desk = desk
        self._pair = pair
        self._lock = threading.Lock()
        self._at: weakref.WeakKeyDictionary[viser.ClientHandle, tuple[float, float]] = (
            weakref.WeakKeyDictionary()
        )
        self._pacer: Pacer[viser.ClientHandle] = Pacer(self._mark, BETWEEN, "cursor")
        self.workers = (self._pacer,)
        desk.bridge.hear_as("cursor", CursorSaid, self._take)

    def _take(self, page: viser.ClientHandle, cursor: CursorSaid) -> None:
        with self._lock:
            self._at[page] = cursor.x, cursor.y
        self._pacer.ask(page)

    def _mark(self, page: viser.ClientHandle) -> None:
        with self._lock:
            at = self._at.get(page)
        if at is None or page not in pages(self._desk.host).values():
            return
        state, canvases = self._desk.state, self._desk.canvases
        marks: list[list[float]] = []
        if state.options.layout == FROM_ABOVE and self._pair.visible and canvases.knows(page):
            view, canvas = view_of(page), canvases.of(page)
            probe = self._pair.pick(Ray(*line_of_sight(view, canvas, *at)))
            spots = () if probe is None else self._pair.spots(probe)
            for spot in spots:
                place = place_on_screen(view, canvas, spot[None])[0]
                if np.isfinite(place).all():
                    marks.append(np.round(place, 1).tolist())
        canvases.show(page, "marks", {"places": marks, "color": css(CHOSEN)})
