"""The pages to take away: a pair in motion, and the world."""

from collections.abc import Callable
from math import degrees
from pathlib import Path

import viser

from app.viewer.demo.page import Composed, save_page
from app.viewer.draw.animation import Animation, ease
from app.viewer.pair import PairScene
from app.viewer.state import ViewState, registered, with_options
from app.viewer.widgets.legend import legend_html
from app.viewer.world import World, WorldScene, relaxation
from gpgrad_core.pipeline import PairResult
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.slam import OptimisedGraph

GLIDING_SECONDS = 3.5


def gliding(draw: Callable[[float], None]) -> Animation:
    """Let a query glide into place."""
    return Animation(GLIDING_SECONDS, lambda share: draw(ease(share)), rest=1.5)


def write_closure(
    state: ViewState, result: PairResult, path: Path, progress: Progress = silent
) -> None:
    """Write the page of a pair, whose query glides into place over and over.

    Args:
        state: The pair, and how it is drawn.
        result: What was found.
        path: File to write.
        progress: Called once a picture; may raise Cancelled.
    """
    together = with_options(state, registered(state.options))

    def compose(server: viser.ViserServer) -> Composed:
        scene = PairScene(server)
        shown = scene.show(together, result)
        draw = scene.gliding(together, result)
        moving = None if draw is None else gliding(draw)
        camera = scene.camera(state, layout="side by side")
        return Composed(camera, legend_html(shown.scale), moving)

    title = f"{state.dataset.name}: submap {state.query_id} onto {state.database_id}"
    content = save_page(
        compose,
        title=title,
        caption=_verdict(result),
        progress=progress,
    )
    path.write_bytes(content)


def write_world(
    world: World, solved: OptimisedGraph | None, path: Path, progress: Progress = silent
) -> None:
    """Write the page of a world, which relaxes over and over if it stands at corrected poses.

    Args:
        world: All submaps, and how they are drawn.
        solved: The corrected poses, if there are any.
        path: File to write.
        progress: Called once a picture; may raise Cancelled.
    """
    graph = solved if world.options.poses == "corrected" else None

    def compose(server: viser.ViserServer) -> Composed:
        scene = WorldScene(server, visible=True)
        scale = scene.show(world)
        camera = scene.camera()
        assert camera is not None
        moving = None if graph is None else relaxation(graph, scene.mover())
        return Composed(camera, legend_html(scale), moving)

    count = len(world.poses)
    words = {
        "odometry": "at the poses from odometry",
        "true": "at their true poses",
        "in rows": "in rows, because they have no poses",
        "corrected": "moving from odometry to the corrected poses",
    }
    content = save_page(
        compose,
        title=f"{world.dataset.name}: {count} submaps",
        caption=f"All submaps {words[world.options.poses]}; coloured by {world.options.color}.",
        progress=progress,
    )
    path.write_bytes(content)


def _verdict(result: PairResult) -> str:
    """Say in one line what was found."""
    registration = result.registration
    verdict = "Loop closure" if result.closure.accepted else "No loop closure"
    motion = registration.T_database_query
    if motion is None:
        return f"{verdict}: no motion found."
    return (
        f"{verdict}: {registration.num_inliers} inliers, score {registration.score:.2f}; "
        f"offset {motion.x:+z.2f} m, {motion.y:+z.2f} m, turn {degrees(motion.yaw):+z.1f}°."
    )
