"""A beside B: the pair at a stored setting, and as the sliders are now; what differs.

A is drawn once, in a scene of its own, and moved beside B. Each picture of B is compared with it.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from html import escape
from math import degrees, hypot
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from app.viewer.features.desk import Desk, Feature
from app.viewer.features.pair.picture import Picture
from app.viewer.features.pair.scene import HEADING_BACK, PAIR, PairScene
from app.viewer.features.pair.tab import judged_pair
from app.viewer.features.pair.verdict import headline_of
from app.viewer.features.work import message_of
from app.viewer.scene.associations import ARC_PIECES, MOST_LINES, arcs_of, spread
from app.viewer.scene.colors import BACK, INLIER, OUTLIER, Rgb, css
from app.viewer.scene.layers import stride_for
from app.viewer.scene.nodes import label_node, lines_node, points_node
from app.viewer.scene.placement import beside
from app.viewer.server.host import Host
from app.viewer.session.jobs import Lane
from app.viewer.session.methods import METHODS
from app.viewer.session.news import PairNews, PairShown, SessionState
from app.viewer.session.state import ROLES, ViewState, with_fitted, with_method, with_params
from app.viewer.widgets.html import BAD, GOOD
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.detection.verdict import describe_length
from gpgrad_core.params import changes, get_path, value_text
from gpgrad_core.run import Progress
from gpgrad_core.types import GradientMap

Numbers: TypeAlias = Int[NDArray[np.intp], "_k"]
Row: TypeAlias = tuple[str, str, str]
"""A figure: its name, that of A, and that of B."""
REFERENCE = "/reference"
"""Above all nodes of A."""
MOST_CELLS = 20_000
"""Of a map that are looked at for ground that is gained or lost: marks need no more."""
MARK = 0.55
"""Size of their marks beside the way from one to the next: the ground is visible between."""
PIN = 0.05
"""Height of a pin, as a share of the width."""
REACH = 0.5
"""How far the same inlier may have moved, in inlier radii."""
NO_WRAP = 'style="white-space:nowrap;margin:0 .4em"'
MOST_NAMED = 2
"""So many parameters are named beside those that always are."""


# What differs.


@dataclass(frozen=True, eq=False)
class Side:
    """A or B: its picture, and the result that this shows."""

    name: str
    picture: Picture
    result: PairResult

    @property
    def heading(self) -> str:
        return f"{self.name}   {headline_of(self.result, with_score=True)}"


@dataclass(frozen=True, eq=False)
class Inliers:
    """Numbers of the associations that are inliers of A alone, of B alone, and of both in each."""

    lost: Numbers
    gained: Numbers
    both: tuple[Numbers, Numbers]


def compare_inliers(before: PairResult, after: PairResult, reach: float) -> Inliers:
    """Split the inliers into those that A and B share and those of one alone.

    Other parameters move keypoints by a little. So two are the same if each is the nearest to the
    other, by both ends together, and no end is farther away than a reach [m].
    """
    first, second = (np.flatnonzero(result.registration.inliers) for result in (before, after))
    if not len(first) or not len(second):
        return Inliers(first, second, (first[:0], second[:0]))
    trees = [
        KDTree(np.column_stack([result.matches.query_xy, result.matches.database_xy])[chosen])
        for result, chosen in ((before, first), (after, second))
    ]
    found: Any = [one.query(other.data, p=np.inf) for one, other in (trees[::-1], trees)]
    (distances, there), (_, back) = found
    same = (back[there] == np.arange(len(first))) & (distances <= reach)
    gained = np.delete(second, there[same])
    return Inliers(first[~same], gained, (first[same], second[there[same]]))


@dataclass(frozen=True, eq=False)
class Ground:
    """Cells that one map trusts and another of the same submap does not."""

    points: Float[NDArray[np.float64], "n 3"]  # their middles, in the submap's frame [m]
    size: float  # of their sides [m]

    @property
    def area(self) -> float:
        """Of all of them [m²]."""
        return len(self.points) * self.size**2


def ground_of_one(one: GradientMap, ratio: float, other: GradientMap, other_ratio: float) -> Ground:
    """Find the cells that one map trusts under its mask, and the other under its own does not."""
    grid, every = one.grid, stride_for(one.grid.num_cells, MOST_CELLS)
    trusted = np.flatnonzero(one.trusted(ratio, every))
    x, y = np.meshgrid(grid.x[::every], grid.y[::every])
    xy = np.column_stack([x.ravel(), y.ravel()])[trusted]
    row, column, inside = other.grid.nearest_cells(xy)
    alone = ~(inside & other.trusted(other_ratio)[row, column])
    heights = one.elevation[::every, ::every].ravel()[trusted[alone]]
    return Ground(np.column_stack([xy[alone], heights]), every * grid.resolution)


def grounds_of_one(one: Side, other: Side) -> list[Ground]:
    """Find these cells of query and database."""
    here, there = one.picture, other.picture
    maps = zip(here.maps, there.maps, strict=True)
    return [ground_of_one(first, here.ratio, second, there.ratio) for first, second in maps]


def figures(before: Side, after: Side) -> Iterator[Row]:
    """List the figures: those that always are of interest, and some parameters that differ."""
    sides = before, after
    first, second = (side.result.registration for side in sides)
    yield "score", f"{first.score:.1f}", f"{second.score:.1f}"
    yield "inliers", f"{first.num_inliers:,}", f"{second.num_inliers:,}"
    yield "shared", f"{first.overlap_area:.1f} m²", f"{second.overlap_area:.1f} m²"
    yield "moved by", "", motion_in_words(before.result, after.result)
    states = [side.picture.state for side in sides]
    for name, field in (("length-scale", "length_scale"), ("noise", "noise_std")):
        a, b = (getattr(state.params.map, field) for state in states)
        yield name, *("own" if one is None else describe_length(one) for one in (a, b))  # type: ignore[misc]
    asked = [state.asked for state in states]
    if states[0].method != states[1].method:
        yield "method", states[0].method, states[1].method
        return
    others = [
        (field.name.replace("_", " "), value_text(get_path(asked[0], field.path)), value_text(new))
        for field, new in changes(asked[1], asked[0])
        if field.path not in ("map.length_scale", "map.noise_std")
    ]
    yield from others[:MOST_NAMED]


def motion_in_words(before: PairResult, after: PairResult) -> str:
    """How far B moves the middle of the query from its place in A, and how much it turns it.

    It is empty if one of them has no motion.
    """
    first, second = (result.registration.T_database_query for result in (before, after))
    if first is None or second is None:
        return ""
    middle = before.query_map.grid.corners.mean(axis=0)[None]
    away = 100 * hypot(*(second.apply(middle) - first.apply(middle))[0])
    return f"{away:.1f} cm, {abs(degrees((second @ first.inverse()).yaw)):.2f}°"


def pins(
    feet: Float[NDArray[np.float32], "n 3"], height: float
) -> Float[NDArray[np.float32], "k 2 3"]:
    """Stand pins on places, each in four pieces [m]."""
    up = np.linspace(0.0, height, 5)[:, None] * np.array([0.0, 0.0, 1.0])
    points = (feet[:, None] + up).astype(np.float32)
    return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)


def table_html(rows: Iterable[Row], inliers: Inliers, lost: float, gained: float) -> str:
    """Write the figures of A and B, and what lines and marks mean, each with its number or m²."""
    columns = list(zip(*rows, strict=True))
    differ = [a != b for a, b in zip(*columns[1:], strict=True)]

    def line(head: str, cells: tuple[str, ...]) -> str:
        looks = ("font-weight:700" if it and head else "opacity:.7" for it in differ)
        written = "".join(
            f'<td style="padding:0 .4em;{look}">{escape(cell)}</td>'
            for cell, look in zip(cells, looks, strict=True)
        )
        return f'<tr data-testid="of-{head}"><th style="padding:0 .4em">{head}</th>{written}</tr>'

    def key(border: str, color: Rgb, text: str) -> str:
        look = f"display:inline-block;width:22px;vertical-align:3px;border-top:{border}"
        return f'<span {NO_WRAP}><i style="{look} {css(color)}"></i> {text}</span> '

    return (
        '<table data-testid="a-b" style="border-collapse:collapse;margin:0 0 3px 50%;'
        "transform:translateX(-50%);font-size:12px;"
        'line-height:1.35;white-space:nowrap;font-variant-numeric:tabular-nums">'
        + "".join(map(line, ("", "A", "B"), columns))
        + '</table><div data-testid="changes">'
        + key("2px dashed", OUTLIER, f"{len(inliers.lost)} only in A")
        + key("2px solid", INLIER, f"{len(inliers.gained)} only in B")
        + key("1px solid", BACK, f"{len(inliers.both[0])} in both")
        + f'<span {NO_WRAP}><b style="color:{BAD}">◆</b> {lost:.1f} m² lost '
        f'<b style="color:{GOOD}">■</b> {gained:.1f} m² gained</span></div>'
    )


# What is shown of it.


class OneSided:
    """Nodes of what one side has alone, and of its heading."""

    def __init__(self, host: Host, root: str, color: Rgb, shape: str, *, dashed: bool) -> None:
        """Prepare the nodes under the root of a scene."""
        self._dashed = dashed
        self._both = lines_node(host, f"{root}/both", BACK, 1.0)
        self._alone = lines_node(host, f"{root}/alone", color, 2.0)
        self._cells = [
            points_node(host, f"{root}/{role}/alone", shape=shape, colors=color) for role in ROLES
        ]
        self._heading = label_node(host, f"{root}/heading", "bottom-center", font_screen_scale=1.4)

    def show(self, side: Side, alone: Numbers, both: Numbers, grounds: list[Ground]) -> None:
        """Show it, as far as the options ask for lines and surfaces."""
        picture, options = side.picture, side.picture.state.options
        low, high = picture.corners.min(axis=0), picture.corners.max(axis=0)
        back = high[1] + HEADING_BACK * (high[1] - low[1])
        middle = np.array([(low[0] + high[0]) / 2, back, high[2]])
        self._heading.put(text=side.heading, position=middle)
        lift = 0.002 * float(high[0] - low[0])
        for node, chosen, dashed in ((self._both, both, False), (self._alone, alone, self._dashed)):
            wanted = chosen[: None if options.inlier_lines else 0]
            pieces = 2 * ARC_PIECES if dashed else ARC_PIECES
            lines = arcs_of(side.result, picture.placements, wanted, lift, pieces=pieces)
            if picture.is_registered:  # both ends are in one place
                lines = pins(lines[::pieces, 0], PIN * float(high[0] - low[0]))
            node.put(points=lines[::2] if dashed else lines)
        for node, ground, submap in zip(self._cells, grounds, picture.state.pair, strict=True):
            wanted = ground.points[: None if options.surfaces else 0]
            points = (wanted - submap.centre + (0.0, 0.0, ground.size / 2)).astype(np.float32)
            node.put(points=points, point_size=MARK * ground.size)

    def hide(self) -> None:
        for node in (self._both, self._alone, self._heading, *self._cells):
            node.hide()


class CompareTool(Feature):
    """Shows A beside B while the state has an A."""

    def __init__(self, desk: Desk, scene: PairScene) -> None:
        """Join the scene of the pair, which shows B."""
        host = desk.host
        self._desk, self._scene = desk, scene
        self._other = PairScene(host, desk.memo, standalone=False, root=REFERENCE)
        self._other.visible, self._other.join = False, lambda _: True
        self._of_a = OneSided(host, REFERENCE, OUTLIER, "diamond", dashed=True)
        self._of_b = OneSided(host, PAIR, INLIER, "square", dashed=False)
        self._line = lines_node(host, f"{PAIR}/divide", BACK, 2.0)
        # The last result for A, and for which pair and setting; and how it is drawn.
        self._of_reference: tuple[tuple[object, ...], ViewState, PairResult] | None = None
        self._drawn: tuple[object, ...] = ()
        self._lane: Lane[ViewState, tuple[ViewState, PairResult]] = Lane(
            desk.jobs, self._compute, self._on_result, self._on_error, slots=desk.capacity.pictures
        )
        scene.join = self._join

    def on_state(self, before: SessionState, state: SessionState) -> None:  # noqa: ARG002
        """Make room for A, or not, and have B drawn accordingly."""
        view = state.view
        is_split = view.reference is not None and view.is_pair and state.mode != "Demo"
        if is_split != self._scene.is_split:
            self._scene.is_split = is_split
            self._desk.tell_again()

    def on_pair_result(self, news: PairNews) -> None:
        """Compute A once B is shown, if its pair or setting is another."""
        if isinstance(news, PairShown) and self._scene.is_split:
            subject = _subject_of(news.state)
            if subject[-1] is not None and (
                self._of_reference is None or self._of_reference[0] != subject
            ):
                self._lane.submit(news.state)

    def close(self) -> None:
        self._other.close()

    def _compute(self, view: ViewState, progress: Progress) -> tuple[ViewState, PairResult]:
        assert view.reference is not None
        (method, params), memo = view.reference, self._desk.memo
        state = replace(with_params(with_method(view, method), params), reference=None)
        if not state.resolved:
            fit, submaps = METHODS[method].resolve, state.dataset.submaps
            state = with_fitted(state, fit(submaps, state.query, params, memo, progress))
        return state, judged_pair(self._desk, state, memo, progress)

    def _on_result(self, view: ViewState, found: tuple[ViewState, PairResult], _s: float) -> None:
        self._of_reference = _subject_of(view), *found
        self._desk.tell_again()

    def _on_error(self, _view: ViewState, error: Exception) -> None:
        self._desk.canvases.legends["pair"] = f"<b>A</b> {escape(message_of(error))}"

    def _join(self, picture: Picture) -> bool:
        """Draw A beside a picture of B, and what differs; says whether there is an A for it."""
        found, result, legends = self._of_reference, picture.result, self._desk.canvases.legends
        if (
            not self._scene.is_split
            or result is None
            or found is None
            or found[0] != _subject_of(picture.state)
        ):
            self._other.visible, legends["pair"], self._scene.like = False, "", None
            for part in (self._of_a, self._of_b, self._line):
                part.hide()
            return False
        a = Side("A", self._draw_other(picture, *found[1:]), found[2])
        b = Side("B", picture, result)
        reaches = (side.picture.state.params.registration.radius(None) for side in (a, b))
        inliers = compare_inliers(a.result, result, REACH * min(reaches))
        lost, gained = grounds_of_one(a, b), grounds_of_one(b, a)
        most = len(result.matches) if picture.state.options.all_lines else MOST_LINES
        few_a, few_b = (
            numbers[spread(side.result.matches.query_xy[numbers], most)]
            for side, numbers in ((a, inliers.lost), (b, inliers.gained))
        )
        some = spread(result.matches.query_xy[inliers.both[1]], most)
        self._of_a.show(a, few_a, inliers.both[0][some], lost)
        self._of_b.show(b, few_b, inliers.both[1][some], gained)
        areas = (sum(ground.area for ground in grounds) for grounds in (lost, gained))
        legends["pair"] = table_html(figures(a, b), inliers, *areas)
        return True

    def _draw_other(self, picture: Picture, state: ViewState, result: PairResult) -> Picture:
        """Draw A as B is drawn, if it is not yet, and put it beside B, with a line between them."""
        options, scene, other = picture.state.options, self._scene, self._other
        if options.compare == "blink":
            options = replace(options, compare="both")
        drawn = result, options, picture.state.probe, scene.tall, scene.mark_scale
        if other.picture is None or drawn != self._drawn:
            if (scale := picture.scale) is not None:
                options = replace(options, locked=options.layer, low=scale.low, high=scale.high)
            other.tall, other.mark_scale, self._drawn = scene.tall, scene.mark_scale, drawn
            probe = picture.state.probe
            other.show(replace(state, options=options, probe=probe, match=0), result)
        assert other.picture is not None
        scene.like = other.picture
        here, behind = picture.corners, scene.stacks(options.layout)
        way = beside(other.picture.corners, here, behind)
        other.move(*way)
        other.visible = True
        there = other.picture.corners + np.array([*way, 0.0])
        both, axis = np.concatenate([here, there]), 1 if behind else 0
        ends = np.stack([both.min(axis=0), both.max(axis=0)])
        edges = (
            (here.max(axis=0), there.min(axis=0))
            if behind
            else (here.min(axis=0), there.max(axis=0))
        )
        ends[:, axis], ends[:, 2] = (edges[0][axis] + edges[1][axis]) / 2, both[:, 2].min()
        self._line.put(points=ends[None].astype(np.float32))
        return other.picture


def _subject_of(view: ViewState) -> tuple[object, ...]:
    """What A is computed for."""
    return view.dataset, view.query_id, view.database_id, view.reference
