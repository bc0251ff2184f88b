"""Sensitivity: the pair registered at many values of a parameter, and the results.

A strip below each slider shows where the pair is a loop closure. They are computed in the
background, while nothing else is to be done.
"""

import logging
import threading
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from math import sqrt

import numpy as np

from app.viewer.features.desk import Desk, Feature
from app.viewer.server.host import pages
from app.viewer.session.jobs import Lane
from app.viewer.session.methods import METHODS, register_pair
from app.viewer.session.news import SessionState
from app.viewer.session.state import ViewState, same_pair
from app.viewer.widgets.numbers import Strip
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import count, score_in_words
from gpgrad_core.params import Field, get_path, parameters_of, with_path
from gpgrad_core.run import Progress, part
from gpgrad_core.run.memo import Memo

_log = logging.getLogger(__name__)

AT_FIRST = 11
"""Values that are tried over a slider; between two that differ, others are."""
FINE = 0.02
"""The value where the verdict changes is located within this share of the slider."""
IDLE_S = 1.0
"""Pause from the last change to the strips [s]."""
SCRATCH = 60_000_000
"""Bytes of maps and the like to reuse for the next value, apart from those of the pictures."""
MOST_KEPT = 240
"""Parameters of pairs whose trials are remembered; the oldest are forgotten first."""


@dataclass(frozen=True)
class Tried:
    """The result at one value of the parameter."""

    value: float
    score: float
    num_inliers: int
    accepted: bool


def values_of(field: Field, current: float | None) -> tuple[float, ...]:
    """Choose the values to begin with, over the slider; the present one is among them."""
    low, high = _ends(field, current)
    spaced = np.geomspace if _spans_decades(field) else np.linspace
    chosen = {field.rounded(float(value)) for value in spaced(low, high, AT_FIRST)}
    return tuple(sorted(chosen | ({current} if current is not None else set())))


def _spans_decades(field: Field) -> bool:
    return field.bounds is not None and field.bounds.spans_decades


def _ends(field: Field, current: float | None) -> tuple[float, float]:
    """The ends of the slider, extended to a present value beyond them."""
    assert field.bounds is not None
    low, high = field.bounds.slider_range
    return (low, high) if current is None else (min(low, current), max(high, current))


def middle(field: Field, first: float, second: float) -> float:
    """The value midway between two on the slider."""
    return sqrt(first * second) if _spans_decades(field) else (first + second) / 2


def finer(field: Field, tried: Iterable[Tried]) -> float | None:
    """Choose a value where the verdict changes; None if all such places are precise enough."""
    ordered = sorted(tried, key=lambda trial: trial.value)
    at = np.log if _spans_decades(field) else float
    width = at(ordered[-1].value) - at(ordered[0].value)
    for first, second in pairwise(ordered):
        if first.accepted != second.accepted:
            value = field.rounded(middle(field, first.value, second.value))
            is_wide = at(second.value) - at(first.value) > FINE * width
            if is_wide and first.value < value < second.value:
                return value
    return None


def strip_of(field: Field, tried: Sequence[Tried]) -> Strip:
    """Where on a slider the pair is a loop closure; the trials are in order."""
    changes = [
        middle(field, first.value, second.value)
        for first, second in pairwise(tried)
        if first.accepted != second.accepted
    ]
    return Strip(
        (tried[0].value, *changes, tried[-1].value),
        tuple(accepted for accepted, _ in groupby(tried, key=lambda trial: trial.accepted)),
        in_words(field, tried),
    )


def where_accepted(tried: Sequence[Tried], unit: str) -> str:
    """A sentence on the values at which the pair is a loop closure."""
    runs = [
        [trial.value for trial in run]
        for accepted, run in groupby(tried, key=lambda trial: trial.accepted)
        if accepted
    ]
    if not runs:
        return "No value makes it a loop closure."
    if len(runs) == 1 and len(runs[0]) == len(tried):
        return "It is a loop closure at every value."
    parts = " and ".join(
        f"from {run[0]:g} to {run[-1]:g}" if len(run) > 1 else f"at {run[0]:g}" for run in runs
    )
    return f"It is a loop closure {parts} {unit}".rstrip() + "."


def in_words(field: Field, tried: Sequence[Tried]) -> str:
    """Where the pair is a loop closure, where the score is highest, and each trial, in words."""
    unit = "" if field.bounds is None else field.bounds.unit
    best = max(tried, key=lambda trial: trial.score)
    highest = f"The highest score is {score_in_words(best.score)}, at {best.value:g} {unit}"
    each = (
        f"{f'{trial.value:g} {unit}'.rstrip()}: score {score_in_words(trial.score)}, "
        + f"{count(trial.num_inliers, 'inlier')}{'' if trial.accepted else ', no loop closure'}"
        for trial in tried
    )
    lead = f"{where_accepted(tried, unit)} {highest}".rstrip()
    return "\n".join((f"{lead}. Click below the slider to set a value.", *each))


class SensitivityTool(Feature):
    """Varies parameters in the background, and shows what that does to the verdict."""

    def __init__(self, desk: Desk, main: Iterable[str], uuid_of: Callable[[str], str]) -> None:
        """Begin without strips; ``uuid_of`` names the slider of a path for a page."""
        self._desk, self._uuid_of = desk, uuid_of
        self._lock = threading.RLock()
        fields = {field.path: field for field in parameters_of(PipelineParams)}
        # Thresholds first: they take no other registration.
        self._main = {path: fields[path] for path in reversed(tuple(main))}
        self._tried: dict[Hashable, dict[float, Tried]] = {}
        self._strips: dict[str, Strip] = {}  # as they are shown, by path
        self._background: Lane[ViewState, None] = Lane(
            desk.jobs,
            self._make_strips,
            lambda _job, _result, _seconds: None,
            lambda _, error: _log.warning("no strips", exc_info=error),
            rest=IDLE_S,
            slots=desk.capacity.background,
            background=True,
        )
        desk.bridge.hear("sliders", lambda _page, _data: self._rest())

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Show the results of the new state; what is missing waits until a hand rests."""
        is_other = not (
            same_pair(before.view, state.view) and before.view.method == state.view.method
        )
        if is_other:
            self._strips = {}
        changes = (
            (one.mode, one.moving, one.view.resolved, one.view.given) for one in (before, state)
        )
        if is_other or next(changes) != next(changes):
            self._show_strips()
            self._rest()

    def _rest(self) -> None:
        """Stop making strips; begin again once nothing has changed for a while."""
        self._background.cancel()
        now, view = self._desk.now, self._desk.state
        if now.mode == "Tune" and not now.moving and view.is_pair and view.resolved:
            self._background.submit(view)

    def _fields(self, state: ViewState) -> list[Field]:
        unused = METHODS[state.method].unused
        return [field for path, field in self._main.items() if path not in unused]

    def _make_strips(self, state: ViewState, progress: Progress) -> None:
        progress(0.0)
        if not pages(self._desk.host):
            return  # the next one says when it is there
        scratch, fits_each = Memo(SCRATCH), METHODS[state.method].fits_each
        for field in self._fields(state):
            if field.path in self._strips and not self._strips[field.path].stale:
                continue
            # A fit of each submap is not repeated, unless the terrain itself varies.
            memo = self._desk.memo if fits_each and not field.path.startswith("map.") else scratch
            self._register(state, field, progress, memo)
            self._show_strips()
            self._desk.host.flush()

    def _trials(self, state: ViewState, field: Field) -> dict[float, Tried]:
        """The trials of a parameter at a state, whatever its own value is there."""
        assert field.bounds is not None
        others = with_path(state.given, field.path, field.rounded(field.bounds.slider_range[0]))
        pair = tuple(submap.fingerprint for submap in state.pair)
        with self._lock:
            known = self._tried.setdefault((pair, state.method, field.path, others), {})
            while len(self._tried) > MOST_KEPT:
                del self._tried[next(iter(self._tried))]
        return known

    def _register(self, state: ViewState, field: Field, progress: Progress, memo: Memo) -> None:
        known, current = self._trials(state, field), get_path(state.params, field.path)
        assert current is None or isinstance(current, float | int)
        left = [value for value in values_of(field, current) if value not in known]
        k = 0
        while True:
            value = left.pop(0) if left else finer(field, tuple(known.values()))
            if value is None:
                return
            share = part(progress, k / (k + len(left) + 1), (k + 1) / (k + len(left) + 1))
            share(0.0)
            params = with_path(state.given, field.path, value)
            result = register_pair(*state.pair, params, memo, share, method=state.method)
            registration, accepted = result.registration, result.closure.accepted
            known[value] = Tried(value, registration.score, registration.num_inliers, accepted)
            k += 1

    def _show_strips(self) -> None:
        """Show the strips of the present state; where there is none yet, that of before."""
        state, strips = self._desk.state, dict[str, Strip]()
        for field in self._fields(state) if state.is_pair else ():
            known = self._trials(state, field)
            if len(known) >= AT_FIRST and finer(field, tuple(known.values())) is None:
                tried = sorted(known.values(), key=lambda trial: trial.value)
                strips[field.path] = strip_of(field, tried)
            elif field.path in self._strips:
                strips[field.path] = replace(self._strips[field.path], stale=True)
        self._strips = strips
        shown = {self._uuid_of(path): strip for path, strip in strips.items()}
        self._desk.numbers.show_strips(shown)
