"""Sensitivity: wires its panel to a worker that registers the pair at many values."""

import threading
from collections.abc import Mapping
from dataclasses import dataclass

import viser

from app.viewer.feature import Desk, Feature
from app.viewer.methods import METHODS, register_pair
from app.viewer.params.sweep import Tried, sweep_html, values_of
from app.viewer.params.sweep_panel import SweepPanel
from app.viewer.state import ViewState, same_pair
from app.viewer.widgets.bridge import Data
from app.viewer.widgets.commands import Commands
from app.viewer.work import Work
from gpgrad_core.params.fields import Field, get_path, parameters_of, with_path
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.run.progress import Progress, part


@dataclass(frozen=True, eq=False)
class _Sweep:
    """What is swept: a parameter, at a state."""

    field: Field
    name: str
    state: ViewState


class SensitivityTool(Feature):
    """Varies one parameter in the background, and draws what it does to the verdict."""

    def __init__(self, desk: Desk, commands: Commands, main: Mapping[str, str]) -> None:
        """Make the panel in the current container.

        Args:
            desk: Of the session.
            commands: Get "Sweep the chosen parameter".
            main: Paths of the parameters to choose from, and their names for people.
        """
        self._desk = desk
        self._state = desk.state
        self._lock = threading.Lock()
        fields = {field.path: field for field in parameters_of(PipelineParams)}
        self._fields = {name: fields[path] for path, name in main.items()}
        self._done: tuple[_Sweep, tuple[Tried, ...]] | None = None
        self._num_left = 0  # values that are still to be tried
        self._panel = SweepPanel(desk.host, tuple(self._fields), self.sweep, self._begin_anew)
        self._work: Work[_Sweep, tuple[Tried, ...]] = Work(
            self._panel.work_bar,
            lambda job: f"Sweeping {job.name.lower()}",
            self._register,
            lambda job, tried, _: self._take(job, tried, 0),
            slots=desk.capacity.long,
            name="sensitivity",
        )
        self.workers = (self._work,)
        desk.bridge.hear("sweep-value", self._set)
        commands.add("Parameters", "Sweep the chosen parameter", self.sweep)

    def sweep(self) -> None:
        """Vary the chosen parameter, the others as they are."""
        self._work.start(_Sweep(self._fields[self._panel.name], self._panel.name, self._state))

    def follow(self, state: ViewState) -> None:
        """Move the mark of the present value; what is swept for another pair is stopped."""
        before, self._state = self._state, state
        if not same_pair(before, state) or before.method != state.method:
            self._begin_anew()
        elif state.params != before.params:
            self._draw()

    def _register(self, job: _Sweep, progress: Progress) -> tuple[Tried, ...]:
        state, tried = job.state, list[Tried]()
        values = values_of(job.field, _value_of(state.params, job.field))
        for k, value in enumerate(values):
            progress(k / len(values))
            params = with_path(state.given, job.field.path, value)
            share = part(progress, k / len(values), (k + 1) / len(values))
            result = register_pair(*state.pair, params, self._desk.memo, share, method=state.method)
            found = result.registration
            tried.append(Tried(value, found.score, found.num_inliers, result.closure.accepted))
            if len(tried) > 1:
                self._take(job, tuple(tried), len(values) - len(tried))
        return tuple(tried)

    def _take(self, job: _Sweep, tried: tuple[Tried, ...], num_left: int) -> None:
        with self._lock:
            now = self._state
            if not same_pair(job.state, now) or job.state.method != now.method:
                return
            if job.name != self._panel.name:
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
        now = _value_of(self._state.params, job.field)
        on_axis = now is not None and tried[0].value <= now <= tried[-1].value
        then_given, now_given = (
            with_path(state.given, job.field.path, tried[0].value)
            for state in (job.state, self._state)
        )
        self._panel.show(
            sweep_html(
                job.field,
                job.name,
                tried,
                current=now if on_axis else None,
                threshold=METHODS[job.state.method].lowest(job.state.params),
                num_left=num_left,
                stale=then_given != now_given,
            )
        )

    def _begin_anew(self) -> None:
        """Stop the sweep that runs, and show none."""
        self._work.cancel()
        with self._lock:
            self._done = None
        self._panel.show("")

    def _set(self, page: viser.ClientHandle, data: Data) -> None:
        """Set the parameter to a value that a page has clicked on."""
        del page
        with self._lock:
            done = self._done
        if done is None:
            return
        job, tried = done
        for one in tried:
            if one.value == data.get("value"):
                self._desk.change(params=with_path(self._state.asked, job.field.path, one.value))
                return


def _value_of(params: PipelineParams, field: Field) -> float | None:
    """Give the value of a parameter; None if it is automatic."""
    value = get_path(params, field.path)
    assert value is None or isinstance(value, float | int)
    return value
