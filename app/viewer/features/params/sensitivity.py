"""Sensitivity: the pair registered at many values of a parameter, and what comes of it.

A strip below each slider says where the pair is a loop closure. The strips are made in the
background, while nothing else is to be done; one parameter is drawn as a chart too.
"""

import logging
import threading
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from itertools import groupby, pairwise
from math import sqrt

import msgspec
import numpy as np
import viser

from app.viewer.charts import Axis, grid_line, points_of, svg, text
from app.viewer.features.desk import Desk, Feature
from app.viewer.features.work import Work
from app.viewer.server.host import pages
from app.viewer.session.jobs import Lane
from app.viewer.session.methods import METHODS, register_pair
from app.viewer.session.news import SessionState
from app.viewer.session.state import ViewState, same_pair
from app.viewer.widgets.actions import on_choice, on_press
from app.viewer.widgets.bridge import send
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import BAD, FAINT, GOOD, QUIET
from app.viewer.widgets.numbers import Strip
from app.viewer.widgets.status import WorkBar
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import count, score_in_words
from gpgrad_core.params import Field, get_path, parameters_of, with_path, with_unit
from gpgrad_core.run import Progress, part
from gpgrad_core.run.memo import Memo

_log = logging.getLogger(__name__)

WIDTH, LEFT, RIGHT = 300.0, 34.0, 10.0
SCORES, BETWEEN, INLIERS, BELOW = 84.0, 30.0, 34.0, 26.0
"""Heights of the scores, of the gap, of the inliers, and of the axis below them."""
LEAST_HIGH = 6.0
"""The axis of the score goes as far at least: twice the default threshold."""
AT_FIRST = 11
"""Values that are tried over a slider; between two that differ, others are."""
FINE = 0.02
"""The place where the verdict changes is known within this share of the slider."""
IDLE_S = 1.0
"""Pause after the last change before strips are made [s]."""
SCRATCH = 60_000_000
"""Bytes of maps and the like that are kept for the next value, apart from those of the pictures."""
MOST_KEPT = 240
"""Parameters of pairs whose trials are remembered; the oldest are forgotten first."""


@dataclass(frozen=True)
class Tried:
    """What was found at one value of the parameter."""

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
    """Give the ends of the slider, which the present value may lie beyond."""
    assert field.bounds is not None
    low, high = field.bounds.slider_range
    return (low, high) if current is None else (min(low, current), max(high, current))


def middle(field: Field, first: float, second: float) -> float:
    """Give the value that stands between two on the slider."""
    return sqrt(first * second) if _spans_decades(field) else (first + second) / 2


def finer(field: Field, tried: Iterable[Tried]) -> float | None:
    """Choose a value where the verdict changes; None if all such places are known well enough."""
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
    """Say where on a slider the pair is a loop closure; the trials are in order."""
    changes = [
        middle(field, first.value, second.value)
        for first, second in pairwise(tried)
        if first.accepted != second.accepted
    ]
    words = where_accepted(tried, "" if field.bounds is None else field.bounds.unit)
    return Strip(
        (tried[0].value, *changes, tried[-1].value),
        tuple(accepted for accepted, _ in groupby(tried, key=lambda trial: trial.accepted)),
        words,
    )


def where_accepted(tried: Sequence[Tried], unit: str) -> str:
    """Say in a sentence at which values the pair is a loop closure."""
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


def summary(tried: Sequence[Tried], unit: str) -> str:
    """Say in a line where the pair is a loop closure, and where the score is highest."""
    best = max(tried, key=lambda trial: trial.score)
    highest = f"The highest score is {score_in_words(best.score)}, at {best.value:g} {unit}"
    return f"{where_accepted(tried, unit)} {highest}".rstrip() + "."


def sweep_html(
    field: Field,
    name: str,
    tried: Sequence[Tried],
    *,
    current: float | None,
    threshold: float,
    num_left: int = 0,
    stale: bool = False,
) -> str:
    """Draw score and inliers over the values of a parameter; a click on a value sets it.

    Args:
        field: The parameter.
        name: What people call it.
        tried: What was found, by value; not empty.
        current: Where the slider stands; None if it is not on this axis.
        threshold: The lowest score of a loop closure.
        num_left: Number of values that are still to be tried.
        stale: Whether other parameters, or the pair, have changed since.
    """
    unit = "" if field.bounds is None else field.bounds.unit
    values = [trial.value for trial in tried]
    axis = Axis.over(values, LEFT + 8, WIDTH - RIGHT - 8)
    high = max(LEAST_HIGH, *(trial.score for trial in tried)) * 1.05
    scores = Axis(0.0, high, SCORES + 6, 6.0)
    most = max(1, *(trial.num_inliers for trial in tried))
    top, foot = SCORES + BETWEEN, SCORES + BETWEEN + INLIERS
    across = f"M{LEFT:g} {{:.1f}}H{WIDTH - RIGHT:g}"
    halves = tried[: len(tried) // 2], tried[len(tried) // 2 :]
    room = [min((abs(trial.score - threshold) for trial in half), default=high) for half in halves]
    place, anchor = (LEFT, "start") if room[0] > room[1] else (WIDTH - RIGHT, "end")
    line = points_of((axis(trial.value), scores(trial.score)) for trial in tried)
    drawn = [
        f'<path d="{across.format(scores(threshold))}" stroke="currentColor" '
        'stroke-dasharray="4 3"/>',
        text(place, scores(threshold) - 3, f"threshold {threshold:g}", anchor),
        f'<polyline points="{line}" fill="none" stroke="currentColor" stroke-width="1.2" '
        'opacity=".6"/>',
        *(text(LEFT - 4, scores(score) + 3, f"{score:.0f}", "end") for score in (0, high / 1.05)),
        text(LEFT - 4, top + 9, f"{most}", "end"),
        text(LEFT - 4, foot, "0", "end"),
        text(LEFT, top - 3, "inliers"),
        text(LEFT, 9, "score"),
        grid_line(across.format(foot)),
    ]
    if current is not None:
        drawn.append(
            f'<path data-testid="sweep-now" d="M{axis(current):.1f} 4V{foot:g}" stroke="#1f77c8" '
            'stroke-width="2"/>'
        )
    width = (WIDTH - LEFT - RIGHT) / max(len(tried), 2)
    for trial in tried:
        said = (
            f"{name} {trial.value:g} {unit}".rstrip()
            + f": score {score_in_words(trial.score, threshold)}, "
            + f"{count(trial.num_inliers, 'inlier')}, "
            + ("loop closure" if trial.accepted else "no loop closure")
        )
        x, bar = axis(trial.value), INLIERS * trial.num_inliers / most
        color = GOOD if trial.accepted else BAD
        # Filled or hollow too, for eyes that do not tell the two colours apart.
        look = f'style="fill:{color if trial.accepted else "none"};stroke:{color}"'
        drawn.append(
            f'<g style="cursor:pointer" onclick="{send("sweep-value", value=trial.value)}">'
            f"<title>{escape(said)}. Click to set it.</title>"
            f'<rect x="{x - width / 2:.1f}" y="0" width="{width:.1f}" height="{foot:g}" '
            'fill="transparent"/>'
            f'<circle cx="{x:.1f}" cy="{scores(trial.score):.1f}" r="3.6" stroke-width="1.6" '
            f'{look}/><rect x="{x - 3:.1f}" y="{foot - bar:.1f}" width="6" height="{bar:.1f}" '
            f'style="fill:{color}"/></g>'
        )
    ends = (values[0], values[len(values) // 2], values[-1])
    drawn += [
        text(axis(value), foot + 12, f"{value:g}", anchor)
        for value, anchor in zip(ends, ("start", "middle", "end"), strict=True)
    ]
    label = with_unit(name, field.bounds)
    drawn.append(text((LEFT + WIDTH - RIGHT) / 2, foot + 24, label, "middle"))
    words = summary(tried, unit)
    if num_left:  # what holds at some values need not hold at all
        words = f"{len(tried)} of {len(tried) + num_left} values so far."
    note = "Something else has changed since. Sweep again." if stale else words
    picture = svg(drawn, WIDTH, foot + BELOW, f"Score and inliers over {name}. {words}")
    style = f"font-size:.8em;line-height:1.4;min-height:2.8em;color:{QUIET}"
    dim = f";{FAINT}" if stale else ""
    return (
        f'<div data-testid="sweep" style="padding:.1em .75em{dim}">{picture}'
        f'<div role="status" style="{style}">{escape(note)}</div></div>'
    )


@dataclass(frozen=True, eq=False)
class _Sweep:
    """What is swept: a parameter, at a state."""

    field: Field
    name: str
    state: ViewState


class ValueMsg(msgspec.Struct):
    """A value of the parameter that a page has clicked on."""

    value: float


class SensitivityTool(Feature):
    """Varies parameters in the background, and shows what that does to the verdict."""

    def __init__(
        self,
        desk: Desk,
        commands: Commands,
        main: Mapping[str, str],
        swept: Iterable[str],
        uuid_of: Callable[[str], str],
    ) -> None:
        """Make the folder in the current container.

        Args:
            desk: Of the session.
            commands: Get the command to draw the chart.
            main: Parameters whose sliders have strips, by their paths, with their names for people.
            swept: Those of them that may be drawn as a chart.
            uuid_of: Gives the name by which a page knows the slider of a path.
        """
        self._desk, self._uuid_of = desk, uuid_of
        self._lock = threading.RLock()
        fields = {field.path: field for field in parameters_of(PipelineParams)}
        # Thresholds first: they take no other registration.
        self._main = {path: fields[path] for path in reversed(tuple(main))}
        self._names = main
        self._fields = {main[path]: fields[path] for path in swept}
        self._tried: dict[Hashable, dict[float, Tried]] = {}
        self._strips: dict[str, Strip] = {}  # as they are shown, by path
        self._done: tuple[_Sweep, tuple[Tried, ...]] | None = None
        self._num_left = 0  # values that are still to be tried
        gui = desk.host.gui
        with gui.add_folder("Sensitivity", expand_by_default=False):
            self._name: viser.GuiDropdownHandle[str] = gui.add_dropdown(
                "Of",
                tuple(self._fields),
                initial_value=next(iter(self._fields)),
                hint="The parameter that is varied.",
            )
            sweep = gui.add_button(
                "Sweep",
                hint="Registers this pair at values over the whole slider, and draws score and "
                "inliers. The other parameters stay as they are.",
            )
            self.work_bar = WorkBar(desk.host, "Cancel sweep", "sweep", starts=(sweep,))
            self.picture = gui.add_html("")
        on_press(sweep, self.sweep)
        on_choice(self._name, lambda _: self._choose())
        self._work: Work[_Sweep, tuple[Tried, ...]] = Work(
            desk.jobs,
            self.work_bar,
            lambda job: f"Sweeping {job.name.lower()}",
            lambda job, progress: self._register(job, progress, Memo(SCRATCH), self._take),
            lambda job, tried, _: self._take(job, tried, 0),
            slots=desk.capacity.long,
        )
        self._background: Lane[ViewState, None] = Lane(
            desk.jobs,
            self._make_strips,
            lambda _job, _result, _seconds: None,
            lambda _, error: _log.warning("no strips", exc_info=error),
            rest=IDLE_S,
            slots=desk.capacity.background,
            background=True,
        )
        desk.bridge.on_message("sweep-value", ValueMsg, self._set)
        desk.bridge.hear("sliders", lambda _page, _data: self._rest())
        commands.add("Parameters", "Sweep the chosen parameter", self.sweep)

    def sweep(self) -> None:
        """Vary the chosen parameter, the others as they are."""
        self._work.start(_Sweep(self._fields[self._name.value], self._name.value, self._desk.state))

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Show what is known of the new state; what is missing waits until a hand rests."""
        was, now = before.view, state.view
        if not same_pair(was, now) or was.method != now.method:
            self._strips = {}
            self._begin_anew()
        elif now.params != was.params:
            self._draw()
        changes = (
            (one.mode, one.moving, one.view.resolved, one.view.given) for one in (before, state)
        )
        if not same_pair(was, now) or was.method != now.method or next(changes) != next(changes):
            self._show_strips()
            self._rest()

    def _rest(self) -> None:
        """Stop making strips; begin again once nothing has changed for a while."""
        self._background.cancel()
        now, view = self._desk.now, self._desk.state
        if now.mode == "Tune" and not now.moving and view.is_pair and view.resolved:
            self._background.submit(view)

    def _paths(self, state: ViewState) -> list[str]:
        """List the parameters whose strips are made unasked.

        Where a method fits each submap, another number of the terrain takes seconds of fits.
        """
        method = METHODS[state.method]
        return [
            path
            for path in self._main
            if path not in method.unused and not (method.fits_each and path.startswith("map."))
        ]

    def _make_strips(self, state: ViewState, progress: Progress) -> None:
        progress(0.0)
        if not pages(self._desk.host):
            return  # the next one says when it is there
        memo = self._desk.memo if METHODS[state.method].fits_each else Memo(SCRATCH)
        for path in self._paths(state):
            job = _Sweep(self._main[path], self._names[path], state)
            if path not in self._strips or self._strips[path].stale:
                self._take(job, self._register(job, progress, memo), 0)
                self._show_strips()
                self._desk.host.flush()

    def _trials(self, job: _Sweep) -> dict[float, Tried]:
        """Give what is known of a parameter at a state, whatever its own value is there."""
        state, field = job.state, job.field
        assert field.bounds is not None
        others = with_path(state.given, field.path, field.rounded(field.bounds.slider_range[0]))
        pair = tuple(submap.fingerprint for submap in state.pair)
        with self._lock:
            known = self._tried.setdefault((pair, state.method, field.path, others), {})
            while len(self._tried) > MOST_KEPT:
                del self._tried[next(iter(self._tried))]
        return known

    def _register(
        self,
        job: _Sweep,
        progress: Progress,
        memo: Memo,
        show: Callable[[_Sweep, tuple[Tried, ...], int], None] | None = None,
    ) -> tuple[Tried, ...]:
        """Try values over the slider, and then where the verdict changes."""
        state, field, known = job.state, job.field, self._trials(job)
        left = [
            value
            for value in values_of(field, _value_of(state.params, field))
            if value not in known
        ]
        k = 0
        while True:
            value = left.pop(0) if left else finer(field, tuple(known.values()))
            if value is None:
                return _ordered(known)
            share = part(progress, k / (k + len(left) + 1), (k + 1) / (k + len(left) + 1))
            share(0.0)
            params = with_path(state.given, field.path, value)
            result = register_pair(*state.pair, params, memo, share, method=state.method)
            registration, accepted = result.registration, result.closure.accepted
            known[value] = Tried(value, registration.score, registration.num_inliers, accepted)
            k += 1
            if show is not None and len(known) > 1:
                show(job, _ordered(known), len(left))

    def _show_strips(self) -> None:
        """Show the strips of the present state; of what is not known, those of before."""
        state, strips = self._desk.state, dict[str, Strip]()
        for path in self._paths(state) if state.is_pair else ():
            job = _Sweep(self._main[path], "", state)
            known = self._trials(job)
            if len(known) >= AT_FIRST and finer(job.field, tuple(known.values())) is None:
                strips[path] = strip_of(job.field, _ordered(known))
            elif path in self._strips:
                strips[path] = replace(self._strips[path], stale=True)
        self._strips = strips
        shown = {self._uuid_of(path): strip for path, strip in strips.items()}
        self._desk.numbers.show_strips(shown)

    def _take(self, job: _Sweep, tried: tuple[Tried, ...], num_left: int) -> None:
        with self._lock:
            now = self._desk.state
            if not same_pair(job.state, now) or job.state.method != now.method:
                return
            if job.name != self._name.value:
                return
            self._done, self._num_left = (job, tried), num_left
        self._draw()
        self._desk.host.flush()

    def _draw(self) -> None:
        with self._lock:
            done, num_left = self._done, self._num_left
        if done is None:
            return
        job, tried = done
        now = _value_of(self._desk.state.params, job.field)
        on_axis = now is not None and tried[0].value <= now <= tried[-1].value
        then_given, now_given = (
            with_path(state.given, job.field.path, tried[0].value)
            for state in (job.state, self._desk.state)
        )
        self.picture.content = sweep_html(
            job.field,
            job.name,
            tried,
            current=now if on_axis else None,
            threshold=METHODS[job.state.method].lowest(job.state.params),
            num_left=num_left,
            stale=then_given != now_given,
        )

    def _begin_anew(self) -> None:
        """Stop the sweep that runs, and show none."""
        self._work.cancel()
        with self._lock:
            self._done = None
        self.picture.content = ""

    def _choose(self) -> None:
        """Draw another parameter, if its strip is there."""
        self._begin_anew()
        job = _Sweep(self._fields[self._name.value], self._name.value, self._desk.state)
        if job.field.path in self._strips and not self._strips[job.field.path].stale:
            self._take(job, _ordered(self._trials(job)), 0)

    def _set(self, _page: viser.ClientHandle, said: ValueMsg) -> None:
        with self._lock:
            done = self._done
        if done is None:
            return
        job, tried = done
        for trial in tried:
            if trial.value == said.value:
                self._desk.change(
                    params=with_path(self._desk.state.asked, job.field.path, trial.value)
                )
                return


def _ordered(known: Mapping[float, Tried]) -> tuple[Tried, ...]:
    return tuple(sorted(known.values(), key=lambda trial: trial.value))


def _value_of(params: PipelineParams, field: Field) -> float | None:
    """Give the value of a parameter; None if it is automatic."""
    value = get_path(params, field.path)
    assert value is None or isinstance(value, float | int)
    return value
