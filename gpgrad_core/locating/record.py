"""``located.json``: where submaps lie on an elevation model, and a dataset that shows it."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import index_of
from gpgrad_core.io.records.closures import record_of
from gpgrad_core.io.records.files import replacing
from gpgrad_core.locating.locate import Location, Window, width_of
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.simulation.dem import Elevations
from gpgrad_core.types import Dataset, Submap
from gpgrad_core.version import VERSION

MOST_SHOWN = 2_000_000
"""Largest number of the model's heights in the dataset that shows the places."""


def write_located(
    path: Path,
    places: Sequence[Location],
    *,
    dataset: str,
    model: str,
    system: str,
    num_windows: int,
    params: tuple[PipelineParams, PipelineParams],
) -> None:
    """Write where submaps lie, completely or not at all.

    Args:
        path: The file.
        places: The places.
        dataset: Name of the dataset.
        model: Name of the elevation model.
        system: Coordinate system of the model; empty if it is not known.
        num_windows: Number of windows of the model that were compared with each submap.
        params: Parameters of the submaps and of the windows.
    """
    content = {
        "gpgrad": VERSION,
        "dataset": dataset,
        "map": model,
        "system": system,
        "num_windows": num_windows,
        "parameters": asdict(params[0]),
        "parameters_of_map": asdict(params[1].map),
        "submaps": [_row(place) for place in places],
    }
    with replacing(path) as unfinished:
        text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
        unfinished.write_text(text + "\n", encoding="utf-8", newline="\n")


def _row(place: Location) -> dict[str, object]:
    pair = record_of(place.verdict)
    pose = place.pose
    return {
        "submap": pair.query,
        "accepted": pair.accepted,
        "reason": pair.reason,
        "score": pair.score,
        "runner_up": place.runner_up,
        "T_map_submap": None
        if pose is None
        else dict(zip("xyz", pose.translation.tolist(), strict=True)) | {"yaw": pose.planar.yaw},
        "covariance": pair.covariance,
        "z_std": pair.z_std,
        "num_inliers": pair.num_inliers,
        "overlap_area": pair.overlap_area,
        "scale": pair.scale,
    }


def shown_on_model(
    dataset: Dataset,
    submaps: Sequence[Submap],
    places: Sequence[Location],
    model: Elevations,
    name: str,
    params: tuple[PipelineParams, PipelineParams],
) -> Dataset:
    """Make a dataset of the accepted submaps and of the model around them, at their places.

    The viewer shows it like any other. The model is its last submap.

    Args:
        dataset: Where the submaps come from.
        submaps: The submaps.
        places: The place of each.
        model: The elevation model.
        name: Name of the model.
        params: Parameters of the submaps and of the windows.
    """
    placed = [
        Submap.from_points(submap.points, submap.id, pose_odometry=place.pose, colors=submap.colors,
                           noise_std=submap.noise_std, ranges=submap.ranges)
        for submap, place in zip(submaps, places, strict=True)
        if place.verdict.accepted
    ]  # fmt: skip
    around = max(map(width_of, submaps))
    where = [
        submap.pose_odometry.translation[:2]
        for submap in placed
        if submap.pose_odometry is not None
    ]
    ground = _around(model, np.array(where), around) if where else None
    numbers = [n for n in (index_of(submap.id) for submap in placed) if n is not None]
    if ground is not None:
        title = f"map_{max(numbers, default=0) + 1:03d}"
        middle = ground.middle
        placed.append(
            Submap.from_points(
                ground.load().points, title, pose_odometry=Pose.from_planar(SE2(*middle))
            )
        )
    query_map, model_map = params[0].map, params[1].map
    chosen = {"scale": query_map.scale, "resolution": query_map.resolution} | {
        key: max(getattr(query_map, key), getattr(model_map, key))
        for key in ("length_scale", "noise_std")
    }
    preferred: dict[str, object] = {"map": chosen}
    if ground is not None:
        preferred |= {"query": placed[0].id, "database": placed[-1].id}
    return Dataset(
        f"{dataset.name} on {name}",
        tuple(placed),
        description=f"Submaps of {dataset.name} where they were found on {name}.",
        preferred=preferred,
        licence=dataset.licence,
    )


def _around(model: Elevations, where: Float[Array, "n 2"], margin: float) -> Window:
    """Cut out the model around places (n, 2) [m], every n-th height if there are too many."""
    size = np.array(model.heights.shape[::-1])
    low = np.floor((where.min(axis=0) - margin - model.corner) / model.cell)
    high = np.ceil((where.max(axis=0) + margin - model.corner) / model.cell) + 1
    (left, down), (right, up) = (
        np.clip(corner_cell, 0, size).astype(int) for corner_cell in (low, high)
    )
    heights = model.heights[down:up, left:right]
    every = max(1, int(np.ceil(np.sqrt(heights.size / MOST_SHOWN))))
    heights = heights[::every, ::every]
    cell = (model.cell[0] * every, model.cell[1] * every)
    middle = [
        corner + old * start + 0.5 * new * (count - 1)
        for corner, old, new, start, count in zip(
            model.corner, model.cell, cell, (left, down), heights.shape[::-1], strict=True
        )
    ]
    return Window("around", heights, cell, (float(middle[0]), float(middle[1])))
