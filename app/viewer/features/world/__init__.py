"""World: all submaps where they lie, with trajectories and loop closures.

Other features may show loops and corrections in it, and look at its scene.
"""

from app.viewer.features.world.model import Correction, World
from app.viewer.features.world.scene import SCORE_MAP, WorldScene
from app.viewer.features.world.tab import WorldTab, relaxation
from app.viewer.features.world.timeline import Timeline

__all__ = [
    "SCORE_MAP",
    "Correction",
    "Timeline",
    "World",
    "WorldScene",
    "WorldTab",
    "relaxation",
]
