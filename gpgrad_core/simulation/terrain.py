"""The ground of a simulation: relief, rows, craters, ripples and rocks; or an elevation model."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Float
from numpy.random import Generator
from scipy import ndimage

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.io.rasters import read_elevation_model
from gpgrad_core.simulation.params import ROCK_STREAM, TERRAIN_STREAM, SimulationParams, stream

RESOLUTION = 0.03
"""Side of a cell of the terrain [m]; the default voxels of a submap are larger."""
CRATER_DIAMETERS, CRATER_SLOPE = (1.0, 8.0), 1.3
ROCK_DIAMETERS, ROCK_SLOPE = (0.1, 1.2), 1.7
"""Smallest and largest diameter [m], and how fast the number falls with the size."""
HILL_PERSISTENCE = 3.0
"""Hurst exponent of the hills. It is so large that hills are steep without being rough."""
ROUND = 0.15
"""How rounded the valleys between spurs are [their half width]."""
CLEARANCE = 0.7
"""Smallest distance between a rock and the rover's track [m], because the rover drives around
rocks."""


@dataclass(frozen=True, eq=False)
class HeightField:
    """Heights of the ground on a regular grid."""

    elevation: Float[Array, "rows columns"]  # heights (rows, columns) [m]
    origin: tuple[float, float] = (0.0, 0.0)  # position x, y of cell (0, 0) [m]
    resolution: float = RESOLUTION  # side of a cell [m]

    def height(self, xy: Float[Array, "*shape 2"]) -> Float[Array, "*shape"]:
        """Interpolate the height at positions [m]; beyond the edge it is that of the edge."""
        rows_columns = np.moveaxis((xy - self.origin)[..., ::-1] / self.resolution, -1, 0)
        return ndimage.map_coordinates(self.elevation, rows_columns, order=1, mode="nearest")


def _windblown(phase: Array) -> Array:
    """A gentle side to windward and a steep one to leeward, by a shifted second harmonic."""
    return 0.5 * (np.sin(phase) + 0.3 * np.sin(2.0 * phase + 0.5 * np.pi))


def _ploughed(phase: Array) -> Array:
    """Flat beds and flat furrows, with sides between them."""
    return 0.5 * np.tanh(1.5 * np.sin(phase)) / np.tanh(1.5)


def _eroded(phase: Array) -> Array:
    """Round ridges, and narrow valleys between them."""
    return np.sqrt(np.sin(0.5 * phase) ** 2 + ROUND**2) - 0.5


@dataclass(frozen=True)
class Rows:
    """A kind of rows."""

    profile: Callable[[Array], Array]  # height over the phase [rad], from about -1/2 to 1/2
    reach: float  # distance over which the rows change, in spacings
    # values of the simulation's parameters that suit the kind, by name
    defaults: Mapping[str, Any] = field(default_factory=dict[str, Any])


_LONELY = {"crater_density": 0.0, "dune_height": 0.0, "rock_density": 0.0, "route": "serpentine"}
ROWS: dict[str, Rows] = {
    "ripples": Rows(
        _windblown,
        8.0,
        {**_LONELY, "row_spacing": 0.6, "row_height": 0.06, "relief": 0.03, "extent": 70.0},
    ),
    "furrows": Rows(
        _ploughed,
        12.0,
        {**_LONELY, "row_spacing": 1.0, "row_height": 0.15, "row_variety": 0.1, "relief": 0.04,
         "extent": 70.0},
    ),
    "dunes": Rows(
        _windblown,
        5.0,
        {**_LONELY, "row_spacing": 6.0, "row_height": 0.6, "relief": 0.05, "extent": 70.0},
    ),
    "spurs": Rows(
        _eroded,
        4.0,
        {**_LONELY, "row_spacing": 10.0, "row_height": 1.2, "relief": 0.08, "extent": 70.0},
    ),
}  # fmt: skip
"""The kinds of rows, by the name of the ground."""


def params_on(ground: str, **changes: object) -> SimulationParams:
    """Make parameters that suit a kind of ground, with some changed."""
    suited = ROWS[ground].defaults if ground in ROWS else {}
    return SimulationParams(**cast("dict[str, Any]", {**suited, "ground": ground, **changes}))


def row_heights(
    params: SimulationParams,
    x: Float[Array, "columns"],
    y: Float[Array, "rows"],
    first: Float[Array, "rows columns"],
    second: Float[Array, "rows columns"],
) -> Float[Array, "rows columns"]:
    """Compute the heights of rows at columns x and rows y [m].

    The rows are a wave whose complex amplitude varies from place to place,

        a = 1 - v + v (f + i g) / √2,   height = h · tanh(2.5 |a|) · profile(2π s / λ + arg a)

    with the variety v, two smooth random fields f and g of standard deviation 1, and the distance s
    across the rows. At v = 0 all rows are alike. A small v bends them a little and makes some
    higher than others; with a larger one a has zeros, and there a row ends or forks.
    """
    across = np.cos(params.row_heading) * x[None, :] + np.sin(params.row_heading) * y[:, None]
    variety = params.row_variety
    varied = variety * np.sqrt(0.5)
    amplitude = (1.0 - variety + varied * first) + 1j * varied * second
    phase = 2.0 * np.pi * across / params.row_spacing + np.angle(amplitude)
    return params.row_height * np.tanh(2.5 * np.abs(amplitude)) * ROWS[params.ground].profile(phase)


def make_terrain(
    params: SimulationParams, track: Float[Array, "n 2"], rng: Generator
) -> HeightField:
    """Make the ground; large rocks and craters keep away from the track [m]."""
    size = int(np.ceil(params.extent / RESOLUTION)) + 1
    elevation = params.relief * fractal_field(size, 1.5 - params.roughness, rng)
    if params.hill_height > 0:
        hills = fractal_field(size, HILL_PERSISTENCE, rng, largest=params.hill_size)
        elevation += params.hill_height * hills
    _add_ripples(elevation, params, rng)
    if params.ground in ROWS:
        elevation += _rows(size, params, rng)
    _add_craters(elevation, params, track, rng)
    add_rocks(elevation, params, track, rng)
    return HeightField(elevation)


def fractal_field(
    size: int,
    persistence: float,
    rng: Generator,
    largest: float = 16.0,
    resolution: float = RESOLUTION,
) -> Float[Array, "size size"]:
    """Make a fractal by spectral synthesis: white noise with a power-law spectrum.

    The persistence is the Hurst exponent H; the power falls with the wavenumber k as k^-(2H + 2).
    Waves longer than `largest` [m] are weakened, so that the ground is level as a whole and a
    larger extent does not have higher hills. Cells have a side of `resolution` [m]; heights have
    mean 0 and standard deviation 1.
    """
    # The field wraps around, so it is made larger than wanted: its edges would be alike. Multiples
    # of 256 are fast to transform.
    padded = 256 * int(np.ceil((size + 2.0 / resolution) / 256))
    spectrum = np.fft.rfft2(rng.standard_normal((padded, padded)))
    ky = np.fft.fftfreq(padded, resolution)[:, None]
    kx = np.fft.rfftfreq(padded, resolution)[None, :]
    squared = kx**2 + ky**2 + (1.0 / largest) ** 2
    spectrum *= squared ** (-(persistence + 1.0) / 2.0)
    spectrum[0, 0] = 0.0
    field = np.fft.irfft2(spectrum, s=(padded, padded))[:size, :size]
    return (field - field.mean()) / field.std()


def _add_ripples(elevation: Array, params: SimulationParams, rng: Generator) -> None:
    size = len(elevation)
    bend = fractal_field(size, 1.2, rng, largest=10.0)
    patches = fractal_field(size, 1.2, rng, largest=10.0)
    vigour = fractal_field(size, 1.2, rng, largest=5.0)
    wind = Wind.draw(rng)
    along = np.arange(size, dtype=np.float64) * RESOLUTION
    elevation += params.dune_height * wind.ripples(along, along, bend, patches, vigour)


def _rows(size: int, params: SimulationParams, rng: Generator) -> Array:
    largest = ROWS[params.ground].reach * params.row_spacing
    first, second = (fractal_field(size, HILL_PERSISTENCE, rng, largest) for _ in range(2))
    along = np.arange(size, dtype=np.float64) * RESOLUTION
    return row_heights(params, along, along, first, second)


@dataclass(frozen=True)
class Wind:
    """What shapes the ripples."""

    heading: float  # direction across the crests [rad]
    wavelength: float  # distance from crest to crest [m]

    @classmethod
    def draw(cls, rng: Generator) -> "Wind":
        return cls(rng.uniform(0.0, 2.0 * np.pi), rng.uniform(1.3, 1.8))

    def ripples(
        self,
        x: Float[Array, "columns"],
        y: Float[Array, "rows"],
        bend: Float[Array, "rows columns"],
        patches: Float[Array, "rows columns"],
        vigour: Float[Array, "rows columns"],
    ) -> Float[Array, "rows columns"]:
        """Compute patches of ripples along bent crests, gentle to windward, steep to leeward."""
        distance = np.cos(self.heading) * x[None, :] + np.sin(self.heading) * y[:, None]
        phase = 2.0 * np.pi * (distance + 0.9 * bend) / self.wavelength
        cover = np.clip(patches + 0.3, 0.0, 1.0) * np.clip(1.0 + 0.5 * vigour, 0.2, 2.0)
        return cover * _windblown(phase)


def power_law(rng: Generator, count: int, ends: tuple[float, float], slope: float) -> Array:
    """Draw sizes between two ends, so that the share of sizes above d falls as d^-slope."""
    low, high = ends
    uniform = rng.random(count)
    return (low**-slope - uniform * (low**-slope - high**-slope)) ** (-1.0 / slope)


def _window(
    elevation: Array, centre: Array, radius: float
) -> tuple[tuple[slice, slice], Array, Array]:
    """Return the slices of the ground around a centre, and the offsets x and y [m] there."""
    low = np.maximum(np.floor((centre - radius) / RESOLUTION).astype(int), 0)
    high = np.minimum(
        np.ceil((centre + radius) / RESOLUTION).astype(int) + 1, elevation.shape[::-1]
    )
    high = np.maximum(low, high)  # empty if the ground does not reach so far
    x = np.arange(low[0], high[0]) * RESOLUTION - centre[0]
    y = np.arange(low[1], high[1]) * RESOLUTION - centre[1]
    return (slice(low[1], high[1]), slice(low[0], high[0])), x[None, :], y[:, None]


def _distance_to(track: Array, centre: Array) -> float:
    return float(np.sqrt(np.min(np.sum((track - centre) ** 2, axis=1))))


def _add_craters(elevation: Array, params: SimulationParams, track: Array, rng: Generator) -> None:
    count = int(rng.poisson(params.crater_density * params.extent**2))
    # Small craters lie on top of large ones.
    diameters = np.sort(power_law(rng, count, CRATER_DIAMETERS, CRATER_SLOPE))[::-1]
    for diameter in diameters:
        crater = Crater.draw(rng, float(diameter), params.extent)
        if not crater.is_in_the_way(track):
            crater.dig(elevation)


@dataclass(frozen=True, eq=False)
class Crater:
    """A crater."""

    centre: Float[Array, "2"]  # position x, y (2,) [m]
    diameter: float  # diameter of the rim [m]
    freshness: float  # 1 for a new one; old ones are shallow and worn
    wobble: Float[Array, "n"]  # amplitudes of the rim's waves (n,)
    turns: Float[Array, "n"]  # their phases (n,) [rad]

    @classmethod
    def draw(cls, rng: Generator, diameter: float, side: float) -> "Crater":
        centre = rng.uniform(0.0, side, 2)
        freshness = rng.uniform(0.35, 1.0)
        wobble = rng.normal(0.0, 0.05, 4)
        return cls(centre, diameter, freshness, wobble, rng.uniform(0.0, 2.0 * np.pi, 4))

    @property
    def reach(self) -> float:
        """Distance from the centre to where it changes nothing any more [m]."""
        return 1.6 * self.diameter

    def is_in_the_way(self, track: Float[Array, "n 2"]) -> bool:
        """Whether it is large and on a track: the rover would not have driven there."""
        return self.diameter > 2.5 and _distance_to(track, self.centre) < 0.5 * self.diameter

    def dig(self, elevation: Float[Array, "rows columns"]) -> None:
        """Change the ground, whose cell (0, 0) lies at x = y = 0."""
        diameter, freshness = self.diameter, self.freshness
        place, x, y = _window(elevation, self.centre, self.reach)
        angle = np.arctan2(y, x)
        rim = 1.0 + sum(
            self.wobble[k] * np.cos((k + 2) * angle + self.turns[k])
            for k in range(len(self.wobble))
        )
        radius = np.hypot(x, y) / (0.5 * diameter * rim)
        depth, lip = 0.17 * diameter * freshness, 0.05 * diameter * freshness
        bowl = (depth + lip) * radius**2 - depth
        blanket = lip * np.maximum(radius, 1e-3) ** -3.0 * np.clip(3.2 - radius, 0.0, 1.0)
        # The smaller of the two, rounded where they meet, because old rims are worn.
        soft = 0.04 * diameter * (1.15 - freshness)
        elevation[place] += -soft * np.logaddexp(-bowl / soft, -blanket / soft)


def add_rocks(
    elevation: Float[Array, "rows columns"],
    params: SimulationParams,
    track: Float[Array, "n 2"],
    rng: Generator,
) -> None:
    """Lay rocks in fields on the ground, in place; they keep away from the track [m]."""
    count = int(rng.poisson(params.rock_density * params.extent**2))
    crowding = fractal_field(len(elevation), 0.6, rng, largest=8.0)
    diameters = power_law(rng, count, ROCK_DIAMETERS, ROCK_SLOPE)
    for diameter in diameters:
        # A rock lies at the most crowded of three random places, so that rocks form fields.
        places = rng.uniform(0.0, params.extent, (3, 2))
        cells = np.minimum((places / RESOLUTION).astype(int), len(elevation) - 1)
        centre = places[np.argmax(crowding[cells[:, 1], cells[:, 0]])]
        facets = draw_facets(rng, float(diameter))
        if is_clear(track, centre, float(diameter)):
            lay_rock(elevation, elevation, centre, float(diameter), facets)


def is_clear(track: Float[Array, "n 2"], centre: Float[Array, "2"], diameter: float) -> bool:
    """Whether a rock is far enough from a track."""
    return _distance_to(track, centre) >= CLEARANCE + 0.5 * diameter


def lay_rock(
    elevation: Float[Array, "rows columns"],
    ground: Float[Array, "rows columns"],
    centre: Float[Array, "2"],
    diameter: float,
    facets: Float[Array, "facets 3"],
) -> None:
    """Add a rock to an elevation: its planes are facets, its centre and diameter are in metres."""
    place, x, y = _window(elevation, centre, 0.8 * diameter)
    if elevation[place].size == 0:
        return
    rock = np.min([a * x + b * y + c for a, b, c in facets], axis=0)
    base = float(np.median(ground[place]))
    np.maximum(elevation[place], base + rock, out=elevation[place])


def draw_facets(rng: Generator, diameter: float) -> Float[Array, "facets 3"]:
    """Draw the planes z = a x + b y + c of a broken block; its surface is their minimum."""
    num_sides = int(rng.integers(5, 9))
    turn = rng.uniform(0.0, 2.0 * np.pi)
    directions = turn + 2.0 * np.pi * (np.arange(num_sides) + rng.uniform(-0.3, 0.3, num_sides)) / (
        num_sides
    )
    stretch = 1.0 + 0.3 * np.cos(2.0 * (directions - rng.uniform(0.0, np.pi)))
    reaches = 0.5 * diameter * rng.uniform(0.75, 1.05, num_sides) * stretch
    steepness = rng.uniform(0.9, 3.0, num_sides)
    sides = np.column_stack(
        [-steepness * np.cos(directions), -steepness * np.sin(directions), steepness * reaches]
    )
    tilt = rng.normal(0.0, 0.2, 2)
    top = rng.uniform(0.3, 0.65) * diameter
    return np.vstack([sides, [tilt[0], tilt[1], top]])


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


def make_ground(
    params: SimulationParams, track: Float[Array, "n 2"], model: ElevationModel | None
) -> HeightField:
    """Make the ground of a drive along a track [m]; over the elevation model, if there is one."""
    if model is not None:
        return ground_of(model, params, track)
    return make_terrain(params, track, stream(params.seed, TERRAIN_STREAM))


def ground_of(
    model: ElevationModel, params: SimulationParams, track: Float[Array, "n 2"]
) -> HeightField:
    """Make the ground of a simulation from the middle of an elevation model."""
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
