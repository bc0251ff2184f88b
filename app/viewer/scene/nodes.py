"""The kinds of 3D nodes in the browser, each changed in place and only when something changed.

A node remembers what it was last made from and does nothing when asked for the same again; the
memo of the pipeline gives the same object for the same key, so comparing costs nothing.
"""

from collections.abc import Callable
from typing import Any, Literal, TypeAlias

import numpy as np
import viser
from jaxtyping import Float, UInt8

from app.viewer.scene.associations import KINDS, Dots, mark_of, outline
from app.viewer.scene.colors import Colors, Rgb, for_line_ends, for_lines
from app.viewer.scene.placement import Box, Placement
from app.viewer.server.host import Host
from gpgrad_core.arrays import NDArray
from gpgrad_core.types import Submap

LinePoints: TypeAlias = Float[NDArray[np.float32], "n 2 3"]
OneColor: TypeAlias = UInt8[NDArray[np.uint8], "3"]


class PointsNode:
    """One point cloud node, made when first needed and then changed in place."""

    def __init__(self, host: Host, name: str, *, shape: str = "square") -> None:
        """Prepare the node of that name."""
        self._host = host
        self._name = name
        self._shape: Any = shape
        self._handle: viser.PointCloudHandle | None = None
        self._made_from: tuple[object, ...] = ()
        self.num_points = 0
        self.colors: Any = np.zeros((0, 3), np.uint8)

    def paint(self, colors: Any) -> None:
        """Show other colours (n, 3) until the points are shown anew."""
        if self._handle is not None and len(colors) == self.num_points > 0:
            self._made_from = ()  # whoever shows them again gets their own colours
            self._handle.colors = colors

    def show(
        self,
        made_from: tuple[object, ...],
        make: Callable[[], tuple[Any, Any, float]],
    ) -> None:
        """Show what ``make`` returns: positions (n, 3), colours (n, 3) and a size [m].

        Args:
            made_from: All that the points depend on; equal to last time means nothing to do.
            make: Called only if something changed.
        """
        if made_from == self._made_from and self._handle is not None:
            self._handle.visible = self.num_points > 0
            return
        points, colors, size = make()
        self._made_from = made_from
        self.num_points, self.colors = len(points), colors
        if self.num_points == 0:
            # The client cannot frame a cloud without points; the old ones stay, unseen.
            self.hide()
            return
        if self._handle is None:
            self._handle = self._host.scene.add_point_cloud(
                self._name,
                points,
                colors,
                point_size=size,
                point_shape=self._shape,
                precision="float32",
                point_shading="flat",
            )
            return
        self._handle.points = points
        self._handle.colors = colors
        self._handle.point_size = size
        self._handle.visible = True

    def hide(self) -> None:
        """Hide it."""
        if self._handle is not None:
            self._handle.visible = False


class LinesNode:
    """One node of line segments, made when first needed and then changed in place."""

    def __init__(self, host: Host, name: str, color: Rgb, thickness: float) -> None:
        """Prepare the node of that name, its colour as shown, its thickness in pixels."""
        self._color = color
        self._host = host
        self._name = name
        self._thickness = thickness
        self._handle: viser.LineSegmentsHandle | None = None
        self._made_from: tuple[object, ...] = ()
        self._num_lines = 0

    def show(self, made_from: tuple[object, ...], make: Callable[[], LinePoints]) -> None:
        """Show the lines that ``make`` returns [m], unless nothing changed."""
        if made_from == self._made_from and self._handle is not None:
            self._handle.visible = self._num_lines > 0
            return
        points = make()
        self._made_from = made_from
        self._num_lines = len(points)
        if self._num_lines == 0:
            self.hide()
            return
        if self._handle is None:
            self._handle = self._host.scene.add_line_segments(
                self._name,
                points,
                for_lines(self._color),
                thickness=self._thickness,
                thickness_units="screen",
            )
            return
        self._handle.points = points
        self._handle.visible = True

    def restyle(self, color: Rgb, thickness: float) -> None:
        """Change the colour and the thickness [pixels]."""
        if (color, thickness) == (self._color, self._thickness):
            return
        self._color, self._thickness = color, thickness
        if self._handle is not None:
            self._handle.colors = np.array(for_lines(color), dtype=np.uint8)
            self._handle.thickness = thickness

    def hide(self) -> None:
        """Hide it."""
        if self._handle is not None:
            self._handle.visible = False


class ColoredLinesNode:
    """One node of line segments of many colours, made when first needed and then changed."""

    def __init__(self, host: Host, name: str, thickness: float) -> None:
        """Prepare the node of that name, its thickness in pixels."""
        self._host = host
        self._name = name
        self._thickness = thickness
        self._handle: viser.LineSegmentsHandle | None = None
        self._made_from: object = None

    def show(
        self,
        points: LinePoints,
        made_from: object,
        make_colors: Callable[[], Colors | OneColor],
    ) -> None:
        """Show lines [m] in the colours (n, 3), or the one (3,), that ``make_colors`` returns.

        It is called only if what the colours are made from is another. One colour of all lines
        is told once; a node that has begun with one must keep to one.
        """
        if len(points) == 0:
            self.hide()
            return
        if self._handle is not None and self._made_from == made_from:
            self._handle.points = points
            self._handle.visible = True
            return
        colors = _colors_of_lines(make_colors())
        self._made_from = made_from
        if self._handle is None:
            self._handle = self._host.scene.add_line_segments(
                self._name, points, colors, thickness=self._thickness, thickness_units="screen"
            )
            return
        self._handle.points = points
        if colors.ndim > 1 or not np.array_equal(colors, self._handle.colors):
            self._handle.colors = colors
        self._handle.visible = True

    @property
    def thickness(self) -> float:
        """The thickness of all lines [pixels]."""
        return self._thickness

    @thickness.setter
    def thickness(self, thickness: float) -> None:
        if thickness != self._thickness and self._handle is not None:
            self._handle.thickness = thickness
        self._thickness = thickness

    def hide(self) -> None:
        """Hide it."""
        if self._handle is not None:
            self._handle.visible = False


def _colors_of_lines(colors: Colors | OneColor) -> NDArray[np.uint8]:
    """Give the colours (n, 2, 3) of both ends of each line, or one (3,) for all, as pages need."""
    if colors.ndim == 1:
        red, green, blue = (int(channel) for channel in colors)
        return np.array(for_lines((red, green, blue)), np.uint8)
    unique, places = np.unique(colors, axis=0, return_inverse=True)
    table = np.array([for_line_ends((int(r), int(g), int(b))) for r, g, b in unique], np.uint8)
    return np.repeat(table[places.ravel()][:, None], 2, axis=1)


STUB = np.array([0.8, 0.6, 0.0], dtype=np.float32)
"""Direction of the pieces of line that are seen as discs."""
STUB_LENGTH, CORE_LIFT = 0.01, 0.2
"""How long they are, and how high a core stands over its rim; the caller's lift is 1."""


class MarksNode:
    """Keypoints as marks of a constant size on the screen.

    A point of a cloud grows as one comes nearer. The ends of a line that is measured in pixels do
    not, and they are round: a piece of line far shorter than it is wide is seen as a disc.
    """

    def __init__(self, host: Host, name: str) -> None:
        """Prepare the nodes under one of that name."""
        self._root = host.scene.add_frame(name, show_axes=False, visible=False)
        # Marks of one size share their nodes: each node takes the page time with every picture.
        sizes = [(mark.rim_width, mark.core_width) for mark in map(mark_of, KINDS)]
        self._discs = [
            (
                [place for place, other in enumerate(sizes) if other == widths],
                [
                    ColoredLinesNode(host, f"{name}/{number}/{part}", width)
                    for part, width in zip(("rim", "core"), widths, strict=True)
                ],
            )
            for number, widths in enumerate(dict.fromkeys(sizes))
        ]
        self._made_from: tuple[object, ...] = ()

    def show(
        self,
        made_from: tuple[object, ...],
        make: Callable[[], Dots],
        *,
        inliers: Rgb,
        size: float,
        scale: float = 1.0,
    ) -> None:
        """Show what ``make`` returns, unless it is made from the same as before.

        Args:
            made_from: All that the places and their kinds depend on.
            make: Gives them; called only if something changed.
            inliers: The colour of inliers.
            size: A length that is small beside the submap, but not nothing [m].
            scale: How large the marks are, beside `mark_of`.
        """
        marks = [mark_of(kind, inliers) for kind in KINDS]
        made_from = (*made_from, size, inliers)
        dots = make() if made_from != self._made_from else None
        self._made_from = made_from
        for places, (rim, core) in self._discs:
            mark = marks[places[0]]
            rim.thickness, core.thickness = scale * mark.rim_width, scale * mark.core_width
            if dots is None:
                continue
            chosen = np.concatenate([np.flatnonzero(dots.kinds == place) for place in places])
            points, kinds = dots.points[chosen], dots.kinds[chosen]
            for node, colors, lift in (
                (rim, [mark.rim for mark in marks], 0.0),
                (core, [mark.core for mark in marks], CORE_LIFT),
            ):
                # The kind that says most lies on top, where two stand in one place.
                rise = np.zeros_like(points)
                rise[:, 2] = size * (2 * CORE_LIFT * kinds + lift)
                stub = STUB_LENGTH * size * STUB
                ends = np.stack([points + rise - stub, points + rise + stub], axis=1)
                colors_of = np.array(colors, np.uint8)[kinds if len(places) > 1 else places[0]]
                node.show(ends.astype(np.float32), made_from, lambda shown=colors_of: shown)
        self._root.visible = True

    def hide(self) -> None:
        """Hide them."""
        self._root.visible = False


class SubmapNode:
    """One submap: a frame, and beneath it surface, cloud, keypoints, outline and label.

    The node's origin is the submap's centre, because browsers have seven digits of a coordinate.
    Registering moves the frame; what hangs on it follows without being sent again.
    """

    def __init__(
        self, host: Host, parent: str, role: str, color: Rgb, outer: Literal["left", "right"]
    ) -> None:
        """Make the frame of the query or the database.

        Args:
            host: Whose scene it joins.
            parent: Name of the node that it hangs on.
            role: "query" or "database".
            color: Of its outline and its points.
            outer: Which way the other submap is not.
        """
        self._outer = outer
        self._placement = Placement()
        self._extent: Box | None = None
        self._centre = np.zeros(3)
        self.color = color
        root = f"{parent}/{role}"
        self._frame = host.scene.add_frame(root, show_axes=False)
        self.surface = PointsNode(host, f"{root}/surface")
        self.cloud = PointsNode(host, f"{root}/cloud", shape="circle")
        self.keypoints = MarksNode(host, f"{root}/keypoints")
        self.outline = LinesNode(host, f"{root}/outline", color, thickness=2.0)
        self._label = host.scene.add_label(
            f"{root}/label", role, anchor="bottom-left" if outer == "left" else "top-right"
        )

    @property
    def visible(self) -> bool:
        """Whether it is seen, with everything below it."""
        return self._frame.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._frame.visible = visible

    def move(self, placement: Placement) -> None:
        """Place the submap's frame in the scene."""
        self._frame.position = placement.apply(self._centre[None])[0]
        self._frame.wxyz = placement.wxyz
        self._placement = placement
        self._put_label()

    def name(self, submap: Submap, extent: Box, role: str) -> None:
        """Write its role, name and size beside it, and draw its outline."""
        width, depth, _ = extent.size
        self._label.text = f"{role} {submap.id} · {width:.1f} m x {depth:.1f} m"
        self._extent, self._centre = extent, submap.centre
        self._put_label()
        self.outline.show((submap,), lambda: outline(extent.corners - submap.centre))

    def _put_label(self) -> None:
        """Write the name at that corner of the box round the outline which is the outer one.

        For a camera that looks along y, this is the far one on the left, or else the near one on
        the right, so that two names never meet; and it runs inwards, so that no panel cuts it.
        """
        if self._extent is None:
            return
        x, y, z = self._placement.apply(self._extent.corners).T
        outer = (x.min(), y.max()) if self._outer == "left" else (x.max(), y.min())
        corner = np.array([*outer, z.mean()]) - self._placement.apply(self._centre[None])[0]
        x, y, z = (float(value) for value in corner @ self._placement.rotation)
        self._label.position = x, y, z
