from dataclasses import replace

import numpy as np
import pytest
import viser

from app.viewer.features.params.tab import with_noise_set
from app.viewer.features.params.terrain import NoiseTool, noise_html
from app.viewer.session.news import PairShown
from app.viewer.session.state import open_dataset
from gpgrad_core.mapping.gradient_map import MapParams, NoiseModel, TerrainParams
from gpgrad_core.mapping.sensor_noise import NoiseOverRange
from tests.support.desk import make_desk
from tests.support.synthetic import NUMBERS, make_dataset, make_result
from tests.support.widgets import said

RANGES = np.linspace(0.5, 6.0, 50)
FOUND = NoiseOverRange(RANGES, 0.01 + 0.001 * RANGES**2, 0.012 + 0.001 * RANGES**2)


@pytest.mark.parametrize(
    ("model", "words"),
    [("constant", "the same noise"), ("range", "grows with the range"), ("measured", "around")],
)
def test_the_chart_has_a_line_and_a_dot_for_each_point(model: str, words: str) -> None:
    html = noise_html(FOUND, TerrainParams(noise_model=model, noise_growth=0.001))  # type: ignore[arg-type]
    assert html.count("h0") == 50
    assert words in html
    assert 'data-testid="noise-model"' in html
    line = html.split('data-testid="noise-model" points="')[1].split('"')[0]
    heights = [float(place.split(",")[1]) for place in line.split()]
    if model == "constant":
        assert len(set(heights)) == 1
    else:  # up is less
        assert heights[-1] < heights[0]


def test_without_ranges_it_compares_the_noise_in_words(server: viser.ViserServer) -> None:
    state = open_dataset(make_dataset(), NUMBERS)
    assert all(submap.ranges is None for submap in state.dataset.submaps)
    desk = make_desk(server, state)
    tool = desk.join(NoiseTool(desk))
    tool.on_pair_result(PairShown(desk.state, make_result(desk.state)))
    assert desk.wait_idle(60)
    noise = 100 * desk.state.params.map.terrain.noise_std
    assert f"It says {noise:.2g} cm, and neighbouring points scatter by" in said(desk.host)
    assert "needs clouds that give the range of each point" in said(desk.host)
    desk.close()


def test_it_shows_the_pair_and_says_where_nothing_is_fitted(server: viser.ViserServer) -> None:
    dataset = make_dataset()
    ranged = tuple(
        replace(submap, ranges=np.hypot(*submap.points[:, :2].T)) for submap in dataset.submaps
    )
    state = open_dataset(replace(dataset, submaps=ranged), NUMBERS)
    desk = make_desk(server, state)
    tool = desk.join(NoiseTool(desk))
    tool.on_pair_result(PairShown(desk.state, make_result(desk.state)))
    assert desk.wait_idle(60)
    assert 'data-testid="noise"' in said(desk.host)
    desk.change(method="paper")
    tool.on_pair_result(PairShown(desk.state, make_result(desk.state)))
    assert "Nothing to show" in said(desk.host)
    desk.close()


@pytest.mark.parametrize(
    ("used", "moved", "model"),
    [
        ("range", {"noise_std": 0.2}, "range"),
        ("measured", {"noise_std": 0.2}, "auto"),
        ("measured", {"noise_factor": 2.0}, "measured"),
    ],
)
def test_noise_that_is_set_counts(used: NoiseModel, moved: dict[str, float], model: str) -> None:
    fitted = MapParams(noise_model=used, noise_std=0.03, noise_factor=1.04)
    chosen = with_noise_set(replace(MapParams(), **moved), MapParams(), fitted)
    assert chosen.noise_model == model
    assert chosen.noise_std == moved.get("noise_std", 0.03)
