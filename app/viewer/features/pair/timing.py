"""Which stage of the pipeline the time went to."""

import time
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from gpgrad_core.detection import fit_submap
from gpgrad_core.detection.coarse import fit_roughly, thin_evenly
from gpgrad_core.detection.stages import STAGES
from gpgrad_core.methods.paper import register_as_printed
from gpgrad_core.run.memo import Memo

P = ParamSpec("P")
R = TypeVar("R")

STAGE_OF: dict[Callable[..., object], str] = {
    **{stage.function: stage.phase for stage in STAGES},
    fit_submap: "fit",
    thin_evenly: "map",
    fit_roughly: "map",
    register_as_printed: "registration",
}
"""The stage that each function belongs to which the pipeline asks its memo for."""


class TimedMemo(Memo):
    """Passes everything on to another memo, and counts the seconds by stage."""

    def __init__(self, memo: Memo) -> None:
        """Begin at zero.

        Args:
            memo: What remembers the results.
        """
        super().__init__(0)
        self._memo = memo
        self.seconds: dict[str, float] = {}

    def holds(self, function: Callable[..., object], *arguments: object) -> bool:
        """Say whether calling with these arguments would compute nothing."""
        return self._memo.holds(function, *arguments)

    def __call__(self, function: Callable[P, R], *arguments: P.args, **unkeyed: P.kwargs) -> R:
        """Return what the other memo returns, and count how long that took."""
        start = time.perf_counter()
        try:
            return self._memo(function, *arguments, **unkeyed)
        finally:
            self.add(STAGE_OF.get(function, "other"), time.perf_counter() - start)

    def lasting(self, function: Callable[P, R], *arguments: P.args, **unkeyed: P.kwargs) -> R:
        """Return what the other memo keeps for later runs too, and count how long that took."""
        start = time.perf_counter()
        try:
            return self._memo.lasting(function, *arguments, **unkeyed)
        finally:
            self.add(STAGE_OF.get(function, "other"), time.perf_counter() - start)

    def keep(self, result: R, function: Callable[..., R], *arguments: object) -> R:
        """Hand the other memo a result that was computed elsewhere, without counting it."""
        return self._memo.keep(result, function, *arguments)

    def add(self, stage: str, seconds: float) -> None:
        """Count seconds that were spent on a stage [s]."""
        self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds
