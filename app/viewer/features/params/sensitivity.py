"""Sensitivity: the pair registered at many values of one parameter, and a picture of that."""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby

import msgspec
import numpy as np
import viser

from app.viewer.charts import Axis, grid_line, points_of, svg, text
from app.viewer.features.desk import Desk, Feature
from app.viewer.features.work import Work
from app.viewer.session.methods import METHODS, register_pair
from app.viewer.session.news import SessionState
from app.viewer.session.state import ViewState, same_pair
from app.viewer.widgets.actions import on_choice, on_press
from app.viewer.widgets.bridge import send
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import BAD, FAINT, GOOD, QUIET
from app.viewer.widgets.status import WorkBar
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import score_in_words
from gpgrad_core.params import DECADES_FROM, Field, get_path, parameters_of, with_path, with_unit
from gpgrad_core.run import Progress, part

WIDTH, LEFT, RIGHT = 300.0, 34.0, 10.0
SCORES, BETWEEN, INLIERS, BELOW = 84.0, 30.0, 34.0, 26.0
"""Heights of the scores, of the gap, of the inliers, and of the axis below them."""
LEAST_HIGH = 6.0
"""The axis of the score goes as far at least: twice the default threshold."""


@dataclass(frozen=True)
class Tried:
    """What was found at one value of the parameter."""

    value: float
    score: float
    num_inliers: int
    accepted: bool


def values_of(field: Field, current: float | None) -> tuple[float, ...]:
    """Choose the values to try, over the range of its slider; the present one is among them."""
    bounds = field.bounds
    assert bounds is not None
    low, high = bounds.slider_range
    if current is not None:
        low, high = min(low, current), max(high, current)
    low = max(low, bounds.step) if low == 0 and high > DECADES_FROM * bounds.step else low
    spaced = np.geomspace if low > 0 and high >= DECADES_FROM * low else np.linspace
    chosen = {field.rounded(float(value)) for value in spaced(low, high, 15)}
    return tuple(sorted(chosen | ({current} if current is not None else set())))


def summary(tried: Sequence[Tried], unit: str) -> str:
    """Say in a line where the pair is a loop closure, and where the score is highest."""
    best = max(tried, key=lambda trial: trial.score)
    highest = (
        f"The highest score is {score_in_words(best.score)}, at {best.value:g} {unit}".rstrip()
        + "."
    )
    runs = [
        [trial.value for trial in run]
        for accepted, run in groupby(tried, key=lambda trial: trial.accepted)
        if accepted
    ]
    if not runs:
        return f"No value makes it a loop closure. {highest}"
    if len(runs) == 1 and len(runs[0]) == len(tried):
        return f"It is a loop closure at every value. {highest}"
    parts = " and ".join(
        f"{run[0]:g} to {run[-1]:g}" if len(run) > 1 else f"{run[0]:g}" for run in runs
    )
    return f"It is a loop closure at {parts} {unit}".rstrip() + f". {highest}"


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
            + f": score {score_in_words(trial.score, threshold)}, {trial.num_inliers} inliers, "
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
    """Varies one parameter in the background, and draws what it does to the verdict."""

    def __init__(self, desk: Desk, commands: Commands, main: Mapping[str, str]) -> None:
        """Make the folder in the current container.

        The parameters to choose from are given by their paths, with their names for people.
        """
        self._desk = desk
        self._lock = threading.Lock()
        fields = {field.path: field for field in parameters_of(PipelineParams)}
        self._fields = {name: fields[path] for path, name in main.items()}
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
        on_choice(self._name, lambda _: self._begin_anew())
        self._work: Work[_Sweep, tuple[Tried, ...]] = Work(
            desk.jobs,
            self.work_bar,
            lambda job: f"Sweeping {job.name.lower()}",
            self._register,
            lambda job, tried, _: self._take(job, tried, 0),
            slots=desk.capacity.long,
        )
        desk.bridge.on_message("sweep-value", ValueMsg, self._set)
        commands.add("Parameters", "Sweep the chosen parameter", self.sweep)

    def sweep(self) -> None:
        """Vary the chosen parameter, the others as they are."""
        self._work.start(_Sweep(self._fields[self._name.value], self._name.value, self._desk.state))

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Move the mark of the present value; what is swept for another pair is stopped."""
        was, now = before.view, state.view
        if not same_pair(was, now) or was.method != now.method:
            self._begin_anew()
        elif now.params != was.params:
            self._draw()

    def _register(self, job: _Sweep, progress: Progress) -> tuple[Tried, ...]:
        state, tried = job.state, list[Tried]()
        values = values_of(job.field, _value_of(state.params, job.field))
        for k, value in enumerate(values):
            progress(k / len(values))
            params = with_path(state.given, job.field.path, value)
            share = part(progress, k / len(values), (k + 1) / len(values))
            result = register_pair(*state.pair, params, self._desk.memo, share, method=state.method)
            registration, accepted = result.registration, result.closure.accepted
            tried.append(Tried(value, registration.score, registration.num_inliers, accepted))
            if len(tried) > 1:
                self._take(job, tuple(tried), len(values) - len(tried))
        return tuple(tried)

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


def _value_of(params: PipelineParams, field: Field) -> float | None:
    """Give the value of a parameter; None if it is automatic."""
    value = get_path(params, field.path)
    assert value is None or isinstance(value, float | int)
    return value
