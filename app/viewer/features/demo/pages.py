"""The pages to take away: a pair in motion, and the world."""

import contextlib
import io
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path

import viser

from app.viewer.features.demo.film import FILM, Shots
from app.viewer.features.demo.story import MOTION_SECONDS, STILL
from app.viewer.features.pair import PairScene
from app.viewer.features.save.figures import Sheet, Written
from app.viewer.features.world import World, WorldScene, relaxation
from app.viewer.scene.cameras import (
    FRAMES_A_SECOND,
    Animation,
    aim_pages,
    blend,
    ease,
    frames,
    set_start,
)
from app.viewer.scene.placement import Canvas
from app.viewer.server.guard import open_server
from app.viewer.server.internals import broadcast, messages
from app.viewer.server.limits import Limits
from app.viewer.session.session_file import Keyframe
from app.viewer.session.state import Camera, ViewState
from app.viewer.web import dress, fill_page_file
from app.viewer.widgets.canvas import BAND
from app.viewer.widgets.legend import canvas_legend, marks_legend
from gpgrad_core.detection import PairResult
from gpgrad_core.errors import count
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.slam import OptimisedGraph

FADES_A_SECOND = 6
"""Pictures of a fade; each has all colours anew."""
PAGE = Canvas(*FILM, bottom=BAND * FILM[1])
"""Stands for the window of a page to come, whose words stand below the picture."""


def write_story(
    state: ViewState,
    result: PairResult,
    keyframes: tuple[Keyframe, ...],
    memo: Memo,
    dark: bool,
    path: Path,
    progress: Progress = silent,
) -> None:
    """Write the page that shows the steps of a pair over and over, as `film` does."""
    shots = Shots(state, result, keyframes, Sheet(*FILM), memo, dark, PAGE)
    whole = len(shots.keyframes)

    def compose(server: viser.ViserServer) -> Composed:
        scene = PairScene(server, memo)
        scene.show(replace(state, options=shots.keyframes[0].options), result)
        steps = ((s, k / whole) for k in range(whole) for s in _play(server, scene, shots, k))
        return Composed(shots.cameras[0], *_in_html(shots.written(0)), steps)

    title = f"{state.dataset.name}: submap {state.query_id} onto {state.database_id}"
    save_page(path, compose, title=title, dark=dark, progress=progress)


def _play(server: viser.ViserServer, scene: PairScene, shots: Shots, k: int) -> Iterator[float]:
    """Draw what leads to a step, and the step: how long each picture stands [s]."""
    motion, before, here = shots.motion(k), shots.cameras[k - 1], shots.cameras[k]
    asked, result = replace(shots.state, options=shots.keyframes[k].options), shots.result
    colors = scene.colors
    scene.show(asked, result)
    glide, fade = scene.gliding(asked, result), scene.fading(colors, result)

    def draw(share: float) -> None:
        if motion == "flight" and glide is not None:
            glide(share)
        elif motion == "fade":
            fade(1.0 - share)
        if before != here:
            aim_pages(server, blend(before, here, share))

    parts = json.dumps(_in_html(shots.written(k)))
    broadcast(server, messages.RunJavascriptMessage(f"gpgradTell({parts})"))
    if shots.moves(k):
        rate = FADES_A_SECOND if motion == "fade" else FRAMES_A_SECOND
        moving = Animation(MOTION_SECONDS[motion], lambda share: draw(ease(share)), rest=0.0)
        yield from frames(moving, rate)
    elif before != here:
        aim_pages(server, here)
    yield STILL


def _in_html(words: Written) -> tuple[str, str, str]:
    """Write title, line and legend of a step."""
    marks = marks_legend(words.counts, words.inliers) if words.counts else ""
    return escape(words.title), escape(words.line), marks + canvas_legend(words.scale, "")


def write_world(
    world: World, solved: OptimisedGraph | None, path: Path, progress: Progress = silent
) -> None:
    """Write the page of a world, which relaxes over and over if it stands at corrected poses."""
    graph = solved if world.options.poses == "corrected" else None
    title = f"{world.dataset.name}: {count(len(world.poses), 'submap')}"

    def compose(server: viser.ViserServer) -> Composed:
        scene = WorldScene(server, visible=True)
        scale = scene.show(world)
        camera = scene.camera()
        assert camera is not None
        line = f"All submaps {words[world.options.poses]}; coloured by {world.options.color}."
        pictures: Iterator[tuple[float, float]] = iter(())
        if graph is not None:
            moving = relaxation(graph, scene.mover())
            whole = round(moving.seconds * FRAMES_A_SECOND)
            pictures = ((s, k / whole) for k, s in enumerate(frames(moving)))
        legend = canvas_legend(scale, "")
        return Composed(camera, escape(title), line, legend, pictures)

    words = {
        "odometry": "at the poses from odometry",
        "true": "at their true poses",
        "in rows": "in rows, because they have no poses",
        "corrected": "moving from odometry to the corrected poses",
    }
    save_page(path, compose, title=title, progress=progress)


@dataclass(frozen=True, eq=False)
class Composed:
    """What a page shows besides its scene."""

    camera: Camera  # the view that it opens with
    title: str  # this, the line below it and the legend are HTML that is safe
    line: str = ""
    legend: str = ""
    # draws what is played over and over: how long each picture stands [s], and the share done
    pictures: Iterable[tuple[float, float]] = ()


def save_page(
    path: Path,
    compose: Callable[[viser.ViserServer], Composed],
    *,
    title: str,
    dark: bool = False,
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
        for seconds, done in composed.pictures:
            serializer.insert_sleep(seconds)
            progress(0.9 * done)
        page = serializer.as_html(dark_mode=dark)
    finally:
        # viser prints when a server stops; that is of no interest here.
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
    card = fill_page_file(
        "page_title.html",
        LOWER_THIRD=fill_page_file("lower_third.css"),
        TITLE=composed.title,
        CAPTION=composed.line,
        LEGEND=composed.legend,
    )
    page = dress(page, ("labels.js", "notice.js"), card)
    start, end = page.index("<title>"), page.index("</title>")
    path.write_text(f"{page[:start]}<title>{escape(title)}{page[end:]}", encoding="utf-8")
