"""The tab Inspect: readings, the ruler with its profile, and associations."""

import re
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import viser

from app.viewer.features.desk import Desk
from app.viewer.features.inspect import InspectTab, match_figures, profile_svg, ruler_rows
from app.viewer.scene.probing import Profile, Ruler
from app.viewer.session.news import PairShown
from app.viewer.session.state import (
    Probe,
    ViewOptions,
    ViewState,
    open_dataset,
)
from gpgrad_core.detection import PipelineParams
from tests.support.desk import Recorder
from tests.support.synthetic import make_dataset, make_result
from tests.support.widgets import find, said, user_presses, user_sets

ALONG = np.linspace(0.0, 4.0, 200)
XY = np.column_stack([ALONG, ALONG])


def heights(gap: bool = False) -> Profile:
    elevation = np.sin(ALONG)
    if gap:
        elevation[80:120] = np.nan
    return Profile(XY, elevation, np.where(np.isfinite(elevation), 0.02, np.nan))


def test_the_profile_has_both_submaps_with_bands_units_and_a_legend() -> None:
    svg = profile_svg(Ruler(ALONG, heights(gap=True), heights(), 0.5, 0.01))
    for word in ("query", "database", "distance [m]", "height [m]", "2 standard deviations"):
        assert word in svg
    drawing = ElementTree.fromstring(svg[svg.index("<svg") : svg.index("</svg>") + 6])
    tags = [element.tag for element in drawing.iter()]
    assert tags.count("polygon") == 6  # two bands each; the query has a gap
    assert tags.count("polyline") == 3
    for points in re.findall(r'points="([^"]+)"', svg):
        for x, y in (map(float, point.split(",")) for point in points.split()):
            assert 0 <= x <= 288
            assert 0 <= y <= 170


def test_one_submap_alone_and_level_ground_are_drawn() -> None:
    flat = Profile(XY, np.zeros(200), np.zeros(200))
    svg = profile_svg(Ruler(ALONG, None, flat, 0.0, 0.0))
    assert "database" in svg
    assert "query" not in svg
    assert "nan" not in svg


def test_where_nothing_is_known_there_is_no_profile() -> None:
    masked = Profile(XY, np.full(200, np.nan), np.full(200, np.nan))
    assert "<svg" not in profile_svg(Ruler(ALONG, masked, None, np.nan, np.nan))
    point = Ruler(np.zeros(200), heights(), None, 0.0, 0.01)
    assert "<svg" not in profile_svg(point)


@pytest.mark.parametrize(
    ("rise", "expected"),
    [(0.5, ("height difference", "+0.500 ± 0.012 m")), (np.nan, "unknown: one end is masked")],
)
def test_the_figures_are_written_with_their_deviation(rise: float, expected: object) -> None:
    rows = ruler_rows(Ruler(ALONG, heights(), None, rise, 0.012))
    assert rows[0] == ("distance", "4.000 m, in the plane")
    assert expected in (rows[1], rows[1][1])
    if np.isfinite(rise):
        assert rows[2] == ("slope", "+7.1°")


STATE = open_dataset(make_dataset(num_points=300), PipelineParams())
RESULT = make_result(STATE)


def asked(recorder: Recorder) -> list[int]:
    return [state.match for state in recorder.states]


@pytest.fixture
def inspection(desk: Desk) -> InspectTab:
    return InspectTab(desk, pick=lambda _: None, show_ruler=lambda _: None)


def seeing(**options: Any) -> ViewState:
    return replace(STATE, options=replace(ViewOptions(), **options))


def test_an_association_is_chosen_by_number_and_by_step(
    server: viser.ViserServer, inspection: InspectTab, recorder: Recorder
) -> None:
    user_sets(find(server, "Step association"), "next")
    assert asked(recorder) == []  # nothing is shown yet
    inspection.on_pair_result(PairShown(STATE, RESULT))
    user_sets(find(server, "Association"), 14)
    user_sets(find(server, "Step association"), "next")
    inspection.on_pair_result(PairShown(replace(STATE, match=12), RESULT))
    assert find(server, "Association").value == 12
    user_sets(find(server, "Step association"), "next")  # round the end: outliers are not shown
    user_sets(find(server, "Step association"), "previous")
    user_sets(find(server, "Step association"), "none")
    inspection.on_pair_result(PairShown(replace(seeing(outlier_lines=True), match=12), RESULT))
    inspection.step(1)
    assert asked(recorder) == [14, 1, 1, 11, 0, 13]


def test_figures_of_matches_have_units(server: viser.ViserServer, inspection: InspectTab) -> None:
    distances = np.linspace(0.9, 0.1, len(RESULT.matches))
    result = replace(RESULT, matches=replace(RESULT.matches, distances=distances))
    inspection.on_pair_result(PairShown(replace(STATE, match=14), result))
    html = said(server, "match")
    assert "Association 14 of 17: outlier" in html
    assert "0.250 (rank 4)" in html
    assert "1.414 m (at most 0.3 m for an inlier)" in html
    title, rows = match_figures(replace(STATE, match=2), result)
    assert title == "Association 2 of 17: inlier"
    assert dict(rows)["residual"].startswith("0.000 m")
    inspection.on_pair_result(PairShown(replace(STATE, match=99), result))
    assert "Association 99" not in said(server)


def test_without_a_motion_there_is_no_residual() -> None:
    lost = replace(RESULT, registration=replace(RESULT.registration, T_database_query=None))
    _, rows = match_figures(replace(STATE, match=1), lost)
    assert dict(rows)["residual"] == "unknown: no motion was found"


def test_a_place_is_read_with_all_its_values(
    server: viser.ViserServer, inspection: InspectTab, recorder: Recorder
) -> None:
    state = replace(STATE, probe=Probe("query", 0.4, -0.6))
    inspection.on_pair_result(PairShown(state, RESULT))
    html = said(server)
    for words in ("query 003", "0.400 m, -0.600 m", " ± ", "slope", "°", "query minus database"):
        assert words in html
    assert "falls towards" in said(server, "reading")
    user_presses(find(server, "Clear the reading"))
    assert [state.probe for state in recorder.states] == [None]
    inspection.on_pair_result(PairShown(STATE, RESULT))
    assert "Click a surface" in said(server)
    page: Any = None
    up = viser.SceneClickEvent(page, 1, (0.0, 0.0, 9.0), (0.0, 0.0, 1.0), (0.5, 0.5), "shift")
    inspection.clicked(up)
    assert "There is no surface" in said(server)


def test_clicks_read_a_place_or_measure_between_two(server: viser.ViserServer, desk: Desk) -> None:
    probes = [Probe("database", x, 0.2) for x in (-0.5, -0.5, 0.5)]
    clicks, rulers = iter(probes), list[Ruler | None]()
    tab = desk.join(InspectTab(desk, pick=lambda _: next(clicks), show_ruler=rulers.append))
    tab.on_pair_result(PairShown(STATE, RESULT))
    page: Any = None
    click = viser.SceneClickEvent(page, 1, (0.0, 0.0, 9.0), (0.0, 0.0, -1.0), (0.5, 0.5), "shift")
    tab.clicked(click)
    assert desk.state.probe == probes[0]
    user_sets(find(server, "Ruler"), True)
    tab.clicked(click)
    assert "click the second place" in said(server)
    tab.clicked(click)
    assert desk.state.probe == probes[0]  # while the ruler is on, nothing is read
    ruler = rulers[-1]
    assert ruler is not None
    assert ruler.length == pytest.approx(1.0)
    for words in ("1.000 m, in the plane", "height difference", 'data-testid="profile"'):
        assert words in said(server, "ruler")
    user_presses(find(server, "Clear the ruler"))
    assert rulers[-1] is None
    assert said(server, "ruler") == ""


def test_a_masked_place_is_told(server: viser.ViserServer, inspection: InspectTab) -> None:
    inspection.on_pair_result(PairShown(replace(STATE, probe=Probe("database", 2.3, 2.3)), RESULT))
    assert "variance mask rejects this place" in said(server)
    assert "only one of them saw" in said(server)
