"""Writes ``closures.json``, pair by pair, and ``closures.csv``, a row per pair for spreadsheets."""

import csv
import json
import shutil
import tempfile
from dataclasses import asdict
from pathlib import Path

from gpgrad_core.io.records.closures import ClosureReport, PairRecord, record_of, table_of
from gpgrad_core.io.records.files import check_output, replacing
from gpgrad_core.types import LoopClosure

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
"""Of ``closures.csv``."""


def write_closures(path: Path | str, report: ClosureReport) -> None:
    """Write a report as JSON, completely or not at all.

    Args:
        path: The file.
        report: Its content, such as `report_closures` makes.

    Raises:
        InputError: If the file cannot be written there.
        OSError: If writing fails.
    """
    with ClosureWriter(path) as writer:
        for pair in report.pairs:
            writer.add_record(pair)
        writer.write(report)


class ClosureWriter:
    """Writes ``closures.json`` as the pairs are compared, so that they need not fit into memory.

    The pairs wait in a file without a name beside the output. `write` puts everything else before
    them; without it nothing is left.
    """

    def __init__(self, path: Path | str) -> None:
        """Begin a file.

        Args:
            path: The file.

        Raises:
            InputError: If the file cannot be written there.
        """
        self._path, self.num_pairs = check_output(path), 0
        self._rows = tempfile.TemporaryFile(  # noqa: SIM115 - closed at the end of the block
            "w+", encoding="utf-8", dir=self._path.parent
        )

    def __enter__(self) -> "ClosureWriter":
        """Begin a ``with`` block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Drop what was not written."""
        self._rows.close()

    def add(self, closure: LoopClosure) -> None:
        """Add the verdict on a pair."""
        self.add_record(record_of(closure))

    def add_record(self, pair: PairRecord) -> None:
        """Add a pair in the form of the file."""
        # NaN and Infinity are not JSON; an error here is better than one in a reader.
        row = json.dumps(table_of(pair), ensure_ascii=False, allow_nan=False)
        self._rows.write(f"{',' if self.num_pairs else ''}\n  {row}")
        self.num_pairs += 1

    def write(self, report: ClosureReport) -> None:
        """Write the file with all pairs that were added.

        Args:
            report: Everything but the pairs.

        Raises:
            InputError: If the file cannot be written there.
            OSError: If writing fails.
        """
        content = {
            "dataset": report.dataset,
            "method": report.method,
            "seed": report.seed,
            "params": report.params,
            "versions": report.versions,
            "seconds": report.seconds,
            "submaps": [
                {"id": id, "num_points": count}
                | (asdict(report.hyperparameters[id]) if id in report.hyperparameters else {})
                for id, count in report.submaps.items()
            ],
            "num_pairs_skipped": report.num_pairs_skipped,
        }
        head = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
        with (
            replacing(self._path) as unfinished,
            unfinished.open("w", encoding="utf-8", newline="\n") as file,
        ):
            file.write(head.removesuffix("\n}") + ',\n "pairs": [')
            self._rows.seek(0)
            shutil.copyfileobj(self._rows, file, 1_000_000)
            file.write("\n ]\n}\n" if self.num_pairs else "]\n}\n")


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
