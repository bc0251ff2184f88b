"""``closures.csv``: one row per pair of submaps, for spreadsheets."""

import csv
from pathlib import Path

from gpgrad_core.outputs.closures import ClosureReport
from gpgrad_core.outputs.files import replacing

COLUMNS = (
    "query",
    "database",
    "accepted",
    "score",
    "num_inliers",
    "overlap_area_m2",
    "dissimilarity",
    "x_m",
    "y_m",
    "yaw_rad",
    "reason",
)


def write_closure_table(path: Path | str, report: ClosureReport) -> None:
    """Write a report's pairs as comma-separated values with a header.

    x, y and yaw are those of ``T_database_query``; they are empty where no motion was found.

    Raises:
        InputError: If the file cannot be written there.
        OSError: If writing fails.
    """
    with replacing(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for pair in report.pairs:
            motion = pair.T_database_query
            place = () if motion is None else (motion.x, motion.y, motion.yaw)
            writer.writerow(
                (
                    pair.query,
                    pair.database,
                    str(pair.accepted).lower(),
                    _number(pair.score),
                    pair.num_inliers,
                    _number(pair.overlap_area),
                    _number(pair.dissimilarity),
                    *(map(_number, place) if place else ("", "", "")),
                    pair.reason,
                )
            )


def _number(value: float) -> str:
    """Write nine digits, as ``closures.json`` has them: 9.94881405e+11, not 994881405000.0."""
    return f"{value:z.9g}"
