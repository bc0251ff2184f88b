"""A scene as one HTML file: it opens from disk, needs no server and no network, and moves.

The scene is built anew on a server of its own that nobody visits. So whatever is shown to
others stands still meanwhile, and a page's own scene can be saved like a shared one.
"""

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from html import escape

import viser

from app.viewer.door.limits import Limits
from app.viewer.door.server import open_server
from app.viewer.draw.animation import Animation, frames
from app.viewer.draw.cameras import set_start
from app.viewer.draw.placement import Camera
from app.viewer.web import fill_page_file
from gpgrad_core.run.progress import Progress, silent

DARK, LIGHT = ("#e6e6e6", "rgba(30,30,30,.82)"), ("#222", "rgba(255,255,255,.85)")


@dataclass(frozen=True, eq=False)
class Composed:
    """What a page shows besides its scene.

    Attributes:
        camera: The view that it opens with.
        legend: What the colours mean, as HTML that is safe.
        moving: Played over and over; None for a scene that stands still.
    """

    camera: Camera
    legend: str = ""
    moving: Animation | None = None


def save_page(
    compose: Callable[[viser.ViserServer], Composed],
    *,
    title: str,
    caption: str,
    dark: bool = False,
    progress: Progress = silent,
) -> bytes:
    """Build a scene and save it as an HTML page.

    Args:
        compose: Fills the scene of a fresh server.
        title: Headline, also of the browser's tab.
        caption: A line below it.
        dark: Light writing on a dark ground.
        progress: Called once a picture of what moves; may raise Cancelled.
    """
    server, _ = open_server("127.0.0.1", 0, limits=Limits(pages=0))
    try:
        server.scene.set_up_direction("+z")
        server.scene.configure_environment_map(None)
        composed = compose(server)
        set_start(server, composed.camera)
        serializer = server.get_scene_serializer()
        if composed.moving is not None:
            passed, total = 0.0, composed.moving.seconds + 2 * composed.moving.rest
            for seconds in frames(composed.moving):
                serializer.insert_sleep(seconds)
                passed += seconds
                progress(0.9 * min(passed / total, 1.0))
        page = serializer.as_html(dark_mode=dark)
    finally:
        # viser prints when a server stops; that is of no interest here.
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
    return with_title(page, title, caption, composed.legend, dark=dark).encode("utf-8")


def with_title(page: str, title: str, caption: str, legend: str, *, dark: bool) -> str:
    """Add a headline and a legend to a page that viser wrote.

    Raises:
        ValueError: If the page is not what viser writes.
    """
    color, ground = DARK if dark else LIGHT
    card = fill_page_file(
        "page_title.html",
        COLOR=color,
        GROUND=ground,
        TITLE=escape(title),
        CAPTION=escape(caption),
        LEGEND=legend,
    )
    body = page.index("<body")
    inside = page.index(">", body) + 1
    page = page[:inside] + card + page[inside:]
    start, end = page.index("<title>"), page.index("</title>")
    return f"{page[:start]}<title>{escape(title)}{page[end:]}"
