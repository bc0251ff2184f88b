"""The noise of the points over their distance from the sensor: the model, and what was measured."""

from statistics import median

import numpy as np

from app.viewer.charts import Axis, frame, points_of, svg
from app.viewer.features.desk import Desk, Feature
from app.viewer.features.work import message_of
from app.viewer.session.jobs import Lane
from app.viewer.session.methods import METHODS
from app.viewer.session.news import PairNews, PairShown, SubmapShown
from app.viewer.session.state import ViewState
from app.viewer.widgets.html import QUIET, message_line, paragraph
from gpgrad_core.mapping.gradient_map import TerrainParams
from gpgrad_core.mapping.sensor_noise import NoiseOverRange, noise_over_range
from gpgrad_core.run import Progress
from gpgrad_core.types import Submap

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
