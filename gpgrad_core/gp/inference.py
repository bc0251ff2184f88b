"""Fits the GP with the exact method that is faster for the cloud."""

import math
from typing import Literal

import numpy as np
from jaxtyping import Float

from gpgrad_core.errors import InputError
from gpgrad_core.gp.kernel import SquaredExponential, check_solvable, information
from gpgrad_core.gp.lattice import LatticeSolver
from gpgrad_core.gp.solution import EXACT, Accuracy, Cost, Posterior, Problem, Solver
from gpgrad_core.gp.tiles import TileSolver
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.types import Array

SolverName = Literal["tiles", "lattice"]
LATTICE = LatticeSolver()
SOLVERS: dict[SolverName, Solver] = {"tiles": TileSolver(), "lattice": LATTICE}
BETTER_BY_TILES, WORTH_SECONDS = 1e8, 5.0
"""From this information on tiles are taken if they are estimated to take no longer than that
[s]."""


def fit_gp(
    points: Float[Array, "n 3"],
    kernel: SquaredExponential,
    noise_std: float | Float[Array, "n"],
    *,
    mean: float | None = None,
    solver: SolverName | Literal["auto"] = "auto",
    accuracy: Accuracy = EXACT,
    progress: Progress = silent,
) -> Posterior:
    """Fit the GP of Eq. (1) to points [m], exactly but for the given accuracy.

    The mean height [m] is subtracted before and added after; None takes the points' mean. The time
    of ``lattice`` grows with the area in length-scales, that of ``tiles`` with the number of points
    in a length-scale; ``auto`` takes the one that is estimated to be faster.

    Raises:
        InputError: If the GP would be too large or cannot be solved.
    """
    if solver == "auto":
        solver = _faster(points, kernel, noise_std, accuracy)
    problem = Problem.of(points, kernel, noise_std, mean, accuracy)
    posterior = SOLVERS[solver].fit(problem, progress)
    return LATTICE.fit(problem, progress) if posterior is None else posterior


def _faster(
    points: Float[Array, "n 3"],
    kernel: SquaredExponential,
    noise_std: float | Float[Array, "n"],
    accuracy: Accuracy,
) -> SolverName:
    """Choose the solver that is exact enough and faster; refuse what would cost too much."""
    xy, noise_variance = points[:, :2], np.broadcast_to(np.square(noise_std), len(points))
    bits, costs = _costs(xy, kernel, noise_variance, accuracy)
    solver = min(costs, key=lambda name: costs[name].seconds)
    if bits > BETTER_BY_TILES and costs["tiles"].seconds <= WORTH_SECONDS:
        solver = "tiles"
    if costs[solver].excess > 1:
        solver = min(costs, key=lambda name: costs[name].excess)
    if costs[solver].excess > 1:
        width, height = xy.max(axis=0) - xy.min(axis=0)
        raise InputError(
            f"the GP of {len(xy):,} points on {width:,.3g} m x {height:,.3g} m with length-scale "
            f"{kernel.length_scale:.4g} m would take {costs[solver]}: "
            f"{_cure(xy, kernel, noise_variance, accuracy)}"
        )
    return solver


def _costs(
    xy: Float[Array, "n 2"],
    kernel: SquaredExponential,
    noise_variance: Float[Array, "n"],
    accuracy: Accuracy,
) -> tuple[float, dict[SolverName, Cost]]:
    bits = information(xy, noise_variance, kernel)
    check_solvable(xy, kernel, bits)
    return bits, {
        name: solver.cost(xy, kernel, bits, accuracy)
        for name, solver in SOLVERS.items()
        if bits <= solver.most_information
    }


def _cure(
    xy: Float[Array, "n 2"],
    kernel: SquaredExponential,
    noise_variance: Float[Array, "n"],
    accuracy: Accuracy,
) -> str:
    """Say what to change: the number of points, or the length-scale if that is enough."""

    def affordable(some: slice, length_scale: float) -> bool:
        changed = SquaredExponential(kernel.signal_std, length_scale)
        try:
            _, costs = _costs(xy[some], changed, noise_variance[some], accuracy)
        except InputError:
            return False
        return min(cost.excess for cost in costs.values()) <= 1

    cures: list[str] = []
    longer = [round_up(kernel.length_scale * 1.3**k) for k in range(1, 10)]
    enough = next((value for value in longer if affordable(slice(None), value)), None)
    if enough is not None:
        cures.append(f"raise the length-scale to {enough:g} m or more")
    fewer = [2**k for k in range(1, 12) if 3 * 2**k <= len(xy)]
    every = next(
        (value for value in fewer if affordable(slice(None, None, value), kernel.length_scale)),
        None,
    )
    if every is not None:
        cures.append(f"set max_points to {len(xy) // every:,} or fewer")
    return ", or ".join([*cures, "map less ground at once"])


def round_up(value: float) -> float:
    """Round up to two digits.

    >>> round_up(0.1234)
    0.13
    """
    digits = 1 - math.floor(math.log10(value))
    return round(math.ceil(value * 10**digits - 1e-9) / 10**digits, max(digits, 0))
