"""Pages that open from disk and ask no server: a whole dataset, or one pair, in one HTML file."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
