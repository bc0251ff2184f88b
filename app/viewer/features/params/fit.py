"""A button that sets the terrain's parameters to the values that explain the points best."""

from dataclasses import replace
from html import escape

from app.viewer.features.desk import Desk, Feature
from app.viewer.features.work import Work
from app.viewer.session.methods import METHODS
from app.viewer.session.news import SessionState
from app.viewer.session.state import ViewState, same_search
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.html import box, make_solid, table
from app.viewer.widgets.status import WorkBar
from gpgrad_core.mapping.fitting import FitResult, fit_parameters, fitted_names
from gpgrad_core.mapping.gradient_map import TerrainParams
from gpgrad_core.params import AUTOMATIC, fields_of
from gpgrad_core.run import Progress

FIELDS = {field.name: field for field in fields_of(TerrainParams)}


class FitTool(Feature):
    """Fits the terrain's parameters to the two submaps that are shown."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._button = desk.host.gui.add_button(
            "Fit to these submaps",
            hint="Sets length-scale, noise and signal to the values that explain the points of "
            "both submaps best, by maximum marginal likelihood.",
        )
        make_solid(desk.host, self._button)
        self.work_bar = WorkBar(desk.host, "Cancel fit", "fit", starts=(self._button,))
        on_press(self._button, lambda: self._fitter.start(desk.state))
        self._fitter: Work[ViewState, FitResult] = Work(
            desk.jobs,
            self.work_bar,
            lambda _: "Fitting",
            _fit,
            self._on_result,
            slots=desk.capacity.long,
        )

    def on_state(self, before: SessionState, state: SessionState) -> None:
        self._button.visible = not METHODS[state.view.method].fits_each
        if not _same_submaps(before.view, state.view):
            self._fitter.cancel()
            self.work_bar.idle()

    def _on_result(self, state: ViewState, result: FitResult, seconds: float) -> None:
        if not _same_submaps(state, self._desk.state):
            return  # others are shown since the very last moment
        start = state.params.map.terrain
        # To the digits that the sliders show.
        fitted = {
            name: FIELDS[name].rounded(float(getattr(result.params, name)))
            for name in fitted_names(result.params)
        }
        submaps = " and ".join(result.submap_ids)
        headline = f"Fitted to {result.num_points:,} points of {submaps} in {seconds:.1f} s:"
        rows = table(_rows(start, fitted, result))
        self.work_bar.show(box("fit", f"{escape(headline)}{rows}", "font-size:12px"))
        params = self._desk.state.asked
        fitted_map = replace(params.map, noise_model=result.params.noise_model, **fitted)
        self._desk.change(params=replace(params, map=fitted_map))
        self._desk.host.flush()


def _fit(state: ViewState, progress: Progress) -> FitResult:
    # One submap alone counts once.
    submaps = tuple({submap.id: submap for submap in (state.query, state.database)}.values())
    return fit_parameters(
        submaps,
        state.params.map.terrain,
        choose=state.asked.map.chooses_noise,
        progress=progress,
    )


def _same_submaps(first: ViewState, second: ViewState) -> bool:
    return same_search(first, second) and (
        {first.query_id, first.database_id} == {second.query_id, second.database_id}
    )


def _rows(
    start: TerrainParams, fitted: dict[str, float], result: FitResult
) -> tuple[tuple[str, str], ...]:
    rows: list[tuple[str, str]] = []
    for name, value in fitted.items():
        before, bounds = getattr(start, name), FIELDS[name].bounds
        unit = "" if bounds is None else bounds.unit
        old = AUTOMATIC if before is None else f"{before:g}"
        rows.append((name.replace("_", " "), f"{old} → {value:g} {unit}".rstrip()))
    likelihood = f"{result.log_likelihood_before:.3f} → {result.log_likelihood_after:.3f}"
    return (*rows, ("log likelihood per point", likelihood))
