"""Damaged files are refused in a line: those that once failed, and new ones of every format."""

import math
from pathlib import Path

import pytest

from tests.long.fuzz.corpus import CORPUS
from tests.long.fuzz.formats import FORMATS, make_case, try_case
from tests.long.fuzz.mutation import Case

NUM_CASES = 4
"""Of each format, and fewer where a file takes long; ``poe fuzz`` tries 50,000."""
NEEDS = {"las": "laspy", "laz": "laspy", "bag": "rosbags", "sensors": "rosbags", "tif": "rasterio"}


def skip_without_its_library(name: str) -> None:
    if name in NEEDS:
        pytest.importorskip(NEEDS[name], reason="an extra is not installed")


@pytest.mark.parametrize("name", CORPUS)
def test_what_once_failed_is_refused(name: str, tmp_path: Path) -> None:
    failure = CORPUS[name]
    if failure.format == "tif":
        skip_without_its_library("tif")
    result = try_case(failure.format, Case(failure.content, name, damaged=True), tmp_path)
    assert result.outcome == "refused", result
    assert failure.said in result.said
    assert len(result.said) < 2100


@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files_are_refused_or_read(name: str, tmp_path: Path) -> None:
    skip_without_its_library(name)
    for number in range(math.ceil(NUM_CASES * FORMATS[name].share)):
        result = try_case(name, make_case(name, 0, number), tmp_path)
        assert result.outcome in ("refused", "accepted"), (number, result)


@pytest.mark.parametrize("name", FORMATS)
def test_sound_files_are_among_them_and_read(name: str, tmp_path: Path) -> None:
    skip_without_its_library(name)
    sound = next(case for k in range(999) if (case := make_case(name, 0, k)).sound)
    assert try_case(name, sound, tmp_path).outcome == "accepted"


def test_the_same_seed_makes_the_same_files() -> None:
    for name in set(FORMATS) - set(NEEDS):
        assert make_case(name, 3, 7) == make_case(name, 3, 7)
