"""World: all submaps where they lie, with trajectories and loop closures.

Other features may show loops and corrections in it, and look at its scene.
"""

from app.viewer.features.world.scene import SCORE_MAP, Correction, Past, World, WorldScene
from app.viewer.features.world.tab import WorldTab, relaxation

__all__ = [
    "SCORE_MAP",
    "Correction",
    "Past",
    "World",
    "WorldScene",
    "WorldTab",
    "relaxation",
]
