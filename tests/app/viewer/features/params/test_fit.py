import threading
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
import viser

from app.viewer.features.desk import Desk
from app.viewer.features.params import terrain as fit_module
from app.viewer.features.params.terrain import FitTool
from app.viewer.session.state import open_dataset
from gpgrad_core.detection import PipelineParams
from gpgrad_core.mapping.fitting import FitResult
from gpgrad_core.mapping.gradient_map import TerrainParams
from gpgrad_core.run import Progress
from gpgrad_core.types import Submap
from tests.support.desk import make_desk, uses
from tests.support.synthetic import make_dataset
from tests.support.widgets import find, said, user_presses

STATE = open_dataset(make_dataset(), PipelineParams())


class Fitter:
    """Stands in for `fit_parameters`: an answer by hand, when it is let go."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.go.set()
        self.calls: list[tuple[str, ...]] = []

    def __call__(
        self, submaps: Sequence[Submap], start: TerrainParams, *, choose: bool, progress: Progress
    ) -> FitResult:
        assert choose
        ids = tuple(submap.id for submap in submaps)
        self.calls.append(ids)
        progress(0.25)
        while not self.go.wait(0.005):
            progress(0.5)
        fitted = replace(start, length_scale=0.4123, noise_std=0.0307, signal_std=0.3)
        return FitResult(fitted, -0.25, 0.5, 4096, 11, ids)


@pytest.fixture
def fitter(monkeypatch: pytest.MonkeyPatch) -> Fitter:
    fake = Fitter()
    monkeypatch.setattr(fit_module, "fit_parameters", fake)
    return fake


def run(desk: Desk) -> str:
    """Fit to the submaps that are shown, and give what is told."""
    uses(desk, "Fit to these submaps")
    return said(desk.host, "fit") + said(desk.host, "fit-message") + said(desk.host, "fit-error")


def test_the_result_is_handed_on_and_told_before_and_after(desk: Desk, fitter: Fitter) -> None:
    desk.join(FitTool(desk))
    told = run(desk)
    assert fitter.calls == [("003", "000")]
    # To the digits that the sliders show.
    fitted: dict[str, Any] = {"length_scale": 0.412, "signal_std": 0.3, "noise_std": 0.0307}
    constant = replace(STATE.params.map, noise_model="constant", **fitted)
    assert desk.state.params == replace(STATE.params, map=constant)
    for words in (
        "4,096 points of 003 and 000",
        "0.3 → 0.412 m",
        "0.05 → 0.0307 m",
        "automatic → 0.3 m",
        "-0.250 → 0.500",
    ):
        assert words in told


def test_a_submap_alone_counts_once(server: viser.ViserServer, fitter: Fitter) -> None:
    lone = replace(STATE.dataset, submaps=STATE.dataset.submaps[:1])
    desk = make_desk(server, open_dataset(lone, PipelineParams()))
    desk.join(FitTool(desk))
    run(desk)
    assert fitter.calls == [("000",)]


@pytest.mark.parametrize("by", ["a hand", "another pair"])
def test_it_is_cancelled(desk: Desk, fitter: Fitter, by: str) -> None:
    desk.join(FitTool(desk))
    fitter.go.clear()
    user_presses(find(desk.host, "Fit to these submaps"))
    assert find(desk.host, "Cancel fit").visible
    if by == "a hand":
        user_presses(find(desk.host, "Cancel fit"))
    else:
        desk.change(pair=("001", None))
    assert desk.wait_idle(120)
    if by == "a hand":
        assert "Cancelled" in said(desk.host, "fit-message")
    assert find(desk.host, "Fit to these submaps").visible
    assert desk.state.params == STATE.params
    fitter.go.set()
    run(desk)
    assert fitter.calls[-1] == (("003", "000") if by == "a hand" else ("001", "000"))


def test_the_real_fit_is_called_as_it_wants(server: viser.ViserServer) -> None:
    desk = make_desk(server, open_dataset(make_dataset(num_points=300), PipelineParams()))
    desk.join(FitTool(desk))
    assert "Fitted to" in run(desk)
    # The hills are smooth and measured with a noise of 1 cm.
    fitted = desk.state.params.map
    assert fitted.noise_std == pytest.approx(0.01, abs=0.005)
    assert fitted.length_scale is not None
    assert fitted.length_scale > 0.3
