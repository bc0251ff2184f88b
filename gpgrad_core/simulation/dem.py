"""A digital elevation model as the ground of a simulation."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.io.rasters import read_elevation_model
from gpgrad_core.simulation.params import ROCK_STREAM, SimulationParams, stream
from gpgrad_core.simulation.terrain import RESOLUTION, HeightField, add_rocks


@dataclass(frozen=True)
class ElevationModel:
    """Which elevation model is the ground of a simulation."""

    path: Path  # the GeoTIFF
    # how many metres of the simulation a metre of the model becomes, in all directions
    scale: float = 1.0
    exaggeration: float = 1.0  # factor of the heights, after the scale

    def __post_init__(self) -> None:
        for name, value in (("scale", self.scale), ("exaggeration", self.exaggeration)):
            if not 1e-4 <= value <= 1e4:
                raise InputError(f"the terrain's {name} must be from 0.0001 to 10,000, got {value}")


def ground_of(
    model: ElevationModel, params: SimulationParams, track: Float[Array, "n 2"]
) -> HeightField:
    """Make the ground of a simulation from the middle of an elevation model.

    Between the model's cells, heights are those of a cubic spline. Only rocks are laid on it, away
    from the track [m]; what the parameters say of relief, hills, ripples and craters is not used.
    """
    if params.ground != "varied":
        raise InputError(
            f"{model.path}: the ground {params.ground!r} is made, and cannot be laid on an "
            "elevation model; leave out one of the two"
        )
    read = read_elevation_model(model.path)
    heights, (width, height) = read.heights, read.cell
    step = np.array([height, width]) * model.scale  # of a cell, along rows and columns [m]
    sides = (np.array(heights.shape) - 1) * step
    if sides.min() < params.extent:
        raise InputError(
            f"{model.path}: covers {sides[1]:.4g} m x {sides[0]:.4g} m at the scale "
            f"{model.scale:g}, but the ground has a side of {params.extent:g} m; lower --extent or "
            "raise --terrain-scale"
        )
    size = int(np.ceil(params.extent / RESOLUTION)) + 1
    # The middle of the ground is that of the model.
    along = RESOLUTION * (np.arange(size) - 0.5 * (size - 1))
    row, column = (
        0.5 * (n - 1) + along / step_along
        for n, step_along in zip(heights.shape, step, strict=True)
    )
    low = [max(int(np.floor(cells[0])) - 8, 0) for cells in (row, column)]
    high = [int(np.ceil(cells[-1])) + 9 for cells in (row, column)]
    window = heights[low[0] : high[0], low[1] : high[1]].astype(np.float64)
    unknown = int(np.sum(~np.isfinite(window)))
    if unknown:
        raise InputError(
            f"{model.path}: has no height at {unknown:,} of the {window.size:,} cells in its "
            "middle; fill them, or crop it so that its middle is whole"
        )
    places = np.meshgrid(row - low[0], column - low[1], indexing="ij")
    elevation = ndimage.map_coordinates(window, places, order=3, mode="nearest")
    elevation = (elevation - np.median(elevation)) * model.scale * model.exaggeration
    add_rocks(elevation, params, track, stream(params.seed, ROCK_STREAM))
    return HeightField(elevation)
