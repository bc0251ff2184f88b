"""The pair: two submaps as surfaces, what joins them, and the verdict.

Other features may draw on its scene, and know nothing else of it.
"""

from app.viewer.pair.scene import PAIR, PairScene

__all__ = ["PAIR", "PairScene"]
