"""The pages to take away: a pair in motion, and the world."""

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from html import escape
from math import degrees
from pathlib import Path

import viser

from app.viewer.features.pair import PairScene, headline_of
from app.viewer.features.world import World, WorldScene, relaxation
from app.viewer.scene.cameras import Animation, ease, frames, set_start
from app.viewer.server.guard import open_server
from app.viewer.server.limits import Limits
from app.viewer.session.state import Camera, ViewState, registered
from app.viewer.web import fill_page_file
from app.viewer.widgets.legend import legend_html
from gpgrad_core.detection import PairResult
from gpgrad_core.errors import count, score_in_words
from gpgrad_core.run import Progress, silent
from gpgrad_core.slam import OptimisedGraph

GLIDING_SECONDS = 3.5


def gliding(draw: Callable[[float], None]) -> Animation:
    """Let a query glide into place."""
    return Animation(GLIDING_SECONDS, lambda share: draw(ease(share)), rest=1.5)


def write_closure(
    state: ViewState, result: PairResult, path: Path, progress: Progress = silent
) -> None:
    """Write the page of a pair, whose query glides into place over and over."""
    together = replace(state, options=registered(state.options))

    def compose(server: viser.ViserServer) -> Composed:
        scene = PairScene(server)
        shown = scene.show(together, result)
        draw = scene.gliding(together, result)
        moving = None if draw is None else gliding(draw)
        camera = scene.camera(state, layout="side by side")
        return Composed(camera, legend_html(shown.scale), moving)

    save_page(
        path,
        compose,
        title=f"{state.dataset.name}: submap {state.query_id} onto {state.database_id}",
        caption=f"{_verdict(result)} Blue is the query {state.query_id}, orange the database "
        f"{state.database_id}.",
        progress=progress,
    )


def write_world(
    world: World, solved: OptimisedGraph | None, path: Path, progress: Progress = silent
) -> None:
    """Write the page of a world, which relaxes over and over if it stands at corrected poses."""
    graph = solved if world.options.poses == "corrected" else None

    def compose(server: viser.ViserServer) -> Composed:
        scene = WorldScene(server, visible=True)
        scale = scene.show(world)
        camera = scene.camera()
        assert camera is not None
        moving = None if graph is None else relaxation(graph, scene.mover())
        return Composed(camera, legend_html(scale), moving)

    words = {
        "odometry": "at the poses from odometry",
        "true": "at their true poses",
        "in rows": "in rows, because they have no poses",
        "corrected": "moving from odometry to the corrected poses",
    }
    save_page(
        path,
        compose,
        title=f"{world.dataset.name}: {count(len(world.poses), 'submap')}",
        caption=f"All submaps {words[world.options.poses]}; coloured by {world.options.color}.",
        progress=progress,
    )


def _verdict(result: PairResult) -> str:
    registration = result.registration
    verdict = headline_of(result)
    motion = registration.T_database_query
    if motion is None:
        return f"{verdict}: no motion found."
    score = score_in_words(registration.score)
    return (
        f"{verdict}: {count(registration.num_inliers, 'inlier')}, score {score}; "
        f"offset {motion.x:+z.2f} m, {motion.y:+z.2f} m, turn {degrees(motion.yaw):+z.1f}°."
    )


@dataclass(frozen=True, eq=False)
class Composed:
    """What a page shows besides its scene."""

    camera: Camera  # the view that it opens with
    legend: str = ""  # what the colours mean, as HTML that is safe
    moving: Animation | None = None  # played over and over; None for a scene that stands still


def save_page(
    path: Path,
    compose: Callable[[viser.ViserServer], Composed],
    *,
    title: str,
    caption: str,
    progress: Progress = silent,
) -> None:
    """Build a scene and save it as an HTML page."""
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
        page = serializer.as_html()
    finally:
        # viser prints when a server stops; that is of no interest here.
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
    title = escape(title)
    card = fill_page_file(
        "page_title.html", TITLE=title, CAPTION=escape(caption), LEGEND=composed.legend
    )
    inside = page.index(">", page.index("<body")) + 1  # of a page that viser wrote
    page = page[:inside] + card + page[inside:]
    start, end = page.index("<title>"), page.index("</title>")
    path.write_text(f"{page[:start]}<title>{title}{page[end:]}", encoding="utf-8")
