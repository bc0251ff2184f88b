import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace

import pytest
import viser

from app.viewer.params import fit as fit_module
from app.viewer.params.fit import FitTool, with_fitted
from app.viewer.state import open_dataset, with_pair
from gpgrad_core.errors import InputError
from gpgrad_core.fitting import FitResult, fit_parameters
from gpgrad_core.gradient_map import MapParams, TerrainParams
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.run.progress import Progress
from gpgrad_core.types import Submap
from tests.app.desk import Recorder, make_desk
from tests.app.synthetic import make_dataset
from tests.app.widgets import find, user_presses

STATE = open_dataset(make_dataset(), PipelineParams())


class Fitter:
    """Stands in for `fit_parameters`: an answer by hand, when it is let go."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.go.set()
        self.error: Exception | None = None
        self.calls: list[tuple[str, ...]] = []

    def __call__(
        self, submaps: Sequence[Submap], start: TerrainParams, *, progress: Progress
    ) -> FitResult:
        ids = tuple(submap.id for submap in submaps)
        self.calls.append(ids)
        progress(0.25)
        while not self.go.wait(0.005):
            progress(0.5)
        if self.error is not None:
            raise self.error
        found = replace(start, length_scale=0.4123, noise_std=0.0307, signal_std=0.3)
        return FitResult(found, -0.25, 0.5, 4096, 11, ids)


@pytest.fixture
def fitter(monkeypatch: pytest.MonkeyPatch) -> Fitter:
    fake = Fitter()
    monkeypatch.setattr(fit_module, "fit_parameters", fake)
    return fake


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


@pytest.fixture
def fit(
    server: viser.ViserServer,
    fitter: Fitter,  # noqa: ARG001
    recorder: Recorder,
) -> Iterator[FitTool]:
    made = FitTool(make_desk(server, STATE, recorder))
    yield made
    made.close()


def run(fit: FitTool, server: viser.ViserServer) -> None:
    user_presses(find(server, "Fit to these submaps"))
    assert fit.wait_idle(120)


def said(fit: FitTool) -> str:
    return fit._panel.work_bar.said


def test_the_result_is_handed_on_and_told_before_and_after(
    fit: FitTool, server: viser.ViserServer, fitter: Fitter, recorder: Recorder
) -> None:
    run(fit, server)
    assert fitter.calls == [("003", "000")]
    # To the digits that the sliders show.
    found = {"length_scale": 0.412, "signal_std": 0.3, "noise_std": 0.0307}
    (state,) = recorder.states
    assert state.params == replace(STATE.params, map=with_fitted(STATE.params.map, found))
    for words in (
        "4,096 points of 003 and 000",
        "0.3 → 0.412 m",
        "0.05 → 0.0307 m",
        "automatic → 0.3 m",
        "-0.250 → 0.500",
    ):
        assert words in said(fit)
    params = MapParams(resolution=0.07)
    assert with_fitted(params, found).resolution == 0.07
    assert with_fitted(params, found).noise_std == 0.0307


def test_a_submap_alone_counts_once(
    fit: FitTool, server: viser.ViserServer, fitter: Fitter
) -> None:
    lone = replace(STATE.dataset, submaps=STATE.dataset.submaps[:1])
    fit.follow(open_dataset(lone, PipelineParams()))
    run(fit, server)
    assert fitter.calls == [("000",)]


def test_it_is_cancelled(
    fit: FitTool, server: viser.ViserServer, fitter: Fitter, recorder: Recorder
) -> None:
    fitter.go.clear()
    user_presses(find(server, "Fit to these submaps"))
    assert find(server, "Cancel fit").visible
    user_presses(find(server, "Cancel fit"))
    assert fit.wait_idle(120)
    assert "Cancelled" in said(fit)
    assert find(server, "Fit to these submaps").visible
    assert recorder.states == []


def test_another_pair_ends_it(
    fit: FitTool, server: viser.ViserServer, fitter: Fitter, recorder: Recorder
) -> None:
    fitter.go.clear()
    user_presses(find(server, "Fit to these submaps"))
    fit.follow(with_pair(STATE, query_id="001"))
    assert fit.wait_idle(120)
    fitter.go.set()
    assert recorder.states == []
    run(fit, server)
    assert fitter.calls[-1] == ("001", "000")


def test_an_error_is_told(fit: FitTool, server: viser.ViserServer, fitter: Fitter) -> None:
    fitter.error = InputError("submap 003 gives no noise_std for its points")
    run(fit, server)
    assert "gives no noise_std" in said(fit)


def test_the_real_fit_is_called_as_it_wants(
    server: viser.ViserServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = Recorder()
    monkeypatch.setattr(fit_module, "fit_parameters", fit_parameters)
    state = open_dataset(make_dataset(num_points=300), PipelineParams())
    fit = FitTool(make_desk(server, state, recorder))
    run(fit, server)
    fit.close()
    assert "Fitted to" in said(fit)
    # The hills are smooth and measured with a noise of 1 cm.
    fitted = recorder.states[-1].params.map
    assert fitted.noise_std == pytest.approx(0.01, abs=0.005)
    assert fitted.length_scale > 0.3
