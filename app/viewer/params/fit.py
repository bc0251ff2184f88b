"""The Fit button: wires its panel to a runner, and the result to the sliders."""

import threading
from collections.abc import Callable
from dataclasses import replace

from app.viewer.feature import Part
from app.viewer.host import Host
from app.viewer.params.fit_panel import FitPanel
from app.viewer.runner import Runner
from app.viewer.state import ViewState
from gpgrad_core.fitting import FitResult, fit_parameters, fitted_names
from gpgrad_core.gradient_map import MapParams, TerrainParams
from gpgrad_core.params.fields import bounds_of
from gpgrad_core.run.progress import Progress


class Fit(Part):
    """Fits the terrain's parameters to the two submaps that are shown."""

    def __init__(
        self,
        host: Host,
        state: ViewState,
        turns: threading.Semaphore,
        *,
        on_fitted: Callable[[dict[str, float]], None],
        message_of: Callable[[Exception], str],
    ) -> None:
        """Make the panel in the current container.

        Args:
            host: Whose GUI it joins.
            state: The session as it is.
            turns: Of what takes long.
            on_fitted: Given the new values of map parameters, by name.
            message_of: Says what went wrong in one line.
        """
        self._host = host
        self._lock = threading.Lock()
        self._state = state
        self._on_fitted = on_fitted
        self._panel = FitPanel(host, on_fit=self._start, on_cancel=self._cancel)
        self._fitter: Runner[ViewState, FitResult] = Runner(
            self._fit,
            self._on_result,
            lambda state, error: self._panel.stopped(message_of(error), bad=True),  # noqa: ARG005
            on_cancel=lambda state: self._panel.stopped("Cancelled."),  # noqa: ARG005
            turns=turns,
            name="fit",
        )

    def follow(self, state: ViewState) -> None:
        """Follow the session; a fit to submaps that are no longer shown is stopped."""
        with self._lock:
            before, self._state = self._state, state
        if not _same_submaps(before, state):
            self._fitter.cancel()
            self._panel.stopped()

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nothing runs; says whether that came true within the timeout [s]."""
        return self._fitter.wait_idle(timeout)

    def close(self) -> None:
        """Stop."""
        self._fitter.close()

    def _start(self) -> None:
        self._panel.running(0.0)
        self._fitter.submit(self._state)

    def _cancel(self) -> None:
        self._fitter.cancel()

    def _fit(self, state: ViewState, progress: Progress) -> FitResult:
        def report(fraction: float) -> None:
            progress(fraction)
            self._panel.running(fraction)

        # One submap shown twice counts once.
        submaps = tuple({submap.id: submap for submap in (state.query, state.database)}.values())
        return fit_parameters(submaps, state.params.map.terrain, progress=report)

    def _on_result(self, state: ViewState, result: FitResult, seconds: float) -> None:
        if not _same_submaps(state, self._state):
            return  # others are shown since the very last moment
        start = state.params.map.terrain
        found = {name: _value(result.params, name) for name in fitted_names(start)}
        self._panel.show(_headline(result, seconds), _rows(start, found, result))
        self._on_fitted(found)
        self._host.flush()


def with_fitted(params: MapParams, found: dict[str, float]) -> MapParams:
    """Copy the parameters of the map with the fitted values in place."""
    return replace(params, **found)


def _same_submaps(first: ViewState, second: ViewState) -> bool:
    return first.dataset is second.dataset and (
        {first.query_id, first.database_id} == {second.query_id, second.database_id}
    )


def _value(params: TerrainParams, name: str) -> float:
    """Round a fitted value to the digits that its slider shows."""
    bounds = bounds_of(TerrainParams)[name]
    digits = len(f"{bounds.step:f}".rstrip("0").partition(".")[2])
    value = round(float(getattr(params, name)), digits)
    return min(max(value, bounds.low), bounds.high)


def _headline(result: FitResult, seconds: float) -> str:
    submaps = " and ".join(result.submap_ids)
    return f"Fitted to {result.num_points:,} points of {submaps} in {seconds:.1f} s:"


def _rows(
    start: TerrainParams, found: dict[str, float], result: FitResult
) -> tuple[tuple[str, str], ...]:
    rows: list[tuple[str, str]] = []
    for name, value in found.items():
        before = getattr(start, name)
        unit = bounds_of(TerrainParams)[name].unit
        old = "automatic" if before is None else f"{before:g}"
        rows.append((name.replace("_", " "), f"{old} → {value:g} {unit}".rstrip()))
    likelihood = f"{result.log_likelihood_before:.3f} → {result.log_likelihood_after:.3f}"
    return (*rows, ("log likelihood a point", likelihood))
