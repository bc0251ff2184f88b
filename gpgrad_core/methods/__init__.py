"""Methods of loop-closure detection: the pipeline and the methods it is compared with.

Each method has its own file and is a `LoopDetector`. `registry` lists them by name.
"""

from gpgrad_core.methods.registry import METHODS, Method, find_method

__all__ = ["METHODS", "Method", "find_method"]
