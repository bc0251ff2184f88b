"""How far the time left of *All pairs* misleads, measured on a run of a shared set.

Run it alone, with nothing beside it: the pace of a machine that others load meanwhile changes, and
no past pace tells of it. ``GPGRAD_RECORD_PHASES`` names a file for the record: seconds and
fractions.
"""

import json
import os
import time
from pathlib import Path

from app.viewer.features.pairs.model import PairsRun, compare_pairs
from app.viewer.session.state import open_dataset
from gpgrad_core.detection import PipelineParams, resolve_parameters
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.run.memo import Memo
from tests.support.phases import MISLEADS, misled


def test_the_time_left_of_a_run_never_misleads_by_more_than_half(real_data: Path) -> None:
    dataset, memo = load_dataset(real_data / "sthelens"), Memo()
    used = resolve_parameters(dataset.submaps, PipelineParams(), memo)
    start, record = time.monotonic(), list[tuple[float, float]]()
    run = PairsRun(open_dataset(dataset, used))
    compare_pairs(run, memo, lambda part: record.append((time.monotonic() - start, part)))
    if name := os.environ.get("GPGRAD_RECORD_PHASES"):
        rounded = [(round(seconds, 3), round(part, 4)) for seconds, part in record]
        Path(name).write_text(json.dumps(sorted(set(rounded))))
    ratios = misled(record)
    print(f"{len(ratios)} times told in {record[-1][0]:.1f} s: {min(ratios):.2f}-{max(ratios):.2f}")
    assert all(abs(ratio - 1) <= MISLEADS for ratio in ratios)
