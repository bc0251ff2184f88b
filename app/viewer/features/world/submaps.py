"""The whole dataset in one frame: poses, figures and a light surface of each submap.

Two kinds of surface serve. A smoothed grid takes a hundredth of a second a submap, and shows
shape and height; deviation and gradient need the Gaussian process, whose maps the pipeline makes
anyway and keeps.
"""

import colorsys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil, degrees, sqrt
from typing import Annotated, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from typing_extensions import Doc

from app.viewer.scene.colors import Rgb
from app.viewer.scene.layers import Scale, shared_scale
from app.viewer.scene.surfels import Surfels, make_surfels, stride_for
from app.viewer.session.state import Layer, Widget
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection import PipelineParams
from gpgrad_core.detection.coarse import infer_quick_map
from gpgrad_core.methods.smoothed import smoothed_map
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Dataset, GradientMap, Submap

PoseSource: TypeAlias = Literal["corrected", "true", "odometry", "in rows"]
WorldColor: TypeAlias = Literal["submap", "elevation", "deviation", "gradient"]

GAP = 1.15
"""Distance of submaps in rows, in widths of the widest."""
FOOTPRINT_CELL = 0.25
"""Ground is seen where a square of this side holds a point [m]."""


@dataclass(frozen=True)
class WorldOptions:
    """How the world is drawn. Fields are widgets of the tab World, in this order."""

    poses: Annotated[
        PoseSource,
        Doc("Which poses the submaps have: from odometry, corrected by the pose graph, or true."),
    ] = "odometry"
    color: Annotated[
        WorldColor,
        Doc(
            "submap: each has its own colour. elevation: height in the world. deviation and "
            "gradient: of the Gaussian-process maps, which are made on first use."
        ),
        Widget("Colour by"),
    ] = "submap"
    names: Annotated[bool, Doc("Writes the id of each submap above it.")] = True
    trajectories: Annotated[bool, Doc("Orange is odometry, blue is corrected, grey is true.")] = (
        True
    )
    loops: Annotated[bool, Doc("Accepted loop closures."), Widget(offered=False)] = True
    refused: Annotated[bool, Doc("Pairs that were refused."), Widget(offered=False)] = False


def pose_sources(
    dataset: Dataset, corrected: Mapping[str, Pose] | None = None
) -> tuple[PoseSource, ...]:
    """List where poses can come from, odometry first; "in rows" where there are none."""
    sources: list[PoseSource] = []
    if any(submap.pose_odometry for submap in dataset.submaps):
        sources.append("odometry")
    if corrected:
        sources.append("corrected")
    if any(submap.pose_true for submap in dataset.submaps):
        sources.append("true")
    return tuple(sources) or ("in rows",)


def poses_of(
    dataset: Dataset, source: PoseSource, corrected: Mapping[str, Pose] | None = None
) -> dict[str, Pose]:
    """Give ``T_world_submap`` of each submap that the source knows, in the dataset's order."""
    if source == "in rows":
        return _in_rows(dataset)
    poses: dict[str, Pose | None] = {
        submap.id: {
            "true": submap.pose_true,
            "odometry": submap.pose_odometry,
            "corrected": (corrected or {}).get(submap.id),
        }[source]
        for submap in dataset.submaps
    }
    return {name: pose for name, pose in poses.items() if pose is not None}


def _in_rows(dataset: Dataset) -> dict[str, Pose]:
    """Lay submaps without poses out in rows."""
    middles = [
        (submap.points.min(axis=0) + submap.points.max(axis=0)) / 2 for submap in dataset.submaps
    ]
    widest = max(float(np.ptp(submap.points[:, :2], axis=0).max()) for submap in dataset.submaps)
    columns = ceil(sqrt(len(dataset.submaps)))
    return {
        submap.id: Pose(
            np.array([GAP * widest * (k % columns), -GAP * widest * (k // columns), 0.0]) - middle,
            np.array([0.0, 0.0, 0.0, 1.0]),
        )
        for k, (submap, middle) in enumerate(zip(dataset.submaps, middles, strict=True))
    }


def figures_of(submap: Submap, corrected: Pose | None = None) -> tuple[tuple[str, str], ...]:
    """Measure a submap, and write that as rows of a name and a value with its unit.

    Its true pose, if known, says how far odometry and the corrected pose are off.
    """
    points, area = submap.points, footprint(submap)
    x, y, z = (float(side) for side in np.ptp(points, axis=0))
    rows = [
        ("points", f"{len(points):,}"),
        ("extent", f"{x:.1f} m x {y:.1f} m, {z:.2f} m high"),
        ("ground seen", f"{area:.1f} m²"),
        ("density", f"{len(points) / area:.0f} points/m²"),
        ("height std", f"{points[:, 2].std():.3f} m"),
    ]
    true = submap.pose_true
    poses = {"odometry": submap.pose_odometry, "corrected": corrected}
    for name, pose in ({"true pose": true} | poses).items():
        if pose is not None:
            rows.append((name, describe_pose(pose)))
    for name, pose in poses.items():
        if pose is not None and true is not None:
            off = np.linalg.norm(pose.translation - true.translation)
            rows.append((f"{name} off by", f"{off:.2f} m"))
    return tuple(rows)


def footprint(submap: Submap) -> float:
    """Measure the ground on which a submap has points [m²]."""
    columns, rows = np.floor(submap.points[:, :2] / FOOTPRINT_CELL).astype(np.int64).T
    # One number a cell: sorting rows of two takes ten times as long.
    cells = np.unique(columns * (np.ptp(rows) + 1) + rows)
    return len(cells) * FOOTPRINT_CELL**2


def describe_pose(pose: Pose) -> str:
    """Write a pose's position and heading."""
    x, y, z = pose.translation
    return f"{x:z.2f}, {y:z.2f}, {z:z.2f} m; {degrees(pose.planar.yaw):+z.1f}°"


MAX_CELLS = 200_000
"""Of all submaps together: what a browser draws and a network carries in a moment."""
SMOOTHED_OVER = 2.5
"""Length-scales of the smoothed grid are this many cells or more, so that no gaps show."""
COARSEST = 10.0
"""No cell is larger [m]; `make_patch` leaves some out instead."""
SMOOTHED_NOISE = 0.01
"""So little [m] that the smoothed grid is masked by where there are points alone."""
SMOOTHED_RATIO = 0.999
GOLDEN_TURN = 0.618034
"""Hues that go on by this share of the circle never come near those just before."""

LAYER_OF: dict[WorldColor, Layer] = {
    "submap": "elevation",
    "elevation": "elevation",
    "deviation": "std",
    "gradient": "gradient",
}
NEEDS_INFERENCE: tuple[WorldColor, ...] = ("deviation", "gradient")


@dataclass(frozen=True, eq=False)
class Surface:
    """One submap as the world shows it: a map and which of its cells are to be trusted."""

    gradient_map: GradientMap
    max_std_ratio: float


def quick_surface(submap: Submap, params: PipelineParams, memo: Memo, num_submaps: int) -> Surface:
    """Make the smoothed grid of a submap, coarser the more submaps there are.

    Raises:
        InputError: If the grid would be too large.
    """
    finest = sqrt(memo(footprint, submap) * num_submaps / MAX_CELLS)
    resolution = min(max(params.map.resolution, round(finest + 0.0005, 3)), COARSEST)
    light = replace(
        params.map,
        resolution=resolution,
        length_scale=max(params.map.terrain.length_scale, SMOOTHED_OVER * resolution),
        noise_std=SMOOTHED_NOISE,
        signal_std=None,
    )
    made = memo(smoothed_map, submap, PipelineParams(map=light))
    return Surface(made, SMOOTHED_RATIO)


def inferred_surface(
    submap: Submap, params: PipelineParams, memo: Memo, progress: Progress = silent
) -> Surface:
    """Infer a submap's gradient map: the full one if the memo has it, and else a coarse one.

    Raises:
        InputError: If the map cannot be made.
    """
    return Surface(
        infer_quick_map(submap, params.map, memo, progress), params.features.max_std_ratio
    )


def world_scale(
    surfaces: dict[str, Surface], poses: dict[str, Pose], color: WorldColor
) -> Scale | None:
    """Choose one range of colours for all submaps; None where each has its own colour.

    Args:
        surfaces: By id.
        poses: Of each; they give the heights.
        color: What colours them.
    """
    if color == "submap" or not surfaces:
        return None
    layer = LAYER_OF[color]
    lifts = [
        float(poses[name].translation[2]) if color == "elevation" else 0.0 for name in surfaces
    ]
    ratio = min(surface.max_std_ratio for surface in surfaces.values())
    maps = tuple(surface.gradient_map for surface in surfaces.values())
    return shared_scale(maps, layer, "automatic", ratio, tuple(lifts))


def make_patch(
    surface: Surface,
    pose: Pose,
    color: WorldColor,
    scale: Scale | None,
    tint: Rgb,
    num_submaps: int,
) -> Surfels:
    """Turn one submap into coloured squares in its own frame.

    Args:
        surface: What to draw.
        pose: Where it stands: for the light and the height.
        color: What colours it.
        scale: What the colours mean; None for the one colour ``tint``.
        tint: The submap's own colour.
        num_submaps: That share the cells there may be.
    """
    return make_surfels(
        surface.gradient_map,
        scale or Scale("", "", "viridis", 0.0, 1.0),
        layer=LAYER_OF[color],
        max_std_ratio=surface.max_std_ratio,
        yaw=pose.planar.yaw,
        offset=float(pose.translation[2]) if color == "elevation" else 0.0,
        stride=stride_for(surface.gradient_map.grid.num_cells, max(1, MAX_CELLS // num_submaps)),
        tint=tint if scale is None else None,
    )


def submap_color(place: int) -> Rgb:
    """Give a submap its own colour, unlike those of its neighbours along the trajectory."""
    red, green, blue = colorsys.hls_to_rgb((0.58 + GOLDEN_TURN * place) % 1.0, 0.62, 0.5)
    return round(255 * red), round(255 * green), round(255 * blue)


def pick(
    origin: Float[Array, "3"],
    direction: Float[Array, "3"],
    surfaces: dict[str, tuple[Float[NDArray[np.float32], "n 3"], Pose, float]],
) -> str | None:
    """Say which submap a ray hits first.

    Args:
        origin: Where the ray starts [m].
        direction: Where it goes, of any length.
        surfaces: Of each submap, by id: cells in its own frame [m], its pose in the frame of the
            ray, and the side of a cell [m].
    """
    toward = direction / np.linalg.norm(direction)
    nearest, chosen = np.inf, None
    for name, (cells, pose, size) in surfaces.items():
        # Into the submap's frame: two vectors to turn, not thousands.
        start = (origin - pose.translation) @ pose.rotation
        along = toward @ pose.rotation
        arm = cells - start
        depth = arm @ along
        aside = np.sum(arm * arm, axis=1) - depth**2
        hit = (aside < size**2) & (depth > 0)
        if hit.any() and depth[hit].min() < nearest:
            nearest, chosen = float(depth[hit].min()), name
    return chosen
