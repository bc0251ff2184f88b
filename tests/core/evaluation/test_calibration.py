"""What is said of unseen points: known noise, told right and told wrong."""

import numpy as np
import pytest

from gpgrad_core.detection import PipelineParams
from gpgrad_core.evaluation.calibration import (
    Calibration,
    calibrate,
    describe_calibration,
    judge_errors,
)
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.types import Dataset, Submap
from tests.support.ground import cloud, scatter

NEAR, FAR = 0.01, 0.06


@pytest.fixture(scope="module")
def judged() -> dict[str, Calibration]:
    """Every way, judged on ground whose noise grows from left to right."""
    xy = scatter(1, 1500, (3.0, 3.0))
    noise = NEAR + (FAR - NEAR) * xy[:, 0] / 3
    points = cloud(1, 1500, (3.0, 3.0), noise=noise)
    params = PipelineParams(map=MapParams(noise_std=0.1, resolution=0.06))
    found = calibrate(Dataset("uneven", (Submap.from_points(points),)), params)
    return {one.name: one for one in found}


@pytest.mark.slow
def test_measured_noise_is_honest_where_one_constant_cannot_be(
    judged: dict[str, Calibration],
) -> None:
    told = judged["measured noise, fitted"]
    assert told.within_68 == pytest.approx(0.6827, abs=0.06)
    assert told.within_95 == pytest.approx(0.95, abs=0.04)
    assert told.density < judged["constant noise, fitted"].density
    assert judged["constant noise"].within_68 > 0.9  # 10 cm were said, 1 to 6 are true


def test_each_way_is_judged_by_the_same_points_of_which_it_has_seen_none(
    judged: dict[str, Calibration],
) -> None:
    assert {one.num_points for one in judged.values()} == {judged["smoothed grid"].num_points}
    assert 100 < judged["smoothed grid"].num_points < 200
    # A fit to the points that were seen tells the others better.
    assert judged["constant noise, fitted"].density < judged["constant noise"].density
    # The noise is in the error: none can be below it.
    assert min(one.error_rms for one in judged.values()) > 0.9 * np.sqrt((NEAR**2 + FAR**2) / 3)


def test_density_and_shares_are_as_by_hand() -> None:
    one = judge_errors("hand", np.array([0.0, 0.15, -0.3]), np.full(3, 0.1), None)
    expected = 0.5 * np.log(2 * np.pi * 0.01) + 0.5 * np.mean([0.0, 2.25, 9.0])
    assert one.density == pytest.approx(expected)
    assert (one.within_68, one.within_95) == (pytest.approx(1 / 3), pytest.approx(2 / 3))


def test_the_section_of_the_report_tells_every_way(judged: dict[str, Calibration]) -> None:
    section = describe_calibration(list(judged.values()))
    assert section.key == "calibration"
    for name, one in judged.items():
        assert f"| {name} | {one.density:.3f} | {one.within_68:.1%} |" in section.text
        assert section.content[name]["within_95"] == one.within_95
