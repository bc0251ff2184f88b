import re
from xml.etree import ElementTree

import numpy as np
import pytest

from app.viewer.features.inspect.panel import profile_svg, ruler_rows
from app.viewer.scene.ruler import Heights, Ruler

ALONG = np.linspace(0.0, 4.0, 200)
XY = np.column_stack([ALONG, ALONG])


def heights(gap: bool = False) -> Heights:
    elevation = np.sin(ALONG)
    if gap:
        elevation[80:120] = np.nan
    return Heights(XY, elevation, np.where(np.isfinite(elevation), 0.02, np.nan))


def test_the_profile_has_both_submaps_with_bands_units_and_a_legend() -> None:
    svg = profile_svg(Ruler(ALONG, heights(gap=True), heights(), 0.5, 0.01))
    for word in ("query", "database", "distance [m]", "height [m]", "2 standard deviations"):
        assert word in svg
    drawing = ElementTree.fromstring(svg[: svg.index("</svg>") + 6])
    tags = [element.tag for element in drawing.iter()]
    assert tags.count("polygon") == 3  # the query has a gap
    assert tags.count("polyline") == 3
    for points in re.findall(r'points="([^"]+)"', svg):
        for x, y in (map(float, point.split(",")) for point in points.split()):
            assert 0 <= x <= 288
            assert 0 <= y <= 170


def test_one_submap_alone_and_level_ground_are_drawn() -> None:
    flat = Heights(XY, np.zeros(200), np.zeros(200))
    svg = profile_svg(Ruler(ALONG, None, flat, 0.0, 0.0))
    assert "database" in svg
    assert "query" not in svg
    assert "nan" not in svg


def test_where_nothing_is_known_there_is_no_profile() -> None:
    masked = Heights(XY, np.full(200, np.nan), np.full(200, np.nan))
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
