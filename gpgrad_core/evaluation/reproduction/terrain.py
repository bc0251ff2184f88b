"""Clouds and their maps: the paper's Figs. 1 and 3."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from gpgrad_core.arrays import NDArray
from gpgrad_core.evaluation.reproduction.style import (
    DATABASE,
    GRADIENT_COLOURS,
    HEIGHT_COLOURS,
    PAGE,
    QUERY,
    SLOPE_COLOURS,
    VARIANCE_COLOURS,
    add_bar,
    add_panel,
    extent_of,
    in_metres,
    new_figure,
    shape_of,
    show_field,
)
from gpgrad_core.evaluation.reproduction.subject import Shown, poses_of, trusted_range
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Array, Dataset, GradientMap, Submap

MOST_POINTS = 30_000
"""Points of a cloud that are drawn; more would cover each other."""
VIEWS = ((28.0, -60.0), (28.0, 120.0))
"""Elevation and azimuth of the two viewpoints [degrees]."""


def draw_matching_maps(dataset: Dataset, shown: Shown) -> Figure:
    """Draw the clouds of a loop closure, their gradient maps, and both clouds aligned: Fig. 1."""
    assert shown.database is not None
    assert shown.database_map is not None
    width, room = 1.3, 2.0  # of a panel of the left, and of the panel on the right
    height = width * shape_of(shown.query_map.grid, shown.database_map.grid)
    figure = new_figure(PAGE, 2 * height + 1.15, layout=False)
    panels = {
        name: add_panel(figure, 0.4 + 2.15 * column, 0.2 + row * (height + 0.55), width, height)
        for name, row, column in (("A", 0, 0), ("B", 0, 1), ("C", 1, 0), ("D", 1, 1))
    }
    panels["E"] = add_panel(figure, PAGE - 0.1 - room, 0.2, room, 2 * height + 0.55)
    maps = shown.query_map, shown.database_map
    high = max(trusted_range(one, one.gradient, shown.mask, 0, 99)[1] for one in maps)
    for names, role, submap, made in (
        ("AB", "query", shown.query, shown.query_map),
        ("CD", "database", shown.database, shown.database_map),
    ):
        cloud, field = (panels[name] for name in names)
        heights = _scatter_from_above(cloud, submap)
        left, right, bottom, top = extent_of(made.grid)
        cloud.set_xlim(left, right)
        cloud.set_ylim(bottom, top)
        if submap.colors is None:
            add_bar(heights, cloud, "height [m]")
        cloud.set_title(f"({names[0].lower()}) {role} {submap.id}")
        image = show_field(
            field, made.grid, made.gradient, cmap=GRADIENT_COLOURS, vmin=0.0, vmax=high
        )
        field.set_title(f"({names[1].lower()}) its gradient map")
        field.set_ylabel("")
        add_bar(image, field, "gradient [m/m]")
    _show_aligned(panels["E"], dataset, shown)
    return figure


def draw_map(shown: Shown) -> Figure:
    """Draw a cloud from two sides, and its map: elevation, variance, slope and gradient: Fig. 3."""
    made, submap = shown.query_map, shown.query
    width = 1.45
    height = width * shape_of(made.grid)
    figure = new_figure(PAGE, 2 * height + 0.95, layout=False)
    for row, (view, title) in enumerate(
        zip(VIEWS, ("(a) the cloud from one side", "(d) from the other side"), strict=True)
    ):
        top = 0.2 + row * (height + 0.35)
        panel = add_panel(figure, 0.2, top, 1.9, height, projection="3d")
        _scatter_in_space(panel, submap, view)
        figure.text(0.1 / PAGE, 1 - (top - 0.04) / figure.get_figheight(), title)
    steepest = trusted_range(made, np.abs(made.slope[..., 0]), shown.mask, 0, 99)[1]
    low, high = trusted_range(made, made.elevation, shown.mask, 0.5, 99.5)
    fields: tuple[tuple[int, int, str, Any, str, dict[str, Any]], ...] = (
        (
            *(0, 1, "(b) elevation", made.elevation, "elevation [m]"),
            {"cmap": HEIGHT_COLOURS, "vmin": low, "vmax": high},
        ),
        (
            *(0, 2, "(c) variance", made.variance, "variance [m²]"),
            {"cmap": VARIANCE_COLOURS, "norm": LogNorm(*_limits(made))},
        ),
        (
            *(1, 1, "(e) slope along x", made.slope[..., 0], "∂z/∂x [m/m]"),
            {"cmap": SLOPE_COLOURS, "vmin": -steepest, "vmax": steepest},
        ),
        (
            *(1, 2, "(f) gradient map", made.gradient, "gradient [m/m]"),
            {
                "cmap": GRADIENT_COLOURS,
                "vmin": 0.0,
                "vmax": trusted_range(made, made.gradient, shown.mask, 0, 99)[1],
            },
        ),
    )
    for row, column, title, field, label, options in fields:
        left = 2.85 + (column - 1) * 2.25
        panel = add_panel(figure, left, 0.2 + row * (height + 0.35), width, height)
        image = show_field(panel, made.grid, field, **options)
        panel.set_title(title)
        add_bar(image, panel, label)
        if row == 0:
            panel.set_xlabel("")
        if column == 2:
            panel.set_ylabel("")
    return figure


def _limits(made: GradientMap) -> tuple[float, float]:
    """Give the least and the largest variance, apart and above zero [m²]."""
    high = max(float(made.variance.max()), 1e-30)
    low = max(float(made.variance.min()), 1e-6 * high)
    return low, max(high, 1.001 * low)


def thinned(submap: Submap, most: int = MOST_POINTS) -> NDArray[np.intp]:
    """Choose points to draw: every so-manieth, from the lowest to the highest."""
    order = np.argsort(submap.points[:, 2], kind="stable")
    return order[:: -(-len(order) // most)]


def _colours(submap: Submap, chosen: NDArray[np.intp]) -> dict[str, Any]:
    """Give the points their own colours, or those of their heights."""
    if submap.colors is not None:
        return {"c": submap.colors[chosen]}
    heights = submap.points[:, 2]
    low, high = np.percentile(heights, [0.5, 99.5])
    return {"c": heights[chosen], "cmap": HEIGHT_COLOURS, "vmin": low, "vmax": high}


def _scatter_from_above(panel: Axes, submap: Submap) -> PathCollection:
    chosen = thinned(submap)
    x, y, _ = submap.points[chosen].T
    drawn = panel.scatter(x, y, s=0.5, linewidths=0, rasterized=True, **_colours(submap, chosen))
    in_metres(panel)
    return drawn


def _scatter_in_space(panel: Any, submap: Submap, view: tuple[float, float]) -> None:
    """Draw a cloud in space; the panel is of Matplotlib's mplot3d, whose types are not right."""
    chosen = thinned(submap)
    x, y, z = submap.points[chosen].T
    panel.scatter(
        x,
        y,
        z,
        s=0.4,
        linewidths=0,
        depthshade=False,
        rasterized=True,
        **_colours(submap, chosen),
    )
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


def _show_aligned(panel: Axes, dataset: Dataset, shown: Shown) -> None:
    """Draw both clouds in one frame: by their poses if they are known, or by the motion."""
    assert shown.database is not None
    poses, name = aligning_poses(dataset, shown)
    scatter_pair(panel, shown, poses)
    panel.set_title(f"(e) aligned by {name}")
    in_metres(panel)


def aligning_poses(dataset: Dataset, shown: Shown) -> tuple[dict[str, Pose], str]:
    """Give the poses of the shown pair in one frame, and say where they come from."""
    assert shown.database is not None
    assert shown.closure is not None
    poses, name = poses_of(dataset)
    if shown.query.id in poses and shown.database.id in poses:
        return poses, name
    motion = shown.closure.registration.T_database_query
    assert motion is not None  # of a pair that was chosen
    still = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    return {shown.database.id: still, shown.query.id: Pose.from_planar(motion)}, "the motion found"


def scatter_pair(panel: Axes, shown: Shown, poses: Mapping[str, Pose]) -> None:
    """Draw the query in red and the database submap in blue, neither of them on top."""
    assert shown.database is not None
    clouds = [placed(poses[submap.id], submap) for submap in (shown.query, shown.database)]
    colours = np.repeat([QUERY, DATABASE], [len(cloud) for cloud in clouds])
    order = np.random.default_rng(0).permutation(len(colours))
    x, y, _ = np.vstack(clouds)[order].T
    panel.scatter(x, y, s=0.6, linewidths=0, c=list(colours[order]), rasterized=True)


def placed(pose: Pose, submap: Submap, most: int = MOST_POINTS) -> Float[Array, "n 3"]:
    """Place the points that are drawn in the world [m]."""
    return pose.apply(submap.points[thinned(submap, most)])
