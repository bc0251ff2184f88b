"""True overlaps equal those that came with the real datasets."""

import csv
import time
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.evaluation import measure_pairs
from gpgrad_core.evaluation.overlap import CELL
from gpgrad_core.io.folder import load_dataset

SETS = ("marsyard2021", "sthelens", "apollo15")
FEWEST_CELLS = 5000
"""About as many as the smallest submap of these sets fills."""


@pytest.mark.parametrize("name", SETS)
def test_overlaps_equal_the_table(name: str, real_data: Path) -> None:
    dataset = load_dataset(real_data / name)
    start = time.perf_counter()
    pairs = measure_pairs(dataset)
    seconds = time.perf_counter() - start
    with (real_data / name / "pairs_iou.csv").open(newline="") as rows:
        table = {(int(row["i"]), int(row["j"])): row for row in csv.DictReader(rows)}
    assert len(pairs) == len(table)
    keys = [
        (int(pairs.ids[d]), int(pairs.ids[q]))
        for q, d in zip(pairs.query, pairs.database, strict=True)
    ]

    def column(what: str) -> np.ndarray:
        return np.array([float(table[key][what]) for key in keys])

    # The table has four digits, and was made before the poses and points were rounded for their
    # files: that moves a point or two in a pair across the border of a cell.
    assert np.abs(pairs.box_iou - column("iou_aabb")).max() <= 0.51e-4
    moved = np.abs(pairs.surface_overlap - column("cell_overlap_min"))
    assert moved.max() <= 0.5e-4 + 3 / FEWEST_CELLS
    assert np.mean(moved > 0.51e-4) < 0.06
    turned = np.degrees(pairs.relative_yaw) - column("rel_yaw_deg")
    assert np.abs((turned + 180) % 360 - 180).max() <= 0.051
    height = column("median_abs_dz_m")
    assert (np.isnan(height) == np.isnan(pairs.height_difference)).all()
    assert np.nanmax(np.abs(height - pairs.height_difference)) <= 0.5e-3
    print(f"\n{name}: {len(pairs)} pairs, cells of {CELL} m, {seconds:.2f} s")
    assert seconds < 10  # a second or two; a slow machine is no failure
