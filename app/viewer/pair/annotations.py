"""What is written and drawn round the pair: the verdict, a scale bar, and the swipe's frame."""

import numpy as np
from jaxtyping import Float

from app.viewer.draw.associations import outline
from app.viewer.draw.colors import Rgb
from app.viewer.draw.nodes import LinePoints, LinesNode
from app.viewer.draw.overlay import round_length
from app.viewer.draw.placement import Extent, Placement
from app.viewer.host import Host
from app.viewer.pair.verdict import headline_of
from gpgrad_core.arrays import NDArray
from gpgrad_core.pipeline import PairResult

BAR: Rgb = (120, 120, 120)  # seen on a light and on a dark page
SCALE_BAR_SHARE = 0.4
"""Longest length of the scale bar, as a share of the database's width."""
SWIPE_RISE = 0.05
"""How far the swipe's frame stands out above and below, as a share of the depth."""


class Annotations:
    """Nodes that say what the picture shows."""

    def __init__(self, host: Host, root: str) -> None:
        """Prepare the nodes under a root node; nothing is shown."""
        scene = host.scene
        self._bar = LinesNode(host, f"{root}/scale/bar", BAR, thickness=4.0)
        # A label without a word would be a white bar.
        self._bar_label = scene.add_label(
            f"{root}/scale/label", "", anchor="top-center", visible=False
        )
        self._verdict = scene.add_label(
            f"{root}/verdict", "", anchor="top-center", font_screen_scale=1.3, visible=False
        )
        self._swipe = LinesNode(host, f"{root}/swipe", BAR, thickness=2.0)

    def hide_verdict(self) -> None:
        """Say nothing of the pair."""
        self._verdict.visible = False

    def show_verdict(self, result: PairResult, corners: Float[NDArray[np.float64], "k 3"]) -> None:
        """Write the verdict in front of the corners (k, 3) of both submaps [m]."""
        self._verdict.text = headline_of(result, with_score=True)
        self._verdict.visible = True
        low, high = corners.min(axis=0), corners.max(axis=0)
        x, y, z = (low[0] + high[0]) / 2, low[1] - 0.08 * (high[1] - low[1]), corners[:, 2].mean()
        self._verdict.position = (float(x), float(y), float(z))

    def show_swipe(
        self, swipe_at: float | None, corners: Float[NDArray[np.float64], "k 3"]
    ) -> None:
        """Frame the upright plane at which one surface ends and the other begins."""
        if swipe_at is None:
            self._swipe.hide()
            return
        x = swipe_at
        (_, y0, z0), (_, y1, z1) = corners.min(axis=0), corners.max(axis=0)
        rise = SWIPE_RISE * (y1 - y0)
        frame = [(x, y0, z0 - rise), (x, y1, z0 - rise), (x, y1, z1 + rise), (x, y0, z1 + rise)]
        self._swipe.show((*frame,), lambda: outline(np.array(frame)))

    def show_bar(self, box: Extent, placement: Placement) -> None:
        """Draw the scale bar before a submap of that extent, where it stands."""
        length = round_length(SCALE_BAR_SHARE * float(box.size[0]))
        corner = np.array([[box.low[0], box.low[1], box.center[2]]])
        start = placement.apply(corner)[0] - np.array([0.0, 0.04 * box.size[1], 0.0])
        end = start + np.array([length, 0.0, 0.0])

        def make() -> LinePoints:
            return np.stack([start, end])[None].astype(np.float32)

        self._bar.show((length, *start), make)
        self._bar_label.text, self._bar_label.visible = f"{length:g} m", True
        middle = (start + end) / 2
        self._bar_label.position = (float(middle[0]), float(middle[1]), float(middle[2]))
