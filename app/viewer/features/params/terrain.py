"""The tools of the terrain: a fit to the points that are shown, and their noise over the range."""

from dataclasses import replace
from html import escape
from statistics import median

import numpy as np

from app.viewer.charts import Axis, frame, points_of, svg
from app.viewer.features.desk import Desk, Feature
from app.viewer.features.work import Work, message_of
from app.viewer.session.jobs import Lane
from app.viewer.session.methods import METHODS
from app.viewer.session.news import PairNews, PairShown, SessionState, SubmapShown
from app.viewer.session.state import ViewState, same_search
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.html import QUIET, box, make_solid, message_line, paragraph, table
from app.viewer.widgets.status import WorkBar
from gpgrad_core.mapping.fitting import FitResult, fit_parameters, fitted_names
from gpgrad_core.mapping.gradient_map import TerrainParams
from gpgrad_core.mapping.sensor_noise import NoiseOverRange, noise_over_range
from gpgrad_core.params import AUTOMATIC, fields_of
from gpgrad_core.run import Progress
from gpgrad_core.types import Submap

FIELDS = {field.name: field for field in fields_of(TerrainParams)}
_Job = tuple[tuple[Submap, ...], TerrainParams]
WIDTH, LEFT, RIGHT, HEIGHT, BELOW = 300.0, 44.0, 10.0, 110.0, 30.0
REST = 0.5
"""Pause after which the chart is drawn [s]: the picture of the pair comes first."""
STEPS = 24
"""Number of places on the curve; each is the median of the points there."""
HIGHEST = 0.97
"""Share of the measured noise that the chart has room for; the rest lies at its upper edge."""
NOTHING = "Nothing to show: the terrain of this method is not fitted, or differs by submap."
MODELS = {
    "constant": "the same noise at every range",
    "range": "noise that grows with the range",
    "measured": "noise measured from the points around",
    "file": "noise given by the cloud",
}


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


class NoiseTool(Feature):
    """Draws the noise of the submaps that are shown, as a curve with the measured scatter."""

    def __init__(self, desk: Desk) -> None:
        self._host = desk.host
        self._requested: _Job | None = None
        with desk.host.gui.add_folder("Noise over range", expand_by_default=False):
            self._chart = desk.host.gui.add_html(paragraph("Shown with the next map."))
        self._runner: Lane[_Job, NoiseOverRange] = Lane(
            desk.jobs,
            _measure,
            self._on_result,
            self._on_error,
            rest=REST,
            slots=desk.capacity.long,
        )

    def on_pair_result(self, news: PairNews) -> None:
        if isinstance(news, PairShown):
            self._ask(news.state, news.state.pair)
        elif isinstance(news, SubmapShown):
            self._ask(news.state, (news.state.query,))

    def _ask(self, state: ViewState, submaps: tuple[Submap, ...]) -> None:
        if METHODS[state.method].fits_each or not state.params.map.has_numbers:
            self._requested = None
            self._chart.content = paragraph(NOTHING)
            return
        job = submaps, state.params.map.terrain
        if job != self._requested:
            self._requested = job
            self._runner.submit(job)

    def _on_result(self, job: _Job, found: NoiseOverRange, seconds: float) -> None:
        del seconds
        if job == self._requested:
            self._chart.content = noise_html(found, job[1])
            self._host.flush()

    def _on_error(self, job: _Job, error: Exception) -> None:
        if job == self._requested:
            self._chart.content = message_line("noise-error", message_of(error), QUIET)
            self._host.flush()


def _measure(job: _Job, progress: Progress) -> NoiseOverRange:
    submaps, params = job
    each: list[NoiseOverRange] = []
    for k, submap in enumerate(submaps):
        progress(k / len(submaps))
        each.append(noise_over_range(submap, params))
    order = np.argsort(np.concatenate([one.ranges for one in each]))
    names = ("ranges", "modelled", "measured")
    joined = (np.concatenate([getattr(one, name) for one in each])[order] for name in names)
    return NoiseOverRange(*joined)


def noise_html(found: NoiseOverRange, params: TerrainParams) -> str:
    """Draw the noise over the range, as measured and as modelled; without ranges, in words."""
    words = f"The model: {MODELS[params.noise_model]}."
    if not np.isfinite(found.ranges).all():
        low, measured, high = 100 * np.quantile(found.measured, (0.1, 0.5, 0.9))
        return paragraph(
            f"{words} It says {100 * median(found.modelled):.2g} cm, and neighbouring points "
            f"scatter by {measured:.2g} cm ({low:.2g} to {high:.2g} cm in most places). A chart "
            "over the range needs clouds that give the range of each point."
        )
    high = 1.2 * max(float(np.quantile(found.measured, HIGHEST)), float(found.modelled.max()))
    across = Axis(0.0, float(found.ranges[-1]), LEFT, WIDTH - RIGHT)
    up = Axis(0.0, 100 * high, HEIGHT, 8.0)
    places = zip(across.places(found.ranges), up.places(100 * found.measured), strict=True)
    dots = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in places)
    parts = np.array_split(np.arange(len(found.ranges)), min(STEPS, len(found.ranges)))
    curve = [
        (across(median(found.ranges[part])), up(100 * median(found.modelled[part])))
        for part in parts
    ]
    if params.noise_model in ("constant", "range"):  # defined at every range
        ranges = np.linspace(0.0, float(found.ranges[-1]), STEPS)
        growth = params.noise_growth if params.noise_model == "range" else 0.0
        heights = up.places(100 * (params.noise_std + growth * ranges**2))
        curve = list(zip(across.places(ranges), heights, strict=True))
    drawn = (
        frame(across, up, "range [m]", "noise [cm]"),
        f'<path data-testid="noise-measured" d="{dots}" stroke="currentColor" stroke-width="2.6" '
        'stroke-linecap="round" stroke-opacity=".35"/>',
        f'<polyline data-testid="noise-model" points="{points_of(curve)}" fill="none" '
        'stroke="#1f77c8" stroke-width="2"/>',
    )
    picture = svg(drawn, WIDTH, HEIGHT + BELOW, f"Noise over range. {words}")
    note = f"{words} Dots: the scatter of neighbouring points."
    words = paragraph(note, f"padding:0;font-size:.8em;line-height:1.4;color:{QUIET}")
    return f'<div data-testid="noise" style="padding:.1em .75em">{picture}{words}</div>'
