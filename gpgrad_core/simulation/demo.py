"""The built-in demo dataset: how it is made, and where it is."""

from dataclasses import replace
from functools import cache
from pathlib import Path

from gpgrad_core.errors import InputError
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.types import Dataset


def demo_params() -> SimulationParams:
    """The parameters with which ``assets/demo`` was simulated."""
    return SimulationParams(
        seed=13,
        num_submaps=10,
        route="winding",
        extent=38.0,
        relief=0.35,
        roughness=0.3,
        crater_density=0.045,
        dune_height=0.1,
        rock_density=2.2,
        camera_height=1.3,
        heading_drift=0.02,
        max_points=25_000,
    )


def loop_params(seed: int = 43) -> SimulationParams:
    """The parameters of the drive of ``gpgrad demo``: round a ring, until it meets itself."""
    return SimulationParams(
        seed=seed,
        num_submaps=24,
        route="loop",
        extent=46.0,
        relief=0.4,
        roughness=0.3,
        crater_density=0.03,
        dune_height=0.1,
        rock_density=0.8,
        camera_height=1.3,
        heading_drift=0.015,
        max_points=20_000,
    )


def simulate_demo() -> Dataset:
    """Simulate the demo dataset.

    ``write_dataset(simulate_demo(), "assets/demo")`` writes the one that is shipped.
    """
    from gpgrad_core.simulation.simulate import simulate_dataset  # noqa: PLC0415 - loads slowly

    return replace(
        simulate_dataset(demo_params()),
        name="demo",
        description=(
            "Synthetic ground with craters, ripples and rocks, seen by a rover's stereo camera. "
            "The rover drove out (000 to 004), turned, and came back in the opposite direction "
            "(005 to 009)."
        ),
        licence="MIT",
        # The same ground, seen out and back, so that the first view shows a loop closure.
        preferred={"query": "007", "database": "001"},
    )


@cache  # a page asks at every change of a slider
def demo_path() -> Path:
    """Find the built-in demo dataset, in an installed package or in a checkout.

    Raises:
        InputError: If neither has it, because the installation is incomplete.
    """
    here = Path(__file__).resolve()
    places = (here.parent / "demo", here.parents[2] / "assets" / "demo")
    for place in places:
        if (place / "submaps").is_dir():
            return place
    raise InputError(f"the built-in demo is in none of {', '.join(map(str, places))}; reinstall")
