"""The kinds of 3D nodes in the browser, each changed in place and only when something changed."""

from collections.abc import Callable
from typing import Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from app.viewer.scene.associations import KINDS, Dots, mark_of, outline
from app.viewer.scene.colors import Rgb, for_line_ends, for_lines
from app.viewer.scene.placement import Box, Placement
from app.viewer.server.host import Host
from gpgrad_core.arrays import NDArray
from gpgrad_core.types import Submap

LinePoints: TypeAlias = Float[NDArray[np.float32], "n 2 3"]


class Node:
    """One node of the scene, created when there is something to show, then changed in place."""

    def __init__(self, add: Callable[..., Any], name: str, **look: Any) -> None:
        """Prepare the node of that name, which a method of the scene adds, and how it looks."""
        self._add, self._name, self._look = add, name, look
        self._handle: Any = None
        self._inputs: tuple[object, ...] | None = None
        self.made: dict[str, Any] = {"": ()}

    @property
    def count(self) -> int:
        return len(next(iter(self.made.values())))

    def put(self, **made: Any) -> None:
        """Show these properties, of which the first has nothing in it where nothing is shown."""
        self.made = made
        if self._handle is None and self.count:
            self._handle = self._add(self._name, **self._look | made)
        elif self.count:
            self._assign(made)
        self._show()

    def show(self, inputs: tuple[object, ...], make: Callable[[], dict[str, Any]]) -> None:
        """Show what ``make`` returns, which is called only if its inputs have changed."""
        if inputs != self._inputs:
            self.put(**make())
            self._inputs = inputs
        self._show()

    def style(self, **look: Any) -> None:
        self._look |= look
        self._assign(look)

    def paint(self, colors: Any) -> None:
        """Show other colours (n, 3) until the points are shown anew."""
        if self._handle is not None and len(colors) == self.count > 0:
            self._inputs = None  # whoever shows them again gets their own colours
            self._assign({"colors": colors})

    def hide(self) -> None:
        if self._handle is not None:
            self._handle.visible = False

    def _show(self) -> None:
        # The client cannot frame a cloud without points; the old ones stay, unseen.
        if self._handle is not None:
            self._handle.visible = self.count > 0

    def _assign(self, properties: dict[str, Any]) -> None:
        for name, value in properties.items() if self._handle is not None else ():
            setattr(self._handle, name, value)


def points_node(host: Host, name: str, *, shape: str = "square", **look: Any) -> Node:
    """Prepare a cloud of ``points`` (n, 3) [m], with ``colors`` (n, 3) and a ``point_size`` [m]."""
    look |= {"point_shape": shape, "precision": "float32", "point_shading": "flat"}
    return Node(host.scene.add_point_cloud, name, **look)


def lines_node(host: Host, name: str, color: Rgb | None, thickness: float) -> Node:
    """Prepare lines (n, 2, 3) [m] of a thickness [pixels]; None: ``colors`` of `for_line_ends`."""
    look = {} if color is None else {"colors": for_lines(color)}
    return Node(
        host.scene.add_line_segments, name, thickness=thickness, thickness_units="screen", **look
    )


def label_node(host: Host, name: str, anchor: str, **look: Any) -> Node:
    """Prepare a label: its ``text``, at a ``position`` [m]."""
    return Node(host.scene.add_label, name, anchor=anchor, **look)


STUB = np.array([0.8, 0.6, 0.0], dtype=np.float32)
"""Direction of the pieces of line that appear as discs."""
STUB_LENGTH, CORE_LIFT = 0.01, 0.2
"""How long they are, and how high a core stands over its rim; the caller's lift is 1."""


class MarksNode:
    """Keypoints as marks of a constant size on the screen.

    A point of a cloud grows as one comes nearer. The ends of a line that is measured in pixels do
    not, and they are round: a piece of line far shorter than it is wide appears as a disc.
    """

    def __init__(self, host: Host, name: str) -> None:
        self._root = host.scene.add_frame(name, show_axes=False, visible=False)
        # Marks of one size share their nodes: each node takes the page time with every picture.
        sizes = [(mark.rim_width, mark.core_width) for mark in map(mark_of, KINDS)]
        self._discs = [
            (
                [place for place, other in enumerate(sizes) if other == widths],
                [
                    lines_node(host, f"{name}/{number}/{part}", None, width)
                    for part, width in zip(("rim", "core"), widths, strict=True)
                ],
            )
            for number, widths in enumerate(dict.fromkeys(sizes))
        ]
        self._inputs: tuple[object, ...] = ()

    def show(
        self,
        inputs: tuple[object, ...],
        make: Callable[[], Dots],
        *,
        inliers: Rgb,
        size: float,
        scale: float = 1.0,
    ) -> None:
        """Show what ``make`` returns, unless it depends on the same as before.

        Inliers have a colour; the size is a length that is small beside the submap, but not nothing
        [m]; the scale is that of the marks beside `mark_of`.
        """
        marks = [mark_of(kind, inliers) for kind in KINDS]
        inputs = (*inputs, size, inliers)
        dots = make() if inputs != self._inputs else None
        self._inputs = inputs
        for places, (rim, core) in self._discs:
            mark = marks[places[0]]
            rim.style(thickness=scale * mark.rim_width)
            core.style(thickness=scale * mark.core_width)
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
                # The colour of a single kind is sent once.
                of_lines = for_lines(colors[places[0]])
                if len(places) > 1:
                    of_lines = for_line_ends(np.array(colors, np.uint8)[kinds])
                node.put(points=ends.astype(np.float32), colors=of_lines)
        self._root.visible = True

    def hide(self) -> None:
        self._root.visible = False


class SubmapNode:
    """One submap: a frame, and beneath it surface, cloud, keypoints, outline and label.

    The node's origin is the submap's centre, because browsers have seven digits of a coordinate.
    Registering moves the frame; what hangs on it follows without being sent again.
    """

    def __init__(
        self, host: Host, parent: str, role: str, color: Rgb, outer: Literal["left", "right"]
    ) -> None:
        """Make the frame of a role; to its outer side lies no other submap."""
        self._outer = outer
        self._placement = Placement()
        self._extent: Box | None = None
        self._centre = np.zeros(3)
        self.color = color
        root = f"{parent}/{role}"
        self._frame = host.scene.add_frame(root, show_axes=False)
        self.surface = points_node(host, f"{root}/surface")
        self.cloud = points_node(host, f"{root}/cloud", shape="circle")
        self.keypoints = MarksNode(host, f"{root}/keypoints")
        self._outline = lines_node(host, f"{root}/outline", color, thickness=2.0)
        self.label = host.scene.add_label(
            f"{root}/label", role, anchor="bottom-left" if outer == "left" else "top-right"
        )

    @property
    def visible(self) -> bool:
        return self._frame.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._frame.visible = visible

    def move(self, placement: Placement) -> None:
        self._frame.position = placement.apply(self._centre[None])[0]
        self._frame.wxyz = placement.wxyz
        self._placement = placement
        self._put_label()

    def name(self, submap: Submap, extent: Box, role: str) -> None:
        width, depth, _ = extent.size
        self.label.text = f"{role} {submap.id} · {width:.1f} m x {depth:.1f} m"
        self._extent, self._centre = extent, submap.centre
        self._put_label()

    def show_frame(self, submap: Submap, *, shown: bool) -> None:
        extent, place = self._extent, self._placement
        if extent is None or not shown:
            self._outline.hide()
            return
        corners = place.exaggerated(extent.corners - submap.centre)
        inputs = submap, place.exaggeration
        self._outline.show(inputs, lambda: {"points": outline(corners)})

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
        x, y, z = (float(value) for value in corner @ self._placement.pose.rotation)
        self.label.position = x, y, z
