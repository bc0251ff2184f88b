"""Ways of detecting loop closures: the pipeline and its rivals, one a file, each a `LoopDetector`.

`registry` has them by the names that users give them.
"""

from gpgrad_core.methods.registry import METHODS, Method, find_method

__all__ = ["METHODS", "Method", "find_method"]
