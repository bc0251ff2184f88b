"""Makes synthetic ground without an end: any window of it, alike wherever windows overlap."""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.simulation.params import SimulationParams, stream, stream_at
from gpgrad_core.simulation.terrain import (
    CRATER_DIAMETERS,
    CRATER_SLOPE,
    HILL_PERSISTENCE,
    RESOLUTION,
    ROCK_DIAMETERS,
    ROCK_SLOPE,
    ROWS,
    Crater,
    HeightField,
    Wind,
    draw_facets,
    fractal_field,
    is_clear,
    lay_rock,
    power_law,
    row_heights,
)

SPREAD = 1.6
"""Side of a square of a field, over which it goes over from one patch to the next, at least
[longest waves]."""
LEAST_SQUARE = 29.5
"""Smallest side of such a square [m]; its patches have sizes that are fast to transform."""
FINE, COARSE = 2, 4
"""Side of a cell of a patch [cells of the terrain]: of rough ground, and of smooth fields."""
CRATER_SQUARE, ROCK_SQUARE = 16.0, 8.0
"""Sides of the squares that draw their craters and rocks for themselves [m]."""
CRATER_REACH = 1.6 * CRATER_DIAMETERS[1]
"""Distance at which no crater changes anything any more [m]."""
ROCK_REACH = 0.8 * ROCK_DIAMETERS[1]
CACHE_SIZE = 64
"""Number of patches that a process keeps, because neighbouring windows need the same: 200 MB."""
RELIEF, HILLS, BEND, PATCHES, VIGOUR, CROWDING, CRATERS, ROCKS, WIND, *ROW_FIELDS = range(11)
"""Streams of random numbers."""


@dataclass(frozen=True)
class Fractal:
    """A fractal without an end, of mean 0 and standard deviation 1.

    Each corner of a lattice of squares has a patch of its own, two squares wide. At a position
    between four corners the field is the sum of their patches f with the weights

        w = cos(π u / 2) or sin(π u / 2) along x, times the same along y; u in [0, 1]

    The squares of the weights add up to 1, so the field varies everywhere as much as its patches,
    which are independent.
    """

    seed: int  # seed of the ground
    number: int  # number of the field; another one is independent
    persistence: float  # Hurst exponent
    largest: float  # waves longer than this are weakened [m]
    coarseness: int  # side of a cell of a patch [cells of the terrain]: a power of two up to 32

    @property
    def cell(self) -> float:
        return self.coarseness * RESOLUTION

    @property
    def cells_a_square(self) -> int:
        return int(np.ceil(max(SPREAD * self.largest, LEAST_SQUARE) / self.cell))

    def window(self, low: tuple[int, int], shape: tuple[int, int]) -> Float[Array, "rows columns"]:
        """Compute a window of the field from its first column and row on, which may be negative."""
        n, ratio = self.cells_a_square, self.coarseness
        # The interpolation needs one cell before and two after.
        first = [low[axis] // ratio - 1 for axis in range(2)]
        last = [(low[axis] + shape[1 - axis]) // ratio + 2 for axis in range(2)]
        columns, rows = (np.arange(first[axis], last[axis] + 1) for axis in range(2))
        total = np.zeros((len(rows), len(columns)))
        for i in range(columns[0] // n, columns[-1] // n + 2):
            for j in range(rows[0] // n, rows[-1] // n + 2):
                # The patch of corner i covers the squares i - 1 and i.
                in_x, in_y = columns - (i - 1) * n, rows - (j - 1) * n
                x = np.flatnonzero((in_x >= 0) & (in_x < 2 * n))
                y = np.flatnonzero((in_y >= 0) & (in_y < 2 * n))
                if len(x) == 0 or len(y) == 0:
                    continue
                patch = _patch(self, i, j)[np.ix_(in_y[y], in_x[x])]
                weight_y, weight_x = (
                    np.sin(np.pi * cells / (2 * n)) for cells in (in_y[y], in_x[x])
                )
                total[y[0] : y[-1] + 1, x[0] : x[-1] + 1] += (
                    patch * weight_y[:, None] * weight_x[None, :]
                )
        import cv2  # noqa: PLC0415 - loads slowly, and only this ground needs it

        # From cells of the patches to cells of the terrain.
        places = [
            ((low[axis] + np.arange(shape[1 - axis])) / ratio - first[axis]).astype(np.float32)
            for axis in range(2)
        ]
        x, y = np.meshgrid(*places)
        heights = cv2.remap(total, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(heights, dtype=np.float64)


@lru_cache(maxsize=CACHE_SIZE)
def _patch(of: Fractal, i: int, j: int) -> Float[Array, "size size"]:
    size = 2 * of.cells_a_square
    rng = stream_at(of.seed, of.number, i, j)
    return fractal_field(size, of.persistence, rng, of.largest, of.cell)


@dataclass(frozen=True, eq=False)
class EndlessGround:
    """Ground on which a rover can drive as far as it likes."""

    params: SimulationParams  # what lies on the ground; the extent is not used
    # where the rover drives (n, 2) [m]; large rocks and craters keep away from it
    track: Float[Array, "n 2"]
    wind: Wind = field(init=False)  # what shapes the ripples

    def __post_init__(self) -> None:
        object.__setattr__(self, "wind", Wind.draw(stream(self.params.seed, WIND)))

    def window(self, low: Float[Array, "2"], high: Float[Array, "2"]) -> HeightField:
        """Make the ground within a box [m]."""
        # Rocks on the edge lie on ground that is outside.
        margin = int(np.ceil(ROCK_REACH / RESOLUTION)) + 1
        first = np.floor(low / RESOLUTION).astype(int) - margin
        last = np.ceil(high / RESOLUTION).astype(int) + 1 + margin
        corner, shape = (
            (int(first[0]), int(first[1])),
            (int(last[1] - first[1]), int(last[0] - first[0])),
        )
        origin, end = first * RESOLUTION, last * RESOLUTION
        elevation = self._smooth_ground(corner, shape)
        for crater in self._craters(origin, end):
            crater.dig(elevation)
        self._lay_rocks(elevation, corner)
        inner = slice(margin, -margin)
        start = (first + margin) * RESOLUTION
        return HeightField(elevation[inner, inner].copy(), (float(start[0]), float(start[1])))

    def _smooth_ground(self, low: tuple[int, int], shape: tuple[int, int]) -> Array:
        params = self.params
        relief = self._field(RELIEF, 1.5 - params.roughness, 16.0, FINE)
        elevation = params.relief * relief.window(low, shape)
        if params.hill_height > 0:
            hills = self._smooth_field(HILLS, params.hill_size)
            elevation += params.hill_height * hills.window(low, shape)
        x, y = (
            np.arange(low[axis], low[axis] + shape[1 - axis], dtype=np.float64) * RESOLUTION
            for axis in range(2)
        )
        if params.ground in ROWS:
            largest = ROWS[params.ground].reach * params.row_spacing
            first, second = (
                self._smooth_field(number, largest).window(low, shape) for number in ROW_FIELDS
            )
            elevation += row_heights(params, x, y, first, second)
        if params.dune_height > 0:
            fields = [
                self._field(number, 1.2, largest, COARSE).window(low, shape)
                for number, largest in ((BEND, 10.0), (PATCHES, 10.0), (VIGOUR, 5.0))
            ]
            elevation += params.dune_height * self.wind.ripples(x, y, *fields)
        return elevation

    def _smooth_field(self, number: int, largest: float) -> Fractal:
        # OpenCV interpolates at multiples of 1/32 of a cell: powers of two are exact.
        coarse = 2 ** int(np.clip(np.log2(largest / 64 / RESOLUTION), 2, 5))
        return self._field(number, HILL_PERSISTENCE, largest, coarse)

    def _field(self, number: int, persistence: float, largest: float, coarseness: int) -> Fractal:
        return Fractal(self.params.seed, number, persistence, largest, coarseness)

    def _near(self, low: Float[Array, "2"], high: Float[Array, "2"]) -> Float[Array, "m 2"]:
        """Select the part of the track that is within reach of a box."""
        inside = ((self.track >= low - CRATER_REACH) & (self.track <= high + CRATER_REACH)).all(1)
        far = np.full((1, 2), 1e9)  # so that there is always something to measure to
        return np.vstack([self.track[inside], far])

    def _craters(self, low: Float[Array, "2"], high: Float[Array, "2"]) -> list[Crater]:
        params, craters = self.params, list[Crater]()
        track = self._near(low, high)
        for i, j in _squares(low - CRATER_REACH, high + CRATER_REACH, CRATER_SQUARE):
            rng = stream_at(params.seed, CRATERS, i, j)
            count = int(rng.poisson(params.crater_density * CRATER_SQUARE**2))
            at = CRATER_SQUARE * np.array([i, j])
            for diameter in power_law(rng, count, CRATER_DIAMETERS, CRATER_SLOPE):
                drawn = Crater.draw(rng, float(diameter), CRATER_SQUARE)
                if not drawn.is_in_the_way(track - at):
                    shape = drawn.freshness, drawn.wobble, drawn.turns
                    craters.append(Crater(drawn.centre + at - low, drawn.diameter, *shape))
        return sorted(craters, key=lambda crater: -crater.diameter)

    def _lay_rocks(self, elevation: Float[Array, "rows columns"], low: tuple[int, int]) -> None:
        """Lay the rocks of a window. They lie on the ground, not on each other."""
        params = self.params
        if params.rock_density == 0:
            return
        origin = np.array(low) * RESOLUTION
        end = origin + np.array(elevation.shape[::-1]) * RESOLUTION
        squares = _squares(origin - ROCK_REACH, end + ROCK_REACH, ROCK_SQUARE)
        # A rock lies at the most crowded of three places in its square.
        per_square = round(ROCK_SQUARE / RESOLUTION)
        first = np.min(squares, axis=0)
        count = np.max(squares, axis=0) - first + 1
        corner = np.round(first * ROCK_SQUARE / RESOLUTION).astype(int)
        crowding = self._field(CROWDING, 0.6, 8.0, COARSE).window(
            (int(corner[0]), int(corner[1])),
            (int(count[1] * per_square) + 1, int(count[0] * per_square) + 1),
        )
        track, ground = self._near(origin, end), elevation.copy()
        for i, j in squares:
            rng = stream_at(params.seed, ROCKS, i, j)
            at = ROCK_SQUARE * np.array([i, j])
            number = int(rng.poisson(params.rock_density * ROCK_SQUARE**2))
            for diameter in power_law(rng, number, ROCK_DIAMETERS, ROCK_SLOPE):
                places = at + rng.uniform(0.0, ROCK_SQUARE, (3, 2))
                column, row = np.round(places / RESOLUTION).astype(int).T
                centre = places[np.argmax(crowding[row - corner[1], column - corner[0]])]
                facets = draw_facets(rng, float(diameter))
                outside = (centre < origin - ROCK_REACH) | (centre > end + ROCK_REACH)
                if not outside.any() and is_clear(track, centre, float(diameter)):
                    lay_rock(elevation, ground, centre - origin, float(diameter), facets)


def _squares(low: Float[Array, "2"], high: Float[Array, "2"], side: float) -> list[tuple[int, int]]:
    (left, bottom), (right, top) = (np.floor(end / side).astype(int) for end in (low, high))
    return [(i, j) for i in range(left, right + 1) for j in range(bottom, top + 1)]
