"""Laser scans in feet become metres, by what laspy and pyproj write of their coordinate system."""

from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest

from gpgrad_core.io.clouds.las import read_las
from tests.support.refusal import assert_refused

FOOT, SURVEY_FOOT = 0.3048, 1200 / 3937
POINTS = np.random.default_rng(0).uniform(-30.0, 30.0, (50, 3))


def write(
    path: Path,
    text: str = "",
    keys: tuple[int, ...] = (),
    unit: tuple[float, ...] = (1.0, 1.0, 1.0),
    *,
    last: bool = False,
) -> Path:
    """Write `POINTS` in units [m], with well-known text or keys; `last` puts it after them."""
    header = laspy.LasHeader(point_format=0 if keys else 6, version="1.2" if keys else "1.4")
    header.scales = np.full(3, 1e-4)
    number, content = (34735, np.array([1, 1, 0, len(keys) // 4, *keys], "<u2").tobytes())
    if text:
        number, content = 2112, text.encode() + b"\0"
    record = laspy.VLR("LASF_Projection", number, "", content)
    if not last:
        header.vlrs.append(record)
    scan = laspy.LasData(header)
    scan.x, scan.y, scan.z = (POINTS / unit).T
    if last:
        scan.evlrs = laspy.vlrs.vlrlist.VLRList([record])
    scan.write(path)
    return path


def text_of(system: str, version: str = "WKT1_GDAL") -> str:
    return pyproj.CRS(system).to_wkt(version)


@pytest.mark.parametrize(
    ("named", "flat", "height"),
    [
        ("", 1.0, 1.0),
        (text_of("EPSG:32633"), 1.0, 1.0),
        (text_of("EPSG:2227"), SURVEY_FOOT, SURVEY_FOOT),
        (text_of("EPSG:2227", "WKT2_2019"), SURVEY_FOOT, SURVEY_FOOT),
        (text_of("EPSG:2264+6360"), SURVEY_FOOT, SURVEY_FOOT),
        (text_of("EPSG:2264+5703"), SURVEY_FOOT, 1.0),
        (text_of("EPSG:26917+6360"), 1.0, SURVEY_FOOT),
        (text_of("EPSG:2256"), FOOT, FOOT),
        ('LOCAL_CS["site",UNIT["foot",0.3048]]', FOOT, FOOT),
        ((1024, 0, 1, 1, 3072, 0, 1, 2227), SURVEY_FOOT, SURVEY_FOOT),
        ((1024, 0, 1, 1, 3072, 0, 1, 2227, 4096, 0, 1, 5703), SURVEY_FOOT, 1.0),
        ((1024, 0, 1, 1, 3072, 0, 1, 26917, 4096, 0, 1, 6360), 1.0, SURVEY_FOOT),
        # The first GeoTIFF's code of NAVD 88 says nothing of the unit.
        ((1024, 0, 1, 1, 3072, 0, 1, 26917, 4096, 0, 1, 5103), 1.0, 1.0),
        ((3072, 0, 1, 26917, 4096, 0, 1, 5103, 4099, 0, 1, 9003), 1.0, SURVEY_FOOT),
        ((1024, 0, 1, 1, 3072, 0, 1, 32767, 3076, 0, 1, 9002), FOOT, FOOT),
    ],
)
def test_text_and_keys_give_the_units(
    named: str | tuple[int, ...], flat: float, height: float, tmp_path: Path
) -> None:
    unit = (flat, flat, height)
    if isinstance(named, tuple):
        paths = [write(tmp_path / "000.las", keys=named, unit=unit)]
    else:
        paths = [write(tmp_path / "000.las", named, unit=unit, last=True)]
        paths.append(write(tmp_path / "000.laz", named, unit=unit))
    for path in paths:
        np.testing.assert_allclose(read_las(path).points, POINTS, atol=6e-5)


def test_units_that_are_not_known(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "000.las"
    for text, keys, said in (
        (text_of("EPSG:4326"), (), "is in degrees; project it"),
        ("", (1024, 0, 1, 2, 2048, 0, 1, 4326), "is in degrees; project it"),
        ("PROJCS[", (), "PROJ does not know its coordinate system 'PROJCS['"),
        ("", (1024, 0, 1, 1, 3072, 0, 1, 12), "PROJ does not know its coordinate system 12"),
        ("", (3076, 0, 1, 9999), "is in '9999', which is no known unit of length"),
        ("", (3076, 0, 1, 32767, 3077, 34736, 1, 0), "is in a unit of its own"),
        ("", (2048, 0, 1, 4326), "is in degrees"),
        ("", (1024, 0, 1, 3), "is in geocentric coordinates"),
    ):  # fmt: skip
        write(path, text, keys)
        assert_refused(lambda: read_las(path), str(path), said)
    assert capfd.readouterr() == ("", "")
