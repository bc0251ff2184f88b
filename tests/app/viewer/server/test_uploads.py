"""Files that come in parts: never more than what was allowed, and never for ever."""

from typing import Any

import pytest

from app.viewer.server.limits import Limits, Pace, RefusedUpload, Uploads


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def uploads(clock: Clock) -> Uploads:
    return Uploads(1_000_000, Limits(unfinished=3, idle_seconds=60.0), clock)


def head(transfer: str, size: int = 1000, parts: int = 1, name: str = "000.ply") -> dict[str, Any]:
    said = {"filename": name, "size_bytes": size, "part_count": parts}
    return {"transfer_uuid": transfer, **said}


def part(transfer: str, size: int) -> dict[str, Any]:
    return {"transfer_uuid": transfer, "content": bytes(size)}


def test_a_file_comes_and_is_forgotten(uploads: Uploads) -> None:
    uploads.start(1, head("a", 900_000, 2))
    assert uploads.part(1, part("a", 500_000))
    assert uploads.names == ("a",)
    assert uploads.part(1, part("a", 400_000))
    assert uploads.names == ()
    assert not uploads.part(1, part("a", 10))
    uploads.start(1, head("b", 0, 0))  # an empty file has no parts
    assert uploads.names == ()


def test_too_large_a_file_is_refused_before_it_comes(uploads: Uploads) -> None:
    with pytest.raises(RefusedUpload, match="has 3 MB; up to 1 MB can be uploaded"):
        uploads.start(1, head("a", 3_000_000, 6))


def test_what_is_larger_than_it_said_ends(uploads: Uploads) -> None:
    uploads.start(1, head("a", 900_000, 3))
    assert uploads.part(1, part("a", 800_000))
    with pytest.raises(RefusedUpload, match="up to 1 MB can be uploaded"):
        uploads.part(1, part("a", 800_000))
    assert uploads.names == ()


def test_the_sum_of_all_is_bounded(uploads: Uploads) -> None:
    uploads.start(1, head("a", 600_000))
    with pytest.raises(RefusedUpload, match="wait until other uploads have come"):
        uploads.start(2, head("b", 600_000))
    uploads.part(1, part("a", 600_000))
    uploads.start(2, head("b", 600_000))


def test_a_page_has_few_unfinished_ones(uploads: Uploads) -> None:
    for transfer in "abc":
        uploads.start(1, head(transfer))
    with pytest.raises(RefusedUpload, match="wait until the files before it have come"):
        uploads.start(1, head("d"))
    uploads.start(2, head("e"))


@pytest.mark.parametrize(("size", "parts"), [(0, 5), (10, 0), (10, 10**9), (10, -1), (-5, 1)])
def test_parts_must_suit_the_size(uploads: Uploads, size: int, parts: int) -> None:
    with pytest.raises(RefusedUpload, match="cannot come in"):
        uploads.start(1, head("a", size, parts))


@pytest.mark.parametrize("name", ["", "a\0.ply", "a\nb.ply", "x" * 300, "ü" * 200, "a/" * 2000])
def test_a_name_is_a_name(uploads: Uploads, name: str) -> None:
    with pytest.raises(RefusedUpload, match="name of a file"):
        uploads.start(1, head("a", name=name))


def test_one_page_does_not_touch_the_upload_of_another(uploads: Uploads) -> None:
    uploads.start(1, head("a", 1000, 2))
    with pytest.raises(RefusedUpload, match="under way already"):
        uploads.start(2, head("a"))
    assert not uploads.part(2, part("a", 1000))
    assert uploads.part(1, part("a", 500))


def test_an_upload_ends_with_its_page_and_after_a_time(uploads: Uploads, clock: Clock) -> None:
    uploads.start(1, head("a", 1000, 2))
    uploads.start(2, head("b", 1000, 2))
    assert uploads.leave(1) == ("a",)
    clock.now = 50.0
    assert uploads.part(2, part("b", 500))
    clock.now = 100.0
    assert uploads.expire() == ()
    clock.now = 110.0
    assert uploads.expire() == ("b",)
    assert uploads.names == ()


def test_a_page_that_says_much_waits(clock: Clock) -> None:
    pace = Pace(rate=100.0, burst=10.0, clock=clock)
    assert [pace.wait_seconds() for _ in range(10)] == [0.0] * 10
    assert pace.wait_seconds() == pytest.approx(0.01)
    assert pace.wait_seconds() == pytest.approx(0.02)
    clock.now = 10.0
    assert [pace.wait_seconds() for _ in range(10)] == [0.0] * 10
