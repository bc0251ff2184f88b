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


def test_a_ground_with_rows_brings_what_suits_it_and_flags_win(tmp_path: Path) -> None:
    folder = tmp_path / "field"
    given = ("--ground", "furrows", "--row-spacing", "1.25", "--extent", "30")
    finished = gpgrad("simulate", folder, *TINY[:4], "--max-range", "3", *given)
    assert finished.code == 0, finished.err
    assert "furrows 1.25 m apart; a rover drove out on a serpentine route" in (
        load_dataset(folder).description
    )
