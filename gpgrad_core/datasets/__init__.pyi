from .clouds import load_cloud
from .dem import ElevationModel
from .demo import demo_params, demo_path, simulate_demo
from .folder import (
    Outline,
    SubmapFile,
    check_vacant,
    load_dataset,
    open_dataset,
    outline_dataset,
    write_dataset,
)
from .simulate import simulate_dataset, simulate_into
from .simulation_params import SimulationParams

__all__ = [
    "ElevationModel",
    "Outline",
    "SimulationParams",
    "SubmapFile",
    "check_vacant",
    "demo_params",
    "demo_path",
    "load_cloud",
    "load_dataset",
    "open_dataset",
    "outline_dataset",
    "simulate_dataset",
    "simulate_demo",
    "simulate_into",
    "write_dataset",
]
