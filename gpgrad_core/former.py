"""Names of version 0.1.0 that changed, and what they say when they are used."""

import functools
import warnings
from collections.abc import Callable
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

MODULES = {
    **dict.fromkeys(("loop_closure", "pipeline", "shortlist"), "detection"),
    **dict.fromkeys(("fitting", "gradient_map"), "mapping"),
    **dict.fromkeys(("datasets", "georeference", "outputs"), "io"),
    "images": "detection.images",
    "scans": "recordings",
}
"""Where in the core the content of a former module is."""


class FormerModules:
    """A finder that finds nothing, and names the present module where a former one is imported."""

    def find_spec(self, fullname: str, *_: object) -> None:
        name = fullname.removeprefix("gpgrad_core.")
        if name != fullname and name in MODULES:
            raise ImportError(
                f"{fullname} is now gpgrad_core.{MODULES[name]}; gpgrad_core has all public names"
            )  # no ModuleNotFoundError, which `from gpgrad_core import name` would not show


def former_parameter(
    old: str, new: str | None = None
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Let a function take a parameter by its former name as well, with a DeprecationWarning.

    Args:
        old: The former name.
        new: The present one; None ignores the value, where nothing depends on it any more.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            if old in kwargs:
                value = kwargs.pop(old)
                if new is not None:
                    kwargs[new] = value
                says = f"is now {new}" if new else "has no effect any more"
                warnings.warn(f"{function.__name__}: {old} {says}", DeprecationWarning, 2)
            return function(*args, **kwargs)

        return call

    return decorate
