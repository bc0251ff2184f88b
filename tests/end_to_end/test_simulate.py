"""`gpgrad simulate`, as a process."""

from pathlib import Path

from gpgrad_core.io.folder import load_dataset
from tests.end_to_end.process import gpgrad

TINY = ("--num-submaps", "2", "--spacing", "1", "--extent", "16", "--max-range", "3")


def test_a_dataset_with_truth_is_made(tmp_path: Path) -> None:
    folder = tmp_path / "moon"
    finished = gpgrad("simulate", folder, *TINY, "--seed", "4")
    assert finished.code == 0, finished.err
    assert finished.err == ""
    assert "2 submaps" in finished.out
    dataset = load_dataset(folder)
    assert len(dataset.submaps) == 2
    for submap in dataset.submaps:
        assert submap.pose_true is not None
        assert submap.pose_odometry is not None

    refused = gpgrad("simulate", folder, *TINY)
    assert "is not empty" in refused.refusal
