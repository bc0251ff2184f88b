"""How far the maps' uncertainty can be believed on real terrain: ``pytest tests/quality -s``."""

from pathlib import Path

import pytest

from gpgrad_core.evaluation import calibrate, describe_calibration
from gpgrad_core.io.folder import load_dataset


@pytest.mark.parametrize("name", ["marsyard2021", "sthelens", "apollo15"])
def test_measured_noise_is_honest_and_tells_more(name: str, real_data: Path) -> None:
    found = calibrate(load_dataset(real_data / name))
    print(f"\n{name}\n{describe_calibration(found).text}")
    judged = {one.name: one for one in found}
    measured, fitted = judged["measured noise"], judged["measured noise, fitted"]
    assert fitted.within_68 == pytest.approx(0.6827, abs=0.03)
    assert fitted.within_95 == pytest.approx(0.95, abs=0.03)
    assert measured.density < judged["constant noise"].density
    assert fitted.density < judged["constant noise, fitted"].density
    # A fit tells unseen points better than where it started.
    assert judged["constant noise, fitted"].density < judged["constant noise"].density
