"""Two registered maps against each other: the same ground in both, cell by cell."""

from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Bool, Float

from app.viewer.scene.placement import Placement
from app.viewer.session.state import Layer, Role
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.registration import map_agreement
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, Grid

Values: TypeAlias = Float[NDArray[np.float32], "_rows _columns"]
Cells: TypeAlias = Bool[NDArray[np.bool_], "_rows _columns"]


def pixel_motion(T_target_source: SE2, source: Grid, target: Grid) -> Float[Array, "2 3"]:
    """Turn a motion in metres into one from (column, row) of a grid to that of another."""
    turn = T_target_source.rotation
    shift = T_target_source.apply(np.array([source.origin]))[0] - np.asarray(target.origin)
    scale = source.resolution / target.resolution
    return np.column_stack([scale * turn, shift / target.resolution])


def resample(
    values: Values, grid: Grid, onto: Grid, T_grid_onto: SE2, *, beyond: float = np.nan
) -> Values:
    """Interpolate a field at the cells of another grid.

    Args:
        values: On ``grid``; what lies next to a cell that is NaN, or to the rim, becomes NaN.
        grid: Of the values.
        onto: Whose cells are wanted.
        T_grid_onto: Maps the frame of ``onto`` into that of ``grid``.
        beyond: What stands beyond the rim of ``grid``.
    """
    rows, columns = onto.shape
    moved = cv2.warpAffine(
        values,
        pixel_motion(T_grid_onto, onto, grid),
        (columns, rows),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=beyond,
    )
    return np.asarray(moved, dtype=np.float32)


def compare(
    layer: Layer,
    maps: tuple[GradientMap, GradientMap],
    T_database_query: SE2,
    z_offset: float,
    max_std_ratio: float,
) -> tuple[Values, Values]:
    """Compare two registered maps: by the height of the query above the database, or by evidence.

    Args:
        layer: One of `state.COMPARED`.
        maps: Of (query, database).
        T_database_query: The registration.
        z_offset: What is to be added to the query's heights [m].
        max_std_ratio: The variance mask.

    Returns:
        The same values twice: at the query's cells and at the database's. NaN where not both maps
        are trusted.
    """
    if layer == "agreement":
        return _agreement(*maps, T_database_query, max_std_ratio)
    return _height_difference(*maps, T_database_query, z_offset, max_std_ratio)


def _agreement(
    query_map: GradientMap, database_map: GradientMap, T_database_query: SE2, max_std_ratio: float
) -> tuple[Values, Values]:
    grid, shown = map_agreement(query_map, database_map, T_database_query, max_std_ratio)
    return (
        resample(shown, grid, query_map.grid, T_database_query),
        resample(shown, grid, database_map.grid, SE2()),
    )


def _height_difference(
    query_map: GradientMap,
    database_map: GradientMap,
    T_database_query: SE2,
    z_offset: float,
    max_std_ratio: float,
) -> tuple[Values, Values]:
    query, database = (
        np.where(a_map.trusted(max_std_ratio), a_map.elevation, np.nan).astype(np.float32)
        for a_map in (query_map, database_map)
    )
    query += np.float32(z_offset)
    grids = query_map.grid, database_map.grid
    at_query = query - resample(database, grids[1], grids[0], T_database_query)
    at_database = resample(query, grids[0], grids[1], T_database_query.inverse()) - database
    return at_query, at_database


def compared_cells(grid: Grid, placement: Placement, role: Role, swipe_at: float) -> Cells:
    """Say which cells of a registered map a swipe leaves to be seen.

    Args:
        grid: Of the map.
        placement: Where the map stands in the scene.
        role: Whose map it is.
        swipe_at: Where the swipe stands along the scene's x [m]: the query is seen left of
            it, the database right.
    """
    c, s = np.cos(placement.yaw), np.sin(placement.yaw)
    right = (c * grid.x)[None, :] - (s * grid.y)[:, None] + placement.x > swipe_at
    return right if role == "database" else ~right
