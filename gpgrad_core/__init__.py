"""gpgrad_core: loop closures from Gaussian-process gradient maps of bare terrain.

The index of what others may rely on; ``import gpgrad_core as gg``. Lengths are in metres, angles
in radians; data and params are frozen; every verb is a pure function of them.
"""

import sys

import lazy_loader

from gpgrad_core.former import FormerModules

__version__ = "0.2.0"
"""Read by the build too."""

# __init__.pyi has the names. Their modules load at the first use: to load all of them takes longer
# than most commands do.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]
sys.meta_path.append(FormerModules())  # after all others: asked only for what they do not find
