"""Submaps, their maps and their loop closures: the paper's Figs. 1, 3, 4, 6 and 10."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias, TypedDict

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import LogNorm, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from gpgrad_core.arrays import NDArray
from gpgrad_core.evaluation.experiment import ShownPair, ShownSubmap, poses_of
from gpgrad_core.evaluation.plots.style import (
    COLUMN,
    DATABASE,
    GRADIENT_COLOURS,
    HEIGHT_COLOURS,
    INLIER,
    OUTLIER,
    PAGE,
    QUERY,
    REST,
    SLOPE_COLOURS,
    VARIANCE_COLOURS,
    add_bar,
    add_panel,
    extent_of,
    in_metres,
    new_figure,
    new_panels,
    shape_of,
    show_field,
)
from gpgrad_core.features.detection import interpolate
from gpgrad_core.io.folder import index_of
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import Array, Dataset, GradientMap, Grid, Submap

LayerValues: TypeAlias = Float[NDArray[np.floating], "rows columns"]
Picture: TypeAlias = Float[NDArray[np.floating], "rows columns 3"]

MOST_POINTS = 30_000
"""Points of a cloud that are drawn; more would cover each other."""
POINTS_OF_THE_REST = 4000
"""Points of each submap that is drawn in grey."""
VIEWS = ((28.0, -60.0), (28.0, 120.0))
"""Elevation and azimuth of the two viewpoints [degrees]."""
PALE = {QUERY: "#f19a90", DATABASE: "#86b8dc"}
"""The colours as areas, on which a reader can still see lines and spend less ink."""
ENDS = "#d7191c"


class PointColours(TypedDict, total=False):
    """The colours of points, as Matplotlib takes them."""

    c: Array
    cmap: str
    vmin: float
    vmax: float


def draw_figure_1(dataset: Dataset, pair: ShownPair) -> Figure:
    """Draw the clouds of a loop closure, their gradient maps, and both clouds aligned: Fig. 1."""
    width, room = 1.3, 2.0  # of a panel of the left, and of the panel on the right
    height = width * shape_of(pair.query.map.grid, pair.database.map.grid)
    figure = new_figure(PAGE, 2 * height + 1.15, layout=None)
    high = _steepest(pair)
    for row, (letters, role, shown) in enumerate(
        (("ab", "query", pair.query), ("cd", "database", pair.database))
    ):
        top = 0.2 + row * (height + 0.55)
        cloud, field = (
            add_panel(figure, 0.4 + 2.15 * column, top, width, height) for column in range(2)
        )
        heights = _scatter_from_above(cloud, shown.submap)
        left, right, bottom, upper = extent_of(shown.map.grid)
        cloud.set_xlim(left, right)
        cloud.set_ylim(bottom, upper)
        if shown.submap.colors is None:
            add_bar(heights, cloud, "height [m]")
        cloud.set_title(f"({letters[0]}) {role} {shown.submap.id}")
        image = show_field(
            field, shown.map.grid, shown.map.gradient, cmap=GRADIENT_COLOURS, vmin=0.0, vmax=high
        )
        field.set_title(f"({letters[1]}) its gradient map")
        field.set_ylabel("")
        add_bar(image, field, "gradient [m/m]")
    panel = add_panel(figure, PAGE - 0.1 - room, 0.2, room, 2 * height + 0.55)
    poses, name = aligning_poses(dataset, pair)
    _scatter_pair(panel, pair, poses)
    panel.set_title(f"(e) aligned by {name}")
    in_metres(panel)
    return figure


def draw_figure_3(shown: ShownSubmap) -> Figure:
    """Draw a cloud from two sides, and its map: elevation, variance, slope and gradient: Fig. 3."""
    gradient_map, width = shown.map, 1.45
    height = width * shape_of(gradient_map.grid)
    figure = new_figure(PAGE, 2 * height + 0.95, layout=None)
    for row, (view, title) in enumerate(
        zip(VIEWS, ("(a) the cloud from one side", "(d) from the other side"), strict=True)
    ):
        top = 0.2 + row * (height + 0.35)
        panel = add_panel(figure, 0.2, top, 1.9, height, projection="3d")
        _scatter_in_space(panel, shown.submap, view)
        figure.text(0.1 / PAGE, 1 - (top - 0.04) / figure.get_figheight(), title)
    steepest = shown.trusted_range(np.abs(gradient_map.slope[..., 0]), 0, 99)[1]
    low, high = shown.trusted_range(gradient_map.elevation, 0.5, 99.5)
    brightest = shown.trusted_range(gradient_map.gradient, 0, 99)[1]
    heights = {"cmap": HEIGHT_COLOURS, "vmin": low, "vmax": high}
    variances = {"cmap": VARIANCE_COLOURS, "norm": LogNorm(*_limits(gradient_map))}
    slopes = {"cmap": SLOPE_COLOURS, "vmin": -steepest, "vmax": steepest}
    gradients = {"cmap": GRADIENT_COLOURS, "vmin": 0.0, "vmax": brightest}
    along_x = gradient_map.slope[..., 0]
    for row, column, title, field, label, options in (
        (0, 1, "(b) elevation", gradient_map.elevation, "elevation [m]", heights),
        (0, 2, "(c) variance", gradient_map.variance, "variance [m²]", variances),
        (1, 1, "(e) slope along x", along_x, "∂z/∂x [m/m]", slopes),
        (1, 2, "(f) gradient map", gradient_map.gradient, "gradient [m/m]", gradients),
    ):
        left = 2.85 + (column - 1) * 2.25
        panel = add_panel(figure, left, 0.2 + row * (height + 0.35), width, height)
        image = show_field(panel, gradient_map.grid, field, **options)
        panel.set_title(title)
        add_bar(image, panel, label)
        if row == 0:
            panel.set_xlabel("")
        if column == 2:
            panel.set_ylabel("")
    return figure


def draw_figure_4(pair: ShownPair) -> Figure:
    """Draw both gradient maps, their associations, and the maps aligned: Fig. 4."""
    query, database, mask = pair.query.map, pair.database.map, pair.query.mask
    high = _steepest(pair)
    grid, picture = _overlaid(query, database, pair.motion, mask, high)
    beside = _beside(query.grid, database.grid)
    narrow, wide = 1.35, 2.4
    heights = (
        narrow * shape_of(query.grid, database.grid),
        (COLUMN - 0.1) * shape_of(_joined(query.grid, beside)),
        wide * shape_of(grid),
    )
    figure = new_figure(COLUMN, sum(heights) + 1.75, layout=None)
    for role, shown, left, colour in (
        ("query", pair.query, 0.4, QUERY),
        ("database", pair.database, COLUMN - 0.05 - narrow, DATABASE),
    ):
        panel = add_panel(figure, left, 0.2, narrow, heights[0])
        veil = _veil(shown.map, mask)
        tinted = _tinted(_grey(shown.map, high), veil, to_rgb(PALE[colour]))
        show_field(panel, shown.map.grid, tinted)
        panel.set_title(f"{role} {shown.submap.id}")
    panel.set_ylabel("")
    second = 0.2 + heights[0] + 0.6
    associations = add_panel(figure, 0.05, second, COLUMN - 0.1, heights[1])
    _draw_associations(associations, pair, beside, high)
    aligned = add_panel(figure, 0.7, second + heights[1] + 0.25, wide, heights[2])
    show_field(aligned, grid, picture)
    aligned.set_title("aligned, in the database's frame")
    registration = pair.closure.registration
    others = int(np.sum(~registration.inliers))
    figure.legend(
        handles=[
            Patch(color=PALE[QUERY], label="variance of the query"),
            Patch(color=PALE[DATABASE], label="variance of the database"),
            Line2D([], [], color=INLIER, label=f"inliers: {registration.num_inliers}"),
            Line2D([], [], color=OUTLIER, label=f"other associations: {others}"),
        ],
        loc="lower center",
        ncols=2,
        frameon=False,
        borderpad=0.0,
    )
    return figure


def draw_figure_6(datasets: Sequence[Dataset]) -> Figure:
    """Draw the positions of the submaps in their order, a panel for each dataset: Fig. 6."""
    figure, panels = new_panels([dataset.name for dataset in datasets], height=2.3)
    shade = ScalarMappable(Normalize(0.0, 1.0), "viridis")
    for panel, dataset in zip(panels, datasets, strict=True):
        poses, _ = poses_of(dataset)
        centres = {submap.id: submap.centre[None] for submap in dataset.submaps}
        track = np.array([pose.apply(centres[name])[0, :2] for name, pose in poses.items()])
        steps = np.stack([track[:-1], track[1:]], axis=1)
        middle = (np.arange(len(steps)) + 0.5) / len(steps)
        panel.add_collection(
            LineCollection(list(steps), colors=shade.to_rgba(middle), linewidths=1.8)
        )
        place = np.linspace(0.0, 1.0, len(track))
        panel.scatter(*track.T, s=5, color=shade.to_rgba(place), zorder=3)
        for (x, y), marker in ((track[0], "o"), (track[-1], "s")):
            panel.plot([x], [y], marker, color=ENDS, fillstyle="none", markersize=7, zorder=4)
        panel.margins(0.1)
        in_metres(panel)
        panel.set_aspect("equal", adjustable="datalim")
        panel.grid(alpha=0.3, linewidth=0.5)
    bar = figure.colorbar(shade, ax=panels, shrink=0.9, pad=0.01, aspect=30)
    bar.set_label("place in the order of submaps")
    bar.set_ticks([0.0, 1.0], labels=["first", "last"])
    figure.legend(
        handles=[
            Line2D([], [], linestyle="", marker=marker, color=ENDS, fillstyle="none", label=label)
            for marker, label in (("o", "start"), ("s", "end"))
        ],
        loc="outside lower center",
        ncols=2,
        frameon=False,
    )
    return figure


def draw_figure_10(dataset: Dataset, pair: ShownPair) -> Figure:
    """Draw the pair in red and blue among all other submaps in grey: Fig. 10."""
    poses, name = poses_of(dataset)
    colours = {pair.query.submap.id: QUERY, pair.database.submap.id: DATABASE}
    there = [submap for submap in dataset.submaps if submap.id in poses]
    rest = [
        _placed(poses[submap.id], submap, POINTS_OF_THE_REST)
        for submap in there
        if submap.id not in colours
    ]
    figure = new_figure(COLUMN, COLUMN)
    panel = figure.subplots()
    if rest:
        x, y, _ = np.vstack(rest).T
        panel.scatter(x, y, s=0.6, linewidths=0, color=REST, rasterized=True)
    _scatter_pair(panel, pair, poses)
    for submap in there:
        _mark_origin(panel, submap, poses[submap.id].planar, colours.get(submap.id))
    in_metres(panel)
    panel.set_title(f"aligned by {name}")
    # The figure gets the shape of the ground that it shows.
    (left, right), (bottom, top) = panel.get_xlim(), panel.get_ylim()
    shape = float(np.clip((top - bottom) / (right - left), 0.3, 1.7))
    figure.set_figheight(0.5 + (COLUMN - 0.6) * shape)
    return figure


def aligning_poses(dataset: Dataset, pair: ShownPair) -> tuple[dict[str, Pose], str]:
    """The poses of the shown pair in one frame, and the source of these poses."""
    poses, name = poses_of(dataset)
    query, database = pair.query.submap.id, pair.database.submap.id
    if query in poses and database in poses:
        return poses, name
    return {database: Pose.from_planar(SE2()), query: Pose.from_planar(pair.motion)}, (
        "the motion found"
    )


def _steepest(pair: ShownPair) -> float:
    """The gradient that is drawn brightest on both maps [m/m]."""
    return max(
        shown.trusted_range(shown.map.gradient, 0, 99)[1] for shown in (pair.query, pair.database)
    )


def _limits(gradient_map: GradientMap) -> tuple[float, float]:
    """The least and the largest variance, apart and above zero [m²]."""
    high = max(float(gradient_map.variance.max()), 1e-30)
    low = max(float(gradient_map.variance.min()), 1e-6 * high)
    return low, max(high, 1.001 * low)


def _thinned(submap: Submap, most: int = MOST_POINTS) -> NDArray[np.intp]:
    """Choose points to draw: every so-manieth, from the lowest to the highest."""
    order = np.argsort(submap.points[:, 2], kind="stable")
    return order[:: -(-len(order) // most)]


def _colours(submap: Submap, chosen: NDArray[np.intp]) -> PointColours:
    """The points' own colours, or colours by their heights."""
    if submap.colors is not None:
        return {"c": submap.colors[chosen]}
    heights = submap.points[:, 2]
    low, high = np.percentile(heights, [0.5, 99.5])
    return {"c": heights[chosen], "cmap": HEIGHT_COLOURS, "vmin": low, "vmax": high}


def _scatter_from_above(panel: Axes, submap: Submap) -> PathCollection:
    chosen = _thinned(submap)
    x, y, _ = submap.points[chosen].T
    drawn = panel.scatter(x, y, s=0.5, linewidths=0, rasterized=True, **_colours(submap, chosen))
    in_metres(panel)
    return drawn


def _scatter_in_space(panel: Any, submap: Submap, view: tuple[float, float]) -> None:
    """Draw a cloud in space; the panel is of Matplotlib's mplot3d, whose types are not right."""
    chosen = _thinned(submap)
    x, y, z = submap.points[chosen].T
    colours = _colours(submap, chosen)
    panel.scatter(x, y, z, s=0.4, linewidths=0, depthshade=False, rasterized=True, **colours)
    panel.view_init(*view)
    spans = np.ptp(submap.points[chosen], axis=0)
    panel.set_box_aspect(tuple(np.maximum(spans, 0.05 * spans.max())), zoom=1.05)
    panel.locator_params(nbins=4)
    panel.locator_params(axis="z", nbins=2)
    panel.tick_params(labelsize=6.0, pad=-3)
    for name, axis in (("x", panel.xaxis), ("y", panel.yaxis), ("z", panel.zaxis)):
        axis.set_label_text(f"{name} [m]", fontsize=6.5)
        axis.labelpad = -10 if name == "z" else -6
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))


def _scatter_pair(panel: Axes, pair: ShownPair, poses: Mapping[str, Pose]) -> None:
    """Draw the query in red and the database submap in blue, neither of them on top."""
    submaps = pair.query.submap, pair.database.submap
    clouds = [_placed(poses[submap.id], submap) for submap in submaps]
    colours = np.repeat([QUERY, DATABASE], [len(cloud) for cloud in clouds])
    order = np.random.default_rng(0).permutation(len(colours))
    x, y, _ = np.vstack(clouds)[order].T
    panel.scatter(x, y, s=0.6, linewidths=0, c=list(colours[order]), rasterized=True)


def _placed(pose: Pose, submap: Submap, most: int = MOST_POINTS) -> Float[Array, "n 3"]:
    """Place the points that are drawn in the world [m]."""
    return pose.apply(submap.points[_thinned(submap, most)])


def _mark_origin(panel: Axes, submap: Submap, pose: SE2, colour: str | None) -> None:
    """Mark a submap's origin; its number stands on the left of where the rover looked."""
    number = index_of(submap.id)
    panel.plot([pose.x], [pose.y], "k+", markersize=4, markeredgewidth=0.8, zorder=5)
    panel.annotate(
        submap.id if number is None else str(number),
        (pose.x, pose.y),
        (-7.0 * np.sin(pose.yaw), 7.0 * np.cos(pose.yaw)),
        textcoords="offset points",
        ha="center",
        va="center",
        fontsize=6.0 if colour is None else 8.5,
        fontweight="normal" if colour is None else "bold",
        color="black" if colour is None else colour,
        path_effects=[withStroke(linewidth=1.5, foreground="white")],
        zorder=4,
    )


def _beside(query: Grid, database: Grid) -> Grid:
    gap = 0.08 * float(np.ptp(query.x))
    x = query.x[-1] + gap
    y = database.origin[1] + query.y.mean() - database.y.mean()
    return Grid((float(x), float(y)), database.resolution, database.shape)


def _joined(first: Grid, second: Grid) -> Grid:
    ends = [[(grid.x[k], grid.y[k]) for k in (0, -1)] for grid in (first, second)]
    return Grid.covering(np.array(ends, dtype=np.float64).reshape(-1, 2), first.resolution)


def _draw_associations(panel: Axes, pair: ShownPair, beside: Grid, high: float) -> None:
    """Draw both gradient maps side by side, and a line for each association."""
    left, right, matches = pair.query.map, pair.database.map, pair.matches
    for grid, gradient_map in ((left.grid, left), (beside, right)):
        veil = _veil(gradient_map, pair.query.mask)
        show_field(panel, grid, _tinted(_grey(gradient_map, high), veil, (1.0, 1.0, 1.0)))
    inliers = pair.closure.registration.inliers
    shift = np.subtract(beside.origin, right.grid.origin)
    lines = np.stack([matches.query_xy, matches.database_xy + shift], axis=1)
    for some, colour, width, order in ((~inliers, OUTLIER, 0.3, 2), (inliers, INLIER, 0.6, 3)):
        panel.add_collection(
            LineCollection(list(lines[some]), colors=colour, linewidths=width, zorder=order)
        )
        ends = lines[some].reshape(-1, 2)
        panel.plot(*ends.T, ".", color=colour, markersize=4 * width**0.5, zorder=order)
    around = _joined(left.grid, beside)
    panel.set_xlim(around.x[0], around.x[-1])
    panel.set_ylim(around.y[0], around.y[-1])
    panel.set_axis_off()
    panel.set_title("associations of keypoints")


def _grey(gradient_map: GradientMap, high: float) -> Picture:
    return np.repeat(np.clip(gradient_map.gradient / high, 0.0, 1.0)[..., None] ** 0.8, 3, axis=2)


def _veil(gradient_map: GradientMap, mask: float) -> LayerValues:
    """The opacity of the variance's colour: linear in the variance, up to the mask's."""
    most = (mask * gradient_map.detail_std) ** 2
    return np.clip(gradient_map.variance / most, 0.0, 1.0)


def _tinted(picture: Picture, veil: LayerValues, colour: tuple[float, ...] | Picture) -> Picture:
    return (1 - veil[..., None]) * picture + veil[..., None] * np.asarray(colour)


def _overlaid(
    query: GradientMap, database: GradientMap, T_database_query: SE2, mask: float, high: float
) -> tuple[Grid, Picture]:
    """Lay both gradient maps over each other on a grid in the database's frame."""
    sides = ((query, T_database_query), (database, SE2()))
    corners = [
        motion.apply(np.array([(x, y) for x in side.grid.x[[0, -1]] for y in side.grid.y[[0, -1]]]))
        for side, motion in sides
    ]
    step = max(query.grid.resolution, database.grid.resolution)
    grid = Grid.covering(np.vstack(corners), step)
    greys, clear, veils = list[Picture](), list[LayerValues](), list[LayerValues]()
    for side, motion in sides:
        pixels = side.grid.to_pixel(motion.inverse().apply(grid.positions))
        inside = ((pixels >= 0) & (pixels <= np.array(side.grid.shape[::-1]) - 1)).all(axis=1)
        image = np.dstack([_grey(side, high)[..., :1], _veil(side, mask)]).astype(np.float32)
        values = interpolate(image, pixels[:, None])[:, 0].reshape(*grid.shape, 2)
        there = inside.reshape(grid.shape)
        greys.append(values[..., :1])
        veils.append(values[..., 1] * there)
        clear.append((1 - values[..., 1]) * there)
    # Each map counts by how clear it is; where neither is, nothing is to be seen below the tint.
    weights = np.stack(clear)[..., None]
    total = weights.sum(axis=0)
    grey = np.divide((weights * np.stack(greys)).sum(axis=0), total, where=total > 0, out=1 - total)
    # The tint of one map is faint where the other is clear, or it would hide that.
    faint = np.stack(
        [veil * (1 - 0.55 * other) for veil, other in zip(veils, clear[::-1], strict=True)]
    )
    tints = np.array([to_rgb(PALE[QUERY]), to_rgb(PALE[DATABASE])])
    mixed = np.einsum("krc,kd->rcd", faint, tints)
    amount = faint.sum(axis=0)[..., None]
    tint = np.divide(mixed, amount, where=amount > 0, out=np.ones_like(mixed))
    return grid, _tinted(np.repeat(grey, 3, axis=2), faint.max(axis=0), tint)
