"""Ground that repeats: ripples, furrows, dunes and spurs, each a row beside others like it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.simulation.params import SimulationParams

ROUND = 0.15
"""How rounded the valleys between spurs are [their half width]."""


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
    """Make parameters that suit a kind of ground, with some changed.

    Raises:
        InputError: If there is no such ground, or a value is out of bounds.
    """
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
