"""Small pictures of pairs: both gradient maps in the same window, to be compared at a glance."""

import base64
import threading
from collections import OrderedDict
from collections.abc import Hashable

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from app.viewer.draw.colors import colorize
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap

SIDE = 72
"""Of the picture of one map [pixels]."""
GAP = 4
MOST_KEPT = 400
"""Pictures that are kept; each has about ten kilobytes."""


class Thumbnails:
    """The pictures that were made; those used least recently are dropped."""

    def __init__(self) -> None:
        """Begin without any."""
        self._lock = threading.Lock()
        self._kept: OrderedDict[Hashable, str] = OrderedDict()

    def get(self, key: Hashable) -> str | None:
        """Give a picture as a URI; None if there is none."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def keep(self, key: Hashable, uri: str) -> None:
        """Keep a picture."""
        with self._lock:
            self._kept[key] = uri
            while len(self._kept) > MOST_KEPT:
                self._kept.popitem(last=False)


def thumbnail(
    query: GradientMap, database: GradientMap, T_database_query: SE2 | None, max_std_ratio: float
) -> UInt8[NDArray[np.uint8], "rows columns 4"]:
    """Draw the query's gradient on the left and the database's on the right.

    Args:
        query: Map of the query.
        database: Map of the database submap.
        T_database_query: The motion by which the query is laid beside the database, in a window
            over both; None leaves each in its own.
        max_std_ratio: Of the variance mask; what it rejects stays transparent.
    """
    if T_database_query is None:
        left = _sample(query, _window(_corners(query)), max_std_ratio)
        window = _window(_corners(database))
    else:
        # Over both, so that neither is cut however little they have in common.
        laid = T_database_query.apply(_corners(query))
        window = _window(np.concatenate([laid, _corners(database)]))
        left = _sample(query, T_database_query.inverse().apply(window), max_std_ratio)
    right = _sample(database, window, max_std_ratio)
    known = np.concatenate([left[np.isfinite(left)], right[np.isfinite(right)]])
    high = float(np.quantile(known, 0.98)) if len(known) else 1.0
    picture = np.zeros((SIDE, 2 * SIDE + GAP, 4), np.uint8)
    for values, start in ((left, 0), (right, SIDE + GAP)):
        tile = np.zeros((SIDE * SIDE, 4), np.uint8)
        seen = np.isfinite(values)
        tile[seen, :3] = colorize(values[seen], 0.0, max(high, 1e-9), "magma")
        tile[seen, 3] = 255
        # North is up: the first row of a picture has the highest y.
        picture[:, start : start + SIDE] = tile.reshape(SIDE, SIDE, 4)[::-1]
    return picture


def to_uri(picture: UInt8[NDArray[np.uint8], "rows columns 4"]) -> str:
    """Encode a picture for a page."""
    _, png = cv2.imencode(".png", picture[..., [2, 1, 0, 3]])
    return "data:image/png;base64," + base64.b64encode(png.tobytes()).decode("ascii")


def _corners(gradient_map: GradientMap) -> Float[Array, "4 2"]:
    rows, columns = gradient_map.grid.shape
    x, y = np.meshgrid([0.0, columns - 1.0], [0.0, rows - 1.0])
    return gradient_map.grid.to_position(np.column_stack([x.ravel(), y.ravel()]))


def _window(corners: Float[Array, "k 2"]) -> Float[Array, "n 2"]:
    """Place the pixels over points (n, 2) [m]: rows of rising y, as wide as the longer side."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    steps = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * float((high - low).max())
    x, y = np.meshgrid(*(steps + 0.5 * (low + high)[k] for k in (0, 1)))
    return np.column_stack([x.ravel(), y.ravel()])


def _sample(
    gradient_map: GradientMap, positions: Float[Array, "n 2"], max_std_ratio: float
) -> Float[NDArray[np.float64], "n"]:
    """Read the gradient [m/m] in the nearest cell; NaN outside and where it is not trusted."""
    grid = gradient_map.grid
    columns, rows = np.rint(grid.to_pixel(positions)).T.astype(np.intp)
    inside = (rows >= 0) & (rows < grid.shape[0]) & (columns >= 0) & (columns < grid.shape[1])
    values = np.full(len(positions), np.nan)
    found = gradient_map.gradient[rows[inside], columns[inside]].astype(np.float64)
    trusted = gradient_map.trusted(max_std_ratio)[rows[inside], columns[inside]]
    values[inside] = np.where(trusted, found, np.nan)
    return values
