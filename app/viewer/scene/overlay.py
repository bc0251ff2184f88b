"""What is written over the canvas for a camera: a scale that is true where it looks, and axes."""

from dataclasses import dataclass
from math import tan

import numpy as np
from jaxtyping import Float

from app.viewer.charts import round_length
from app.viewer.scene.placement import FIELD_OF_VIEW, Canvas, axes_of_view
from app.viewer.session.state import Camera
from gpgrad_core.arrays import Array

BAR_SHARE = 0.25
"""Longest length of the scale bar, as a share of the width that is free."""
LONGEST_BAR = 220.0  # [pixels]


@dataclass(frozen=True)
class ScaleBar:
    """A bar of a round length.

    Attributes:
        pixels: Its length on the screen.
        metres: What that is across the line of sight, at the distance of what is looked at.
    """

    pixels: float
    metres: float


def scale_bar(camera: Camera, canvas: Canvas) -> ScaleBar:
    """Make the bar for a camera and a canvas."""
    distance = float(np.linalg.norm(np.subtract(camera.look_at, camera.position)))
    per_pixel = 2.0 * max(distance, 1e-6) * tan(FIELD_OF_VIEW / 2) / canvas.height
    free = canvas.width - canvas.left - canvas.right
    metres = round_length(min(BAR_SHARE * free, LONGEST_BAR) * per_pixel)
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
    _, right, up = axes_of_view(np.subtract(camera.look_at, camera.position))
    return np.column_stack([right, -up])[:2]


def place_on_screen(
    camera: Camera, canvas: Canvas, points: Float[Array, "n 3"]
) -> Float[Array, "n 2"]:
    """Give where points of the scene [m] are seen on a canvas: pixels from its upper left corner.

    Points behind the camera are NaN.
    """
    forward, right, up = axes_of_view(np.subtract(camera.look_at, camera.position))
    offset = points - np.array(camera.position)
    depth = offset @ forward
    depth = np.where(depth > 0, depth, np.nan)
    scale = canvas.height / (2.0 * tan(FIELD_OF_VIEW / 2)) / depth
    return np.column_stack(
        [canvas.width / 2 + scale * (offset @ right), canvas.height / 2 - scale * (offset @ up)]
    )


def line_of_sight(
    camera: Camera, canvas: Canvas, x: float, y: float
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Give the eye [m] and the direction in which a pixel of a canvas looks.

    Args:
        camera: Of the page.
        canvas: Of the page.
        x: From the left edge [pixels].
        y: From the upper edge [pixels].
    """
    forward, right, up = axes_of_view(np.subtract(camera.look_at, camera.position))
    scale = 2.0 * tan(FIELD_OF_VIEW / 2) / canvas.height
    across, upward = scale * (x - canvas.width / 2), scale * (canvas.height / 2 - y)
    return np.array(camera.position, dtype=float), forward + across * right + upward * up
