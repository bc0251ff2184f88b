"""Camera bookmarks, and flights between them; a camera belongs to one page."""

from typing import Literal, TypeAlias, get_args

import numpy as np
import viser
from jaxtyping import Float
from viser._messages import SetCameraLookAtMessage

from app.viewer.scene.placement import FIELD_OF_VIEW
from app.viewer.server.host import send_to
from app.viewer.session.state import Camera
from gpgrad_core.arrays import Array
from gpgrad_core.se2 import SE2

Bookmark: TypeAlias = Literal["top", "oblique", "follow loop"]

BOOKMARKS: tuple[Bookmark, ...] = get_args(Bookmark)
NEARLY_DOWN = 0.002
"""Sine of the angle off the vertical from which the top view looks: north stays up."""
DOWN = np.array([0.0, NEARLY_DOWN, -1.0])
"""Direction of sight of the top view."""
FAR, FAR_DISTANCES = 1000.0, 10.0
"""What is farther away than this [m], and than so many distances of what is looked at, is cut off.
"""
FOLLOW_BACK = 0.5
"""How far behind the robot the camera flies, as a share of the way's extent."""
FOLLOW_UP = 0.35
FOLLOW_AHEAD = 0.06
"""How far ahead it looks, as a share of the way's length."""


def top(oblique: Camera) -> Camera:
    """Look straight down on what another view shows, from as far away."""
    look_at = np.array(oblique.look_at)
    distance = float(np.linalg.norm(np.array(oblique.position) - look_at))
    return _camera(look_at + distance * np.array([0.0, -NEARLY_DOWN, 1.0]), look_at)


def blend(start: Camera, end: Camera, share: float) -> Camera:
    """Interpolate between two views, moving round the point that is looked at.

    The distance from it goes evenly and the direction turns, so that the camera does not dive
    through the ground on its way.
    """
    looks = np.array(start.look_at), np.array(end.look_at)
    arms = np.array(start.position) - looks[0], np.array(end.position) - looks[1]
    lengths = [float(np.linalg.norm(arm)) or 1.0 for arm in arms]
    direction = (1 - share) * arms[0] / lengths[0] + share * arms[1] / lengths[1]
    norm = float(np.linalg.norm(direction))
    if norm < 1e-6:  # from opposite sides: over the top
        direction, norm = np.array([0.0, -NEARLY_DOWN, 1.0]), 1.0
    length = lengths[0] ** (1 - share) * lengths[1] ** share
    look_at = (1 - share) * looks[0] + share * looks[1]
    return _camera(look_at + length * direction / norm, look_at)


def follow(path: Float[Array, "n 3"], share: float) -> Camera:
    """Follow a path from behind and above.

    Args:
        path: Where it leads [m], of two or more places.
        share: How far along its length.
    """
    extent = float(np.linalg.norm(np.ptp(path, axis=0)[:2])) or 1.0
    here, ahead = _along(path, share), _along(path, share + FOLLOW_AHEAD)
    behind = _along(path, share - FOLLOW_AHEAD)
    heading = (ahead - behind) * np.array([1.0, 1.0, 0.0])
    heading /= max(float(np.linalg.norm(heading)), 1e-9)
    position = here - FOLLOW_BACK * extent * heading + np.array([0.0, 0.0, FOLLOW_UP * extent])
    return _camera(position, here)


def orbit(camera: Camera, share: float) -> Camera:
    """Orbit the point that a view looks at.

    Args:
        camera: Where the round begins and ends.
        share: Of the full circle.
    """
    look_at = np.array(camera.look_at)
    arm = np.array(camera.position) - look_at
    around = SE2(yaw=2 * np.pi * share).apply(arm[None, :2])[0]
    return _camera(look_at + np.array([*around, arm[2]]), look_at)


def view_of(client: viser.ClientHandle) -> Camera:
    """Read the view that a page has."""
    return _camera(np.array(client.camera.position), np.array(client.camera.look_at))


def set_view(client: viser.ClientHandle, camera: Camera) -> None:
    """Bring a page to a view."""
    distance = float(np.linalg.norm(np.array(camera.position) - np.array(camera.look_at)))
    with client.atomic():
        client.camera.far = max(FAR, FAR_DISTANCES * distance)
        client.camera.fov = float(FIELD_OF_VIEW)
        client.camera.position = camera.position
        client.camera.look_at = camera.look_at
        # A new position takes the point that is looked at along. If the page reports just then that
        # it looks where it should, from a view before, viser has nothing to set and sends nothing.
        send_to(client, SetCameraLookAtMessage(camera.look_at))
    client.flush()


def set_start(server: viser.ViserServer, camera: Camera) -> None:
    """Set the view that new pages, and "reset view", begin with."""
    distance = float(np.linalg.norm(np.array(camera.position) - np.array(camera.look_at)))
    initial = server.initial_camera
    initial.far = max(FAR, FAR_DISTANCES * distance)
    initial.fov = float(FIELD_OF_VIEW)
    initial.position = camera.position
    initial.look_at = camera.look_at


def _along(path: Float[Array, "n 3"], share: float) -> Float[Array, "3"]:
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    places = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.clip(share, 0.0, 1.0) * places[-1]
    return np.array([np.interp(at, places, column) for column in path.T])


def _camera(position: Float[Array, "3"], look_at: Float[Array, "3"]) -> Camera:
    x, y, z = (float(value) for value in position)
    u, v, w = (float(value) for value in look_at)
    return Camera((x, y, z), (u, v, w))
