"""The canvas of each page: how large it is, what covers it, and what is written over it.

The page watches its canvas and says what becomes of it. What is written over the canvas lets all
clicks through. It hangs on the page's body, because panels that hold it could be put away.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, TypeAlias

import numpy as np
import viser
from msgspec import Meta, Struct

from app.viewer.scene.cameras import set_view, view_of
from app.viewer.scene.layers import Scale
from app.viewer.scene.placement import UNKNOWN_CANVAS, Canvas
from app.viewer.server.host import PANEL_WIDTH, Host, PerPage, pages
from app.viewer.session.state import Camera
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import Bridge, page_script

OnCanvas: TypeAlias = Callable[[viser.ClientHandle], None]

Pixels: TypeAlias = Annotated[float, Meta(ge=0.0, le=100_000.0)]
BAND = 0.16
"""Height that the band takes above the usual margin, as a share of the smaller side."""
PHONE, PHONE_LEGEND = 640.0, 40.0
"""On a canvas at most so wide, the legend is at the head, and takes so much above the usual margin
[pixels]."""
BY_HAND = 0.01
"""A camera that is farther from where it was brought, in distances of what is looked at, was moved
by hand."""


class CanvasMsg(Struct):
    """What a page says of its canvas, and of what covers it at each side."""

    width: Pixels
    height: Pixels
    left: Pixels
    top: Pixels
    right: Pixels
    bottom: Pixels
    below: Pixels = 0.0  # height that the legend takes above what covers the bottom
    dark: bool = True  # whether the page is dark


@dataclass
class _Page:
    canvas: Canvas | None = None  # None until the page reports it
    below: float = 0.0  # see `CanvasMsg`
    dark: bool = True
    brought: tuple[Camera, ...] = ()  # the last views that its camera was moved to


class Canvases:
    """The state of the pages' canvases, and where their cameras were moved."""

    def __init__(self, host: Host, bridge: Bridge) -> None:
        self._bridge = bridge
        self._host, self._pages = host, PerPage[_Page]()
        self._listeners: list[OnCanvas] = []
        self.caption: dict[str, str] = {}  # written over all of them
        # what the colours mean in each subject of the scene; None if nothing is coloured
        self.scales: dict[str, Scale | None] = {}
        self.legends: dict[str, str] = {}  # further legends of a subject, as HTML that is safe
        self.note = ""  # what was done to the pair to show it so, in words
        self.presents = False  # whether words of a demonstration stand in a band at the foot
        style = fill_page_file("lower_third.css")
        for script in ("canvas.js", "swipe.js", "story.js"):
            host.gui.add_html(page_script(script, LOWER_THIRD=style, PANEL_WIDTH=PANEL_WIDTH))
        bridge.on_message("canvas", CanvasMsg, self._take)
        bridge.hear("wide", lambda _page, _data: host.gui.main_panel.set_width(PANEL_WIDTH))

    def tell(self, act: OnCanvas) -> None:
        """Call something whenever a page's canvas is there, or becomes another; must be quick."""
        self._listeners.append(act)

    def of(self, page: viser.ClientHandle) -> Canvas:
        canvas = self._of(page).canvas or UNKNOWN_CANVAS
        if not self.presents:
            return canvas
        # Without its panels a page says nothing: how high the words are follows from story.js.
        bottom, is_phone = BAND * min(canvas.width, canvas.height), canvas.width <= PHONE
        return replace(canvas, bottom=bottom, top=PHONE_LEGEND if is_phone else canvas.top)

    def knows(self, page: viser.ClientHandle) -> bool:
        return self._of(page).canvas is not None

    def is_dark(self, page: viser.ClientHandle) -> bool:
        return self._of(page).dark

    def bring(self, page: viser.ClientHandle, camera: Camera) -> None:
        """Move a page's camera to a view of all that is shown, from which it may be refitted."""
        self.expect(page, camera)
        set_view(page, camera)

    def expect(self, page: viser.ClientHandle, camera: Camera) -> None:
        """Store a view of all that is shown to which something else moves a page's camera."""
        # A page may report one of the last four views late.
        known = self._of(page)
        known.brought = (camera, *known.brought)[:4]

    def is_by_hand(self, page: viser.ClientHandle) -> bool:
        brought = self._of(page).brought
        return bool(brought) and not any(_is_near(view_of(page), camera) for camera in brought)

    def show(self, page: viser.ClientHandle, act: str, data: object) -> None:
        """Write something over a page's canvas: ``caption``, ``full``, ``marks`` and so on."""
        self._bridge.call(page, act, data)

    def show_all(self, act: str, data: object) -> None:
        """Do the same on all pages."""
        for page in pages(self._host).values():
            self.show(page, act, data)

    def measure(self, page: viser.ClientHandle) -> None:
        """Set a page's new shape from its camera: with its panels hidden, it reports nothing else.

        The camera counts other pixels than the page, so that only the shape is certain. The legend
        stays as high as it was.
        """
        canvas, below = self._of(page).canvas, self._of(page).below
        aspect = page.camera.aspect
        if canvas is None or abs(aspect / canvas.aspect - 1.0) < 0.02:  # pixels are whole
            return
        self._set(page, Canvas(canvas.height * aspect, canvas.height, bottom=below))

    def _take(self, page: viser.ClientHandle, said: CanvasMsg) -> None:
        self._of(page).dark = said.dark
        bottom = said.bottom + said.below
        canvas = Canvas(said.width, said.height, said.left, said.top, said.right, bottom)
        across, along = canvas.width - canvas.left - canvas.right, canvas.height - canvas.top
        if across >= 1.0 and along - canvas.bottom >= 1.0:
            self._of(page).below = said.below
            self._set(page, canvas)

    def _set(self, page: viser.ClientHandle, canvas: Canvas) -> None:
        self._of(page).canvas = canvas
        for act in self._listeners:
            act(page)

    def _of(self, page: viser.ClientHandle) -> _Page:
        return self._pages.setdefault(page, _Page())


def _is_near(first: Camera, second: Camera) -> bool:
    reach = BY_HAND * second.distance
    return bool(
        np.linalg.norm(np.subtract(first.position, second.position)) < reach
        and np.linalg.norm(np.subtract(first.look_at, second.look_at)) < reach
    )
