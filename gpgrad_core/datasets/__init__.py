"""Sources of submaps: cloud files, dataset folders, the simulator and the built-in demo."""

from gpgrad_core.datasets.clouds import load_cloud
from gpgrad_core.datasets.demo import demo_params, demo_path, simulate_demo
from gpgrad_core.datasets.folder import Outline, load_dataset, outline_dataset, write_dataset
from gpgrad_core.datasets.simulate import simulate_dataset
from gpgrad_core.datasets.simulation_params import SimulationParams

__all__ = [
    "Outline",
    "SimulationParams",
    "demo_params",
    "demo_path",
    "load_cloud",
    "load_dataset",
    "outline_dataset",
    "simulate_dataset",
    "simulate_demo",
    "write_dataset",
]
