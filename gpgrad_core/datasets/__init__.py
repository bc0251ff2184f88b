"""Sources of submaps: cloud files, dataset folders, the simulator and the built-in demo."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
