"""Cameras: what they see, their bookmarks and flights, and animations, which draw any moment."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import viser
from jaxtyping import Float

from app.viewer.charts import round_length
from app.viewer.scene.placement import Canvas, axes_of_view
from app.viewer.server.internals import broadcast, messages, send_to
from app.viewer.session.state import PARALLEL, Camera
from gpgrad_core.arrays import Array
from gpgrad_core.run import Progress, silent
from gpgrad_core.se2 import SE2

Bookmark: TypeAlias = Literal["top", "oblique", "follow loop"]

BOOKMARKS: tuple[Bookmark, ...] = get_args(Bookmark)
NEARLY_DOWN = 0.002
"""Sine of the angle off the vertical from which the top view looks: north stays up."""
DOWN = np.array([0.0, NEARLY_DOWN, -1.0])
"""Direction of sight of the top view."""
NEAR, NEAR_SHARE = 0.01, 50.0
"""What is nearer than this [m], or than this part of the way in a parallel view, is cut off."""
FAR, FAR_DISTANCES = 1000.0, 10.0
"""What is farther away than this [m], and than so many distances of what is looked at, is cut off.
"""
FOLLOW_BACK, FOLLOW_UP = 0.5, 0.35
"""How far behind and above the robot the camera flies, as shares of the way's extent."""
FOLLOW_AHEAD = 0.06
"""How far ahead it looks, as a share of the way's length."""
FRAMES_A_SECOND = 24


def top(oblique: Camera) -> Camera:
    """Look straight down on what another view shows, from as far away."""
    look_at = np.array(oblique.look_at)
    return Camera.at(look_at + oblique.distance * np.array([0.0, -NEARLY_DOWN, 1.0]), look_at)


def blend(start: Camera, end: Camera, share: float) -> Camera:
    """Interpolate between two views round what is looked at, not down through the ground."""
    start, end = start.with_perspective, end.with_perspective
    looks = np.array(start.look_at), np.array(end.look_at)
    arms = np.array(start.position) - looks[0], np.array(end.position) - looks[1]
    lengths = [float(np.linalg.norm(arm)) or 1.0 for arm in arms]
    direction = (1 - share) * arms[0] / lengths[0] + share * arms[1] / lengths[1]
    norm = float(np.linalg.norm(direction))
    if norm < 1e-6:  # from opposite sides: over the top
        direction, norm = np.array([0.0, -NEARLY_DOWN, 1.0]), 1.0
    length = lengths[0] ** (1 - share) * lengths[1] ** share
    look_at = (1 - share) * looks[0] + share * looks[1]
    return Camera.at(look_at + length * direction / norm, look_at)


def follow(path: Float[Array, "n 3"], share: float) -> Camera:
    """Follow a path of two or more places [m] from behind and above, at a share of its length."""
    extent = float(np.linalg.norm(np.ptp(path, axis=0)[:2])) or 1.0
    here, ahead = _along(path, share), _along(path, share + FOLLOW_AHEAD)
    behind = _along(path, share - FOLLOW_AHEAD)
    heading = (ahead - behind) * np.array([1.0, 1.0, 0.0])
    heading /= max(float(np.linalg.norm(heading)), 1e-9)
    position = here - FOLLOW_BACK * extent * heading + np.array([0.0, 0.0, FOLLOW_UP * extent])
    return Camera.at(position, here)


def orbit(camera: Camera, share: float) -> Camera:
    """Orbit the point that a view looks at, by a share of the full circle."""
    look_at = np.array(camera.look_at)
    arm = np.array(camera.position) - look_at
    around = SE2(yaw=2 * np.pi * share).apply(arm[None, :2])[0]
    return Camera.at(look_at + np.array([*around, arm[2]]), look_at)


def view_of(client: viser.ClientHandle) -> Camera:
    """Read the view that a page has."""
    view = client.camera
    narrow = view.fov < 2 * PARALLEL
    return Camera.at(np.array(view.position), np.array(view.look_at), parallel=bool(narrow))


def set_view(client: viser.ClientHandle, camera: Camera) -> None:
    """Set the view of a page."""
    with client.atomic():
        _aim(client.camera, camera)
        # A new position takes the point that is looked at along. If the page reports just then that
        # it looks where it should, from a view before, viser has nothing to set and sends nothing.
        send_to(client, messages.SetCameraPositionMessage(camera.position))
        send_to(client, messages.SetCameraLookAtMessage(camera.look_at))
    client.flush()


def aim_pages(server: viser.ViserServer, camera: Camera) -> None:
    """Set the view of all pages, and of a recording."""
    broadcast(server, messages.SetCameraPositionMessage(camera.position))
    broadcast(server, messages.SetCameraLookAtMessage(camera.look_at))


def set_start(server: viser.ViserServer, camera: Camera) -> None:
    """Set the view that new pages, and "reset view", begin with."""
    _aim(server.initial_camera, camera)


def _aim(view: Any, camera: Camera) -> None:
    """Set where a view looks from and to; viser's kinds of views have no common class."""
    view.far = max(FAR, FAR_DISTANCES * camera.distance)
    # The browser resolves depths by their ratio to the nearest.
    view.near = camera.distance / NEAR_SHARE if camera.parallel else NEAR
    view.fov = camera.field_of_view
    view.position = camera.position
    view.look_at = camera.look_at


@dataclass(frozen=True)
class ScaleBar:
    """A bar of a round length."""

    pixels: float  # its length on the screen
    metres: float  # what that is across the line of sight, at the distance of what is looked at


def scale_bar(camera: Camera, canvas: Canvas) -> ScaleBar:
    """Make the bar for a camera and a canvas."""
    per_pixel = max(camera.distance, 1e-6) / canvas.focal_length(camera)
    free = canvas.width - canvas.left - canvas.right
    metres = round_length(min(free / 6, 220.0) * per_pixel)
    return ScaleBar(metres / per_pixel, metres)


def length_text(metres: float) -> str:
    """Write a round length.

    >>> length_text(0.05), length_text(20.0), length_text(2000.0)
    ('5 cm', '20 m', '2 km')
    """
    if metres >= 1000.0:
        return f"{metres / 1000.0:g} km"
    return f"{metres:g} m" if metres >= 0.1 else f"{round(100.0 * metres, 6):g} cm"


def axes_on_screen(camera: Camera) -> Float[Array, "2 2"]:
    """Project the scene's axes x and y onto the screen: to the right, and down; at most 1."""
    _, right, up = axes_of_view(camera.sight)
    return np.column_stack([right, -up])[:2]


def place_on_screen(
    camera: Camera, canvas: Canvas, points: Float[Array, "n 3"]
) -> Float[Array, "n 2"]:
    """Project points of the scene [m] onto a canvas, in its pixels; those behind are NaN."""
    forward, right, up = axes_of_view(camera.sight)
    offset = points - np.array(camera.position)
    depth = offset @ forward
    depth = np.where(depth > 0, depth, np.nan)
    scale = canvas.focal_length(camera) / depth
    return np.column_stack(
        [canvas.width / 2 + scale * (offset @ right), canvas.height / 2 - scale * (offset @ up)]
    )


def line_of_sight(
    camera: Camera, canvas: Canvas, x: float, y: float
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """The eye [m] and the direction of sight of a pixel, counted from the upper left."""
    forward, right, up = axes_of_view(camera.sight)
    offset = (x - canvas.width / 2) * right + (canvas.height / 2 - y) * up
    return np.array(camera.position, dtype=float), forward + offset / canvas.focal_length(camera)


@dataclass(frozen=True, eq=False)
class Animation:
    """A function that draws any moment of a motion."""

    seconds: float  # how long it takes
    draw: Callable[[float], None]  # draws the moment at a share of the whole in [0, 1]
    # how long the first and the last moment stand still, where it is played over and over [s]
    rest: float = 1.0


def play(animation: Animation, progress: Progress = silent) -> None:
    """Play once, in real time: a slow machine shows fewer pictures. Progress may cancel it."""
    start = time.monotonic()
    share = 0.0
    while share < 1.0:
        share = min((time.monotonic() - start) / max(animation.seconds, 1e-6), 1.0)
        progress(share)
        animation.draw(share)
        time.sleep(1 / FRAMES_A_SECOND)


def frames(animation: Animation, rate: float = FRAMES_A_SECOND) -> Iterator[float]:
    """Draw so many pictures a second, and give how long each stands [s]."""
    count = max(2, round(animation.seconds * rate) + 1)
    for k in range(count):
        animation.draw(k / (count - 1))
        resting = animation.rest if k in (0, count - 1) else 0.0
        yield 1 / rate + resting


def ease(share: float) -> float:
    """Ease in and out.

    >>> ease(0.0), ease(0.5), ease(1.0)
    (0.0, 0.5, 1.0)
    """
    return share * share * (3.0 - 2.0 * share)


def _along(path: Float[Array, "n 3"], share: float) -> Float[Array, "3"]:
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    places = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.clip(share, 0.0, 1.0) * places[-1]
    return np.array([np.interp(at, places, column) for column in path.T])
