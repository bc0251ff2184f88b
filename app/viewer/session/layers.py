"""The layers of gradient maps, of one and of two against each other: each is one entry of a table.

Its choice in the tab View, its key, its words in flags, files and links, its help, its legend and
what is drawn follow from the entry.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias, cast

import cv2
import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.registration import map_agreement
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, Grid

ColorMap: TypeAlias = Literal[
    "automatic",
    "viridis",
    "cividis",
    "magma",
    "turbo",
    "grey",
    "blue-white-red",
    "red-white-blue",
    "ember",
    "mesa",
    "regolith",
]
Values: TypeAlias = Float[NDArray[np.float32], "_rows _columns"]
Both: TypeAlias = tuple[Values, Values]
"""Values of a comparison, at the query's cells and at the database's."""


@dataclass(frozen=True)
class HeightFrame:
    """The frame of a submap's heights and slopes: turned, tilted and raised."""

    height: float = 0.0  # added to the heights at its middle [m]
    tilt: tuple[float, float] = (0.0, 0.0)  # added to the slopes along x and y [m/m]
    yaw: float = 0.0  # turn of the submap in that frame [rad]
    middle: tuple[float, float] = (0.0, 0.0)  # of the submap (x, y) that it is tilted about [m]

    @property
    def rounded(self) -> "HeightFrame":
        """The same to 5 mm, 2 mm/m and half a degree: colours and light do not tell them apart."""
        along, across = (round(tilt * 500) / 500 for tilt in self.tilt)
        height, yaw = round(self.height * 200) / 200, round(self.yaw * 100) / 100
        return HeightFrame(height, (along, across), yaw, self.middle)

    def height_at(self, x: Float[Array, "..."], y: Float[Array, "..."]) -> Float[Array, "..."]:
        """What is added to the heights at places of the submap [m]."""
        (a, b), (x0, y0) = self.tilt, self.middle
        return self.height + a * (x - x0) + b * (y - y0)


OWN_LEVEL = HeightFrame()
"""Of a submap in its own frame."""


@dataclass(frozen=True)
class LayerStyle:
    """A layer: its words, its default colours, and the field that it shows in its unit."""

    name: str  # in flags, files and links
    words: str  # what people call it
    label: str  # of its legend
    unit: str  # of its values
    color_map: ColorMap  # by default
    # gives the field of one map, in the frame of a level; a layer that compares two has none
    values: Callable[[GradientMap, HeightFrame], Float[Array, "rows columns"]] | None = None
    # gives that of two registered maps, NaN where not both are trusted: of query and database,
    # ``T_database_query``, what is added to the query's heights [m], and the mask
    compare: Callable[[tuple[GradientMap, GradientMap], SE2, float, float], Both] | None = None
    help: str = ""  # a sentence on what its name does not say
    symmetric: bool = False  # whether the ends of its colours are at equal distance from zero
    from_zero: bool = False  # whether they begin at zero
    ends: tuple[float, float] | None = None  # values at the ends, where these are fixed
    is_shaded: bool = False  # whether it is drawn on lit ground

    def of_map(
        self, gradient_map: GradientMap, level: HeightFrame = OWN_LEVEL
    ) -> Float[Array, "rows columns"]:
        """The values of one map alone: NaN if it compares two."""
        if self.values is None:
            return np.full(gradient_map.grid.shape, np.nan)
        return self.values(gradient_map, level)


def _elevation(gradient_map: GradientMap, level: HeightFrame) -> Float[Array, "rows columns"]:
    grid = gradient_map.grid
    if level.tilt == OWN_LEVEL.tilt:
        return gradient_map.elevation + level.height if level.height else gradient_map.elevation
    return gradient_map.elevation + level.height_at(grid.x[None, :], grid.y[:, None])


def _steepness(gradient_map: GradientMap, level: HeightFrame) -> Float[Array, "rows columns"]:
    if level.tilt == OWN_LEVEL.tilt:
        return gradient_map.gradient
    x, y = (gradient_map.slope[..., axis] + level.tilt[axis] for axis in (0, 1))
    return np.sqrt(x * x + y * y)


def _slopes(
    gradient_map: GradientMap, level: HeightFrame
) -> tuple[Float[Array, "rows columns"], Float[Array, "rows columns"]]:
    """The slopes along x and y of the frame of a level [m/m]."""
    x, y = (gradient_map.slope[..., axis] + level.tilt[axis] for axis in (0, 1))
    c, s = np.cos(level.yaw), np.sin(level.yaw)
    return c * x - s * y, s * x + c * y


def pixel_motion(T_target_source: SE2, source: Grid, target: Grid) -> Float[Array, "2 3"]:
    """Turn a motion in metres into one from (column, row) of a grid to that of another."""
    turn = T_target_source.rotation
    shift = T_target_source.apply(np.array([source.origin]))[0] - np.asarray(target.origin)
    scale = source.resolution / target.resolution
    return np.column_stack([scale * turn, shift / target.resolution])


def resample(values: Values, grid: Grid, onto: Grid, T_grid_onto: SE2) -> Values:
    """Interpolate a field at the cells of a grid whose frame is moved; NaN beside NaN or beyond."""
    rows, columns = onto.shape
    moved = cv2.warpAffine(
        values,
        pixel_motion(T_grid_onto, onto, grid),
        (columns, rows),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=np.nan,
    )
    return cast("Values", moved)


def _height_difference(
    maps: tuple[GradientMap, GradientMap],
    T_database_query: SE2,
    z_offset: float,
    max_std_ratio: float,
) -> Both:
    query, database = (
        np.where(a_map.trusted(max_std_ratio), a_map.elevation, np.nan).astype(np.float32)
        for a_map in maps
    )
    query += np.float32(z_offset)
    grids = maps[0].grid, maps[1].grid
    at_query = query - resample(database, grids[1], grids[0], T_database_query)
    at_database = resample(query, grids[0], grids[1], T_database_query.inverse()) - database
    return at_query, at_database


def _agreement(
    maps: tuple[GradientMap, GradientMap],
    T_database_query: SE2,
    z_offset: float,  # noqa: ARG001 - it finds that itself
    max_std_ratio: float,
) -> Both:
    query, database = maps
    grid, shown = map_agreement(query, database, T_database_query, max_std_ratio)
    return (
        resample(shown, grid, query.grid, T_database_query),
        resample(shown, grid, database.grid, SE2()),
    )


LAYERS: dict[str, LayerStyle] = {
    layer.name: layer
    for layer in (
        LayerStyle("elevation", "elevation", "Elevation", "m", "mesa", _elevation, is_shaded=True),
        LayerStyle(
            "std",
            "standard deviation",
            "Standard deviation of the elevation",
            "m",
            "magma",
            lambda gradient_map, _: gradient_map.std,
            from_zero=True,
        ),
        LayerStyle(
            "gradient",
            "gradient",
            "Gradient (steepness)",
            "m/m",
            "ember",
            _steepness,
            from_zero=True,
            is_shaded=True,
        ),
        LayerStyle(
            "slope_x",
            "dz/dx",
            "Slope along x, dz/dx",
            "m/m",
            "blue-white-red",
            lambda gradient_map, level: _slopes(gradient_map, level)[0],
            symmetric=True,
        ),
        LayerStyle(
            "slope_y",
            "dz/dy",
            "Slope along y, dz/dy",
            "m/m",
            "blue-white-red",
            lambda gradient_map, level: _slopes(gradient_map, level)[1],
            symmetric=True,
        ),
        LayerStyle(
            "mask",
            "mask",
            "Variance mask: standard deviation / signal",
            "share",
            "cividis",
            lambda gradient_map, _: gradient_map.std / gradient_map.signal_std,
            ends=(0.0, 1.0),  # the threshold's place on the bar is what the user sets
        ),
        LayerStyle(
            "difference",
            "height difference",
            "Height difference, query minus database",
            "m",
            "blue-white-red",
            compare=_height_difference,
            help="The height difference is query minus database after registration.",
            symmetric=True,
        ),
        LayerStyle(
            "agreement",
            "agreement",
            "Agreement on one terrain",
            "log ratio",
            "red-white-blue",
            compare=_agreement,
            help="Agreement is blue where the heights speak for one terrain, and red where they "
            "speak against it.",
            symmetric=True,
        ),
    )
}
COMPARED = tuple(name for name, layer in LAYERS.items() if layer.compare is not None)
"""Layers that show both maps against each other, under the registration."""

if TYPE_CHECKING:
    Layer: TypeAlias = str
    Locked: TypeAlias = str
else:
    Layer = Literal[tuple(LAYERS)]  # the choices of flags, files, links and the viewer
    Locked = Literal[("none", *LAYERS)]
