"""Bags of contradictory frames, covariances and fields: what is used, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.recordings.build import open_recording
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.recording import RecordingSources
from tests.support.bags import BagWriter
from tests.support.drive import MOUNT, assert_same_poses, make_drive
from tests.support.recordings import opened, refused

FEW = make_drive(num_scans=6, points_a_scan=50)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, 1.7e308])
def test_a_covariance_that_is_none_is_unknown(value: float, tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    with BagWriter(path, ros1=True) as bag:
        for k, stamp in enumerate(FEW.stamps):
            bag.odometry("/odom", stamp, FEW.body, k, value if k < 2 else 0.01 * k)
            bag.cloud("/points", stamp, "base_link", FEW.scans[k])
    recording = open_recording(path)
    assert any("2 of 6 poses have a covariance" in note for note in recording.notes)
    assert np.isnan(recording.covariance).all(axis=(1, 2)).tolist() == [True] * 2 + [False] * 4
    # It has grown by 0.1² m² at every scan, as far as it is known: from the third scan on.
    grown = BuildParams(max_length=None, max_uncertainty=0.17)
    assert recording.pieces(grown) == [range(5), range(5, 6)]
    assert recording.pieces(BuildParams(max_length=1000.0)) == [range(6)]
