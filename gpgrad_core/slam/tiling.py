"""Points of many submaps, sorted into one file per tile: ground of any size in bounded memory."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.types import Array

Tile = tuple[int, int]
"""Index of a square of ground along x and y."""


@dataclass(frozen=True, eq=False)
class TileStore:
    """Rows of numbers that begin with x and y [m], one file per square tile.

    Attributes:
        folder: Where the files are; the caller removes it.
        side: Side of a tile [m].
        columns: Number of values in a row.
    """

    folder: Path
    side: float
    columns: int

    def add(self, rows: Float[Array, "n columns"]) -> None:
        """Put rows into the tiles that they lie in."""
        tiles = np.floor(rows[:, :2] / self.side).astype(np.int64)
        order = np.lexsort((tiles[:, 0], tiles[:, 1]))
        rows, tiles = rows[order], tiles[order]
        starts = np.flatnonzero(np.r_[True, np.any(np.diff(tiles, axis=0) != 0, axis=1)])
        for start, stop in zip(starts, [*starts[1:], len(rows)], strict=True):
            with self._file((int(tiles[start, 0]), int(tiles[start, 1]))).open("ab") as file:
                file.write(np.ascontiguousarray(rows[start:stop]).tobytes())

    @property
    def tiles(self) -> list[Tile]:
        """The tiles that hold rows, sorted by y and then by x."""
        found = [file.stem.split("_") for file in self.folder.glob("*.rows")]
        return sorted(((int(x), int(y)) for x, y in found), key=lambda tile: (tile[1], tile[0]))

    def read(self, tile: Tile) -> Float[Array, "n columns"]:
        """Read a tile's rows, in the order in which they were added."""
        file = self._file(tile)
        if not file.exists():
            return np.empty((0, self.columns))
        return np.fromfile(file, dtype=np.float64).reshape(-1, self.columns)

    def read_around(self, tile: Tile, margin: float) -> Float[Array, "n columns"]:
        """Read the rows in a tile and within a margin [m] around it.

        The margin must not be larger than a tile's side.
        """
        x, y = tile
        low = np.array([x, y]) * self.side - margin
        high = (np.array([x, y]) + 1) * self.side + margin
        pieces = [
            self.read((x + right, y + above)) for right, above in product((-1, 0, 1), repeat=2)
        ]
        rows = np.concatenate(pieces)
        inside = np.all((rows[:, :2] >= low) & (rows[:, :2] < high), axis=1)
        return rows[inside]

    def neighbourhoods(self) -> Iterator[Tile]:
        """Yield the tiles that hold rows, and all tiles next to them."""
        near = {
            (x + right, y + above)
            for x, y in self.tiles
            for right, above in product((-1, 0, 1), repeat=2)
        }
        yield from sorted(near, key=lambda tile: (tile[1], tile[0]))

    def _file(self, tile: Tile) -> Path:
        return self.folder / f"{tile[0]}_{tile[1]}.rows"
