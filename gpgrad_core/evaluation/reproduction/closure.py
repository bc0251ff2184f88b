"""One loop closure: how it is checked, and where it lies among the others: Figs. 4 and 10."""

from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from gpgrad_core.arrays import NDArray
from gpgrad_core.datasets.folder import index_of
from gpgrad_core.evaluation.reproduction.style import (
    COLUMN,
    DATABASE,
    INLIER,
    OUTLIER,
    QUERY,
    REST,
    add_panel,
    in_metres,
    new_figure,
    shape_of,
    show_field,
)
from gpgrad_core.evaluation.reproduction.subject import Shown, poses_of, trusted_range
from gpgrad_core.evaluation.reproduction.terrain import placed, scatter_pair
from gpgrad_core.features.interpolation import interpolate
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset, GradientMap, Grid, Submap

Layer: TypeAlias = Float[NDArray[np.floating], "rows columns"]
Picture: TypeAlias = Float[NDArray[np.floating], "rows columns 3"]

PALE = {QUERY: "#f19a90", DATABASE: "#86b8dc"}
"""The colours as areas, on which a reader can still see lines and spend less ink."""
POINTS_OF_THE_REST = 4000
"""Points of each submap that is drawn in grey."""


def draw_check(shown: Shown) -> Figure:
    """Draw both gradient maps, their associations, and the maps aligned: Fig. 4."""
    assert shown.database_map is not None
    assert shown.closure is not None
    assert shown.matches is not None
    query, database = shown.query_map, shown.database_map
    high = max(trusted_range(one, one.gradient, shown.mask, 0, 99)[1] for one in (query, database))
    motion = shown.closure.registration.T_database_query
    assert motion is not None  # of a pair that was chosen
    grid, picture = _overlaid(query, database, motion, shown.mask, high)
    beside = _beside(query.grid, database.grid)
    narrow, wide = 1.35, 2.4
    heights = (
        narrow * shape_of(query.grid, database.grid),
        (COLUMN - 0.1) * shape_of(_joined(query.grid, beside)),
        wide * shape_of(grid),
    )
    figure = new_figure(COLUMN, sum(heights) + 1.75, layout=False)
    second = 0.2 + heights[0] + 0.6
    panels = {
        "A": add_panel(figure, 0.4, 0.2, narrow, heights[0]),
        "B": add_panel(figure, COLUMN - 0.05 - narrow, 0.2, narrow, heights[0]),
        "C": add_panel(figure, 0.05, second, COLUMN - 0.1, heights[1]),
        "D": add_panel(figure, 0.7, second + heights[1] + 0.25, wide, heights[2]),
    }
    for name, role, made, colour in (
        ("A", "query", query, QUERY),
        ("B", "database", database, DATABASE),
    ):
        veil = _veil(made, shown.mask)
        show_field(panels[name], made.grid, _tinted(_grey(made, high), veil, to_rgb(PALE[colour])))
        submap = shown.query if role == "query" else shown.database
        assert submap is not None
        panels[name].set_title(f"{role} {submap.id}")
    panels["B"].set_ylabel("")
    _draw_associations(panels["C"], shown, beside, high)
    show_field(panels["D"], grid, picture)
    panels["D"].set_title("aligned, in the database's frame")
    figure.legend(
        handles=[
            Patch(color=PALE[QUERY], label="variance of the query"),
            Patch(color=PALE[DATABASE], label="variance of the database"),
            Line2D(
                [], [], color=INLIER, label=f"inliers: {shown.closure.registration.num_inliers}"
            ),
            Line2D(
                [],
                [],
                color=OUTLIER,
                label=f"other associations: {int(np.sum(~shown.closure.registration.inliers))}",
            ),
        ],
        loc="lower center",
        ncols=2,
        frameon=False,
        borderpad=0.0,
    )
    return figure


def draw_session(dataset: Dataset, shown: Shown) -> Figure:
    """Draw the pair in red and blue among all other submaps in grey: Fig. 10."""
    assert shown.database is not None
    poses, name = poses_of(dataset)
    pair = {shown.query.id: QUERY, shown.database.id: DATABASE}
    there = [submap for submap in dataset.submaps if submap.id in poses]
    rest = [
        placed(poses[submap.id], submap, POINTS_OF_THE_REST)
        for submap in there
        if submap.id not in pair
    ]
    figure = new_figure(COLUMN, COLUMN)
    panel = figure.subplots()
    if rest:
        x, y, _ = np.vstack(rest).T
        panel.scatter(x, y, s=0.6, linewidths=0, color=REST, rasterized=True)
    scatter_pair(panel, shown, poses)
    for submap in there:
        _mark_origin(panel, submap, poses[submap.id].planar, pair.get(submap.id))
    in_metres(panel)
    panel.set_title(f"aligned by {name}")
    _fit_height(figure, panel)
    return figure


def _fit_height(figure: Figure, panel: Axes) -> None:
    """Give the figure the shape of the ground that it shows."""
    (left, right), (bottom, top) = panel.get_xlim(), panel.get_ylim()
    figure.set_figheight(
        0.5 + (COLUMN - 0.6) * float(np.clip((top - bottom) / (right - left), 0.3, 1.7))
    )


def _mark_origin(panel: Axes, submap: Submap, pose: SE2, colour: str | None) -> None:
    """Mark a submap's origin; its number stands on the left of where the rover looked.

    So the numbers of a way out and of the way back beside it do not cover each other.
    """
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
    """Move the database's grid beside the query's."""
    gap = 0.08 * float(np.ptp(query.x))
    x = query.x[-1] + gap
    y = database.origin[1] + query.y.mean() - database.y.mean()
    return Grid((float(x), float(y)), database.resolution, database.shape)


def _joined(first: Grid, second: Grid) -> Grid:
    """Make a grid that covers two others."""
    ends = [[(grid.x[k], grid.y[k]) for k in (0, -1)] for grid in (first, second)]
    return Grid.covering(np.array(ends, dtype=np.float64).reshape(-1, 2), first.resolution)


def _draw_associations(panel: Axes, shown: Shown, beside: Grid, high: float) -> None:
    """Draw both gradient maps side by side, and a line for each association.

    Args:
        panel: Where.
        shown: The pair.
        beside: The database's grid, moved beside the query's.
        high: The gradient that is drawn in white.
    """
    assert shown.database_map is not None
    assert shown.matches is not None
    assert shown.closure is not None
    left, right = shown.query_map, shown.database_map
    shift = np.subtract(beside.origin, right.grid.origin)
    for grid, made in ((left.grid, left), (beside, right)):
        clear = _tinted(_grey(made, high), _veil(made, shown.mask), (1.0, 1.0, 1.0))
        show_field(panel, grid, clear)
    inliers = shown.closure.registration.inliers
    lines = np.stack([shown.matches.query_xy, shown.matches.database_xy + shift], axis=1)
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


def _grey(made: GradientMap, high: float) -> Picture:
    """Draw the gradient in grey: steep ground is bright."""
    return np.repeat(np.clip(made.gradient / high, 0.0, 1.0)[..., None] ** 0.8, 3, axis=2)


def _veil(made: GradientMap, mask: float) -> Layer:
    """Give the opacity of the variance's colour: linear in the variance, up to the mask's."""
    most = (mask * made.detail_std) ** 2
    return np.clip(made.variance / most, 0.0, 1.0)


def _tinted(picture: Picture, veil: Layer, colour: tuple[float, ...] | Picture) -> Picture:
    return (1 - veil[..., None]) * picture + veil[..., None] * np.asarray(colour)


def _overlaid(
    query: GradientMap, database: GradientMap, T_database_query: SE2, mask: float, high: float
) -> tuple[Grid, Picture]:
    """Lay both gradient maps over each other, each the fainter the larger its variance.

    Returns:
        A grid in the database's frame that covers both, and the picture on it.
    """
    corners = [
        motion.apply(np.array([(x, y) for x in made.grid.x[[0, -1]] for y in made.grid.y[[0, -1]]]))
        for made, motion in ((query, T_database_query), (database, SE2()))
    ]
    step = max(query.grid.resolution, database.grid.resolution)
    grid = Grid.covering(np.vstack(corners), step)
    greys, clear, veils = list[Picture](), list[Layer](), list[Layer]()
    for made, motion in ((query, T_database_query.inverse()), (database, SE2())):
        pixels = made.grid.to_pixel(motion.apply(grid.positions))
        inside = ((pixels >= 0) & (pixels <= np.array(made.grid.shape[::-1]) - 1)).all(axis=1)
        image = np.dstack([_grey(made, high)[..., :1], _veil(made, mask)]).astype(np.float32)
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
