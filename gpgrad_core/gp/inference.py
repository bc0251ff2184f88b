"""Fits the GP with the exact method that is faster for the cloud."""

import math
from typing import Literal

from jaxtyping import Float

from gpgrad_core.errors import InputError
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.lattice import LatticeSolver
from gpgrad_core.gp.solution import EXACT, Accuracy, Cost, GPProblem, Posterior, Solver
from gpgrad_core.gp.tiles import TileSolver
from gpgrad_core.run import Progress, silent
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
    """
    problem = GPProblem.of(points, kernel, noise_std, mean, accuracy)
    if solver == "auto":
        solver = _faster(problem)
    posterior = SOLVERS[solver].fit(problem, progress)
    return LATTICE.fit(problem, progress) if posterior is None else posterior


def _faster(problem: GPProblem) -> SolverName:
    """Choose the solver that is exact enough and faster; refuse what would cost too much."""
    costs, xy = _costs(problem), problem.cloud.xy
    solver = min(costs, key=lambda name: costs[name].seconds)
    if problem.information > BETTER_BY_TILES and costs["tiles"].seconds <= WORTH_SECONDS:
        solver = "tiles"
    if costs[solver].excess > 1:
        solver = min(costs, key=lambda name: costs[name].excess)
    if costs[solver].excess > 1:
        width, height = xy.max(axis=0) - xy.min(axis=0)
        raise InputError(
            f"the GP of {len(xy):,} points on {width:,.3g} m x {height:,.3g} m with length-scale "
            f"{problem.kernel.length_scale:.4g} m would take {costs[solver]}: {_cure(problem)}"
        )
    return solver


def _costs(problem: GPProblem) -> dict[SolverName, Cost]:
    """Estimate what each solver costs that loses no digits."""
    return {
        name: solver.cost(problem)
        for name, solver in SOLVERS.items()
        if problem.information <= solver.most_information
    }


def _cure(problem: GPProblem) -> str:
    """Advise what to change: the number of points, or the length-scale if that is enough."""
    cloud, kernel = problem.cloud, problem.kernel

    def affordable(every: int, length_scale: float) -> bool:
        changed = SquaredExponential(kernel.signal_std, length_scale)
        some = cloud.select(slice(None, None, every))
        try:
            costs = _costs(GPProblem.over(some, changed, problem.mean, problem.accuracy))
        except InputError:
            return False
        return min(cost.excess for cost in costs.values()) <= 1

    cures: list[str] = []
    longer = [round_up(kernel.length_scale * 1.3**k) for k in range(1, 10)]
    enough = next((value for value in longer if affordable(1, value)), None)
    if enough is not None:
        cures.append(f"raise the length-scale to {enough:g} m or more")
    fewer = [2**k for k in range(1, 12) if 3 * 2**k <= len(cloud)]
    every = next(
        (value for value in fewer if affordable(value, kernel.length_scale)),
        None,
    )
    if every is not None:
        cures.append(f"set max_points to {len(cloud) // every:,} or fewer")
    return ", or ".join([*cures, "map less ground at once"])


def round_up(value: float) -> float:
    """Round up to two digits.

    >>> round_up(0.1234)
    0.13
    """
    digits = 1 - math.floor(math.log10(value))
    return round(math.ceil(value * 10**digits - 1e-9) / 10**digits, max(digits, 0))
