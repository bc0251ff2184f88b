"""Files that come in parts: never more than what was allowed, and never for ever."""

from typing import Any

import pytest

from app.viewer.server.limits import Limits, Pace, RefusedUpload, Unfinished, Uploads


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


def test_what_was_begun_first_makes_room_and_that_is_told_once() -> None:
    told: list[str] = []
    ended: list[str] = []
    unfinished = Unfinished(100_000_000, told.append)

    def hold(owner: str, megabytes: int) -> None:
        unfinished.hold(owner, 1_000_000 * megabytes, lambda: ended.append(owner))

    hold("a", 10)
    hold("b", 40)
    hold("c", 40)
    hold("a", 20)  # it stays the oldest
    assert (ended, unfinished.num_bytes) == ([], 100_000_000)
    hold("d", 21)
    assert (ended, unfinished.num_bytes) == (["a", "b"], 61_000_000)
    hold("c", 0)
    hold("c", 1)  # another beginning, and so younger
    hold("d", 100)
    assert (ended, unfinished.num_bytes) == (["a", "b", "d"], 1_000_000)
    hold("e", 200)  # it never fits
    assert (ended, unfinished.num_bytes) == (["a", "b", "d", "c", "e"], 0)
    assert len(told) == 1
    assert "pages have begun to send more than 100 MB and not ended it" in told[0]


def test_an_upload_makes_room_as_all_that_is_unfinished() -> None:
    unfinished = Unfinished(1_000_000)
    ended: list[tuple[int, str, str]] = []
    uploads = Uploads(
        5_000_000, Limits(), unfinished=unfinished, on_end=lambda *what: ended.append(what)
    )
    with pytest.raises(RefusedUpload, match="has 2 MB; up to 1 MB can be uploaded"):
        uploads.start(1, head("a", 2_000_000, 2))
    uploads.start(1, head("a", 900_000, 3))
    assert uploads.part(1, part("a", 600_000))
    unfinished.hold("a page", 500_000)
    assert uploads.names == ()
    assert unfinished.num_bytes == 500_000
    assert ended == [
        (1, "a", "000.ply: ended, because pages send more at once than there is memory for")
    ]
    assert not uploads.part(1, part("a", 300_000))
    uploads.start(1, head("b", 400_000, 2))
    uploads.part(1, part("b", 200_000))
    assert uploads.part(1, part("b", 200_000))
    assert unfinished.num_bytes == 900_000  # it has come, and is being taken in
    uploads.taken_in("b")
    assert unfinished.num_bytes == 500_000


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
