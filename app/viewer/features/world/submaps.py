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
from typing_extensions import Doc

from app.viewer.scene.colors import Rgb
from app.viewer.scene.layers import stride_for
from app.viewer.scene.placement import Box
from app.viewer.session.state import Widget
from gpgrad_core.detection import PipelineParams
from gpgrad_core.detection.pipeline import infer_quick_map
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods.smoothed import smoothed_map
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import Pose
from gpgrad_core.slam.graph import at_centres
from gpgrad_core.types import Dataset, GradientMap, Grid, Submap

PoseSource: TypeAlias = Literal["corrected", "true", "odometry", "in rows", "at that time"]
"""Where poses come from; the last one is what a time line shows."""
WorldColor: TypeAlias = Literal["elevation", "gradient", "deviation", "submap"]

GAP = 1.15
"""Distance of submaps in rows, in widths of the widest."""
FOOTPRINT_CELL = 0.25
"""Ground is where a square of this side holds a point [m]."""


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
            "elevation: height in the world. gradient and deviation: of the merged terrain. "
            "submap: each has its own colour, where its middle is the nearest."
        ),
        Widget("Colour by"),
    ] = "elevation"
    names: Annotated[bool, Doc("Writes the id of each submap above it."), Widget(eye=True)] = True
    trajectories: Annotated[
        bool,
        Doc("Orange is odometry, dashed beside others; blue is corrected, white is true."),
        Widget(eye=True),
    ] = True
    loops: Annotated[bool, Doc("Accepted loop closures."), Widget(offered=False)] = True
    refused: Annotated[bool, Doc("Pairs that were refused."), Widget(offered=False)] = False


def pose_sources(
    dataset: Dataset, corrected: Mapping[str, Pose] | None = None
) -> tuple[PoseSource, ...]:
    """List where poses can come from, odometry first; "in rows" where there are none."""
    known: dict[PoseSource, object] = {
        "odometry": dataset.odometry,
        "corrected": corrected,
        "true": dataset.true_poses,
    }
    return tuple(source for source, poses in known.items() if poses) or ("in rows",)


def poses_of(
    dataset: Dataset, source: PoseSource, corrected: Mapping[str, Pose] | None = None
) -> dict[str, Pose]:
    """The poses that the source has, in the dataset's order: those of the submaps' centres."""
    if source == "in rows":
        return _in_rows(dataset)
    if source == "corrected":
        known = corrected or {}
        return {submap.id: known[submap.id] for submap in dataset.submaps if submap.id in known}
    poses = dataset.true_poses if source == "true" else dataset.odometry
    return at_centres(dataset.centres, poses)


def _in_rows(dataset: Dataset) -> dict[str, Pose]:
    middles = [Box.of(submap).center - submap.centre for submap in dataset.submaps]
    widest = max(float(np.ptp(submap.points[:, :2], axis=0).max()) for submap in dataset.submaps)
    columns = ceil(sqrt(len(dataset.submaps)))
    return {
        submap.id: Pose(
            np.array([GAP * widest * (k % columns), -GAP * widest * (k // columns), 0.0]) - middle,
            np.array([0.0, 0.0, 0.0, 1.0]),
        )
        for k, (submap, middle) in enumerate(zip(dataset.submaps, middles, strict=True))
    }


def figures_of(
    submap: Submap, corrected: Pose | None = None, *, positions_only: bool = False
) -> tuple[tuple[str, str], ...]:
    """Measure a submap in rows of a name and a value; against a true pose, its other poses too."""
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
            rows.append((name, _pose_in_words(pose)))
    for name, pose in poses.items():
        if pose is not None and true is not None:
            at = np.zeros(3) if positions_only else submap.centre
            off = np.linalg.norm(np.subtract(*(p.apply(at[None]) for p in (pose, true))))
            rows.append((f"{name} off by", f"{off:.2f} m"))
    return tuple(rows)


def footprint(submap: Submap) -> float:
    """Measure the ground on which a submap has points [m²]."""
    columns, rows = np.floor(submap.points[:, :2] / FOOTPRINT_CELL).astype(np.int64).T
    # One number a cell: sorting rows of two takes ten times as long.
    cells = np.unique(columns * (np.ptp(rows) + 1) + rows)
    return len(cells) * FOOTPRINT_CELL**2


def _pose_in_words(pose: Pose) -> str:
    x, y, z = pose.translation
    return f"{x:z.2f}, {y:z.2f}, {z:z.2f} m; {degrees(pose.planar.yaw):+z.1f}°"


MADE_CELLS = 400_000
"""Of the surfaces of all submaps together; where they overlap, the terrain has fewer."""
SMOOTHED_OVER = 2.5
"""Length-scales of the smoothed grid are this many cells or more, so that no gaps show."""
FIRST_POINTS, FIRST_CELLS = 3000, 40
"""Of a submap's first ground: points, and cells along its longer side."""
FEW, CHANGED_AT_ONCE = 32, 8
"""Grids of a dataset that grows are those of so many submaps, or of a power of two of them; and of
those there were, so many at a time become coarser."""


@dataclass(frozen=True, eq=False)
class Terrain:
    """One submap as the world shows it: a map about its centre, and which cells are shown."""

    gradient_map: GradientMap
    max_std_ratio: float  # cells above it are not shown
    inferred: bool = True  # by a Gaussian process; else it is a smoothed grid


def quick_surface(submap: Submap, params: MapParams, num_submaps: int, *, memo: Memo) -> Terrain:
    """Make the smoothed grid of a submap, coarser the more submaps there are."""
    finest = sqrt(memo(footprint, submap) * num_submaps / MADE_CELLS)
    resolution = min(
        max(params.resolution, round(finest + 0.0005, 3)), 10.0
    )  # [m]; the terrain leaves some cells out of larger grids
    light = replace(
        params,
        resolution=resolution,
        length_scale=max(params.terrain.length_scale, SMOOTHED_OVER * resolution),
        noise_std=0.01,  # [m]: so little that it is masked by where there are points alone
        signal_std=None,
    )
    made = memo(smoothed_map, submap, PipelineParams(map=light))
    return Terrain(_about_centre(made, submap), 0.999, inferred=False)


def first_surface(submap: Submap) -> Terrain:
    """Make a coarse ground of some of a submap's points, a thousandth of a second's work."""
    some = submap.points[:: max(1, len(submap.points) // FIRST_POINTS)]
    thinned = replace(submap, points=some, colors=None, noise_std=None, ranges=None, left_out=None)
    cell = max(float(np.ptp(thinned.corners, axis=0).max()) / FIRST_CELLS, 1e-3)
    light = MapParams(resolution=cell, length_scale=SMOOTHED_OVER * cell, noise_std=0.01)
    made = smoothed_map(thinned, PipelineParams(map=light))
    return Terrain(_about_centre(made, submap), 0.999, inferred=False)


def counts_as_it_grows(num_submaps: int) -> list[int]:
    """The number of submaps that sets each one's grid, as a dataset grows.

    Not of as many as there are: so the grids do not change with each submap that comes. And once
    there are twice as many, they become coarser some at a time.
    """
    count = 1 << (max(num_submaps, FEW) - 1).bit_length()
    before = count // 2 if count > FEW else 0
    changed = CHANGED_AT_ONCE * (num_submaps - before)
    return [before if changed <= place < before else count for place in range(num_submaps)]


def _about_centre(made: GradientMap, submap: Submap, every: int = 1) -> GradientMap:
    """Every so many rows and columns of a submap's map, about its centre."""
    grid, cells = made.grid, (slice(None, None, every), slice(None, None, every))
    elevation = made.elevation[cells] - submap.centre[2]
    (x, y), (x0, y0, _) = grid.origin, submap.centre.tolist()
    return GradientMap(
        Grid((x - x0, y - y0), every * grid.resolution, elevation.shape),
        elevation,
        made.variance[cells] if every == 1 else made.variance[cells].copy(),
        made.slope[cells] if every == 1 else made.slope[cells].copy(),
        made.signal_std,
        made.length_scale,
        made.scale,
    )


def inferred_surface(
    submap: Submap,
    params: PipelineParams,
    memo: Memo,
    num_submaps: int,
    progress: Progress = silent,
) -> Terrain:
    """Infer a submap's gradient map, of many only some cells; a coarse one if the memo has none."""
    made = infer_quick_map(submap, params.map, memo, progress)
    stride = stride_for(made.grid.num_cells, max(1, MADE_CELLS // num_submaps))
    return Terrain(_about_centre(made, submap, stride), params.features.max_std_ratio)


def submap_color(place: int) -> Rgb:
    """A submap's own colour, unlike those of its neighbours along the trajectory."""
    # Hues that go on by the golden section of the circle never come near those just before.
    red, green, blue = colorsys.hls_to_rgb((0.58 + 0.618034 * place) % 1.0, 0.62, 0.5)
    return round(255 * red), round(255 * green), round(255 * blue)
