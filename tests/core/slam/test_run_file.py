"""Records and rows that an earlier version wrote are read, and written again byte for byte."""

import json
import math
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gpgrad_core.errors import InputError
from gpgrad_core.io.records.closures import Decision, read_row, rounded, row_of
from gpgrad_core.se2 import SE2
from gpgrad_core.slam.run_file import HEAD, MAGIC, RunWriter, read_run
from gpgrad_core.types import Agreement, Context, ImageVerdict

EARLIER = Path(__file__).with_name("earlier.gpgrad")
"""Three submaps of four points. Of the last moment's pairs one has every value and one has none."""
ROWS = Path(__file__).with_name("earlier.jsonl").read_text().splitlines()
"""The same pairs as ``closures.json`` has them."""


def entries(content: bytes) -> Iterator[dict[str, Any]]:
    at = len(MAGIC)
    while at < len(content):
        size, _ = HEAD.unpack_from(content, at)
        at += HEAD.size + size
        yield msgspec.msgpack.decode(content[at - size : at])


def test_a_record_of_an_earlier_version_is_read_and_written_again(tmp_path: Path) -> None:
    again = tmp_path / "again.gpgrad"
    run = read_run(EARLIER)
    assert not run.notes
    assert run.settled
    last = run.moments[-1]
    known, unknown = last.closures
    found = known.registration
    assert known.pair == ("0007", "0001")
    assert found.T_database_query == SE2(1.25, -0.5, 3.0)
    np.testing.assert_array_equal(found.inliers, [True, False, True])
    np.testing.assert_array_equal(np.diag(found.covariance), [0.01, 0.02, 1e-4])
    assert (found.agreement, known.context) == (
        Agreement(0.007, 0.005, 0.2),
        Context(4.0, 4.25, 1.5, 0.25, 1),
    )
    assert known.images == ImageVerdict("confirmed", "12 of 20 fit", 20, 12)
    assert (found.evidence, found.overlap_middle) == ((1.5, -0.25, 3.0), (0.5, 0.25))
    assert unknown.undecided
    assert unknown.registration.nothing_trusted
    assert unknown.registration.dissimilarity == math.inf
    unsettled = replace(last, rejected=(("0007", "0001"),), moved=0.5)
    with RunWriter(again, run.settings) as writer:
        for submap, moment in zip(run.submaps, (*run.moments[:-1], unsettled), strict=True):
            writer.keep(submap, starts_traverse=submap.id in run.starts)
            writer.add(moment)
        writer.settle(last)
    # The first entry has the version and the defaults of the writer.
    (_, *expected), (_, *written) = (list(entries(path.read_bytes())) for path in (EARLIER, again))
    (moment,) = (one for one in expected if one.get("submap") == "0007" and "pairs" in one)
    moment["pairs"][0]["context"].append(1.0)  # the variance factor is new
    assert written == expected


def with_a_changed_moment(content: bytes, change: Callable[[dict[str, Any]], object]) -> bytes:
    """Change the last moment, and drop what settles it; checksums are right again."""
    made = MAGIC
    for entry in entries(content):
        if entry["type"] == "moment" and entry["submap"] == "0007":
            change(entry)
        if entry["type"] != "settled":
            packed = msgspec.msgpack.encode(entry)
            made += HEAD.pack(len(packed), zlib.crc32(packed)) + packed
    return made


NOT_FINITE = np.full(27, np.nan).tobytes()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            lambda one: one["pairs"][0]["inliers"].update(count=9),
            "the inliers of a pair are broken",
        ),
        (lambda one: one["pairs"][1]["inliers"].update(bits=b"x"), "the inliers of a pair are"),
        (lambda one: one["pairs"][0]["covariance"].pop(), "a covariance must be 3 x 3"),
        (lambda one: one["pairs"][1].update(query="0009"), "names a submap that did not come"),
        (lambda one: one["turned"][0].update(database="0009"), "names a submap that did not come"),
        (lambda one: one.update(submap="0009"), "has no submap '0009' before its moment"),
        (lambda one: one.update(places=one["places"][:-1]), "not one row of finite numbers"),
        (lambda one: one.update(places=one["places"][:-56]), "for each of 3 submaps"),
        (lambda one: one.update(covariances=NOT_FINITE), "not one row of finite numbers"),
    ],
)
def test_a_moment_that_contradicts_itself_is_refused_in_one_line(
    change: Callable[[dict[str, Any]], object], says: str, tmp_path: Path
) -> None:
    path = tmp_path / "run.gpgrad"
    path.write_bytes(with_a_changed_moment(EARLIER.read_bytes(), lambda _: None))
    assert len(read_run(path).moments) == 3
    path.write_bytes(with_a_changed_moment(EARLIER.read_bytes(), change))
    with pytest.raises(InputError, match=says) as refusal:
        read_run(path)
    assert str(refusal.value).startswith(f"{path}, entry 7: ")
    assert "\n" not in str(refusal.value)


def test_a_row_of_an_earlier_version_is_read_and_written_again() -> None:
    for text, decision in zip(ROWS, (Decision(True, "seen"), None), strict=True):
        closure = read_row(json.loads(text), "rows")
        assert json.dumps(row_of(closure, decision)) == text
        row = json.loads(text)
        if "context" in row:
            row["context"]["variance_factor"] = 1.0  # which the earlier version did not have
        assert json.dumps(row_of(rounded(closure), decision)) == json.dumps(row)
