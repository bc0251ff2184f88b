"""Files that come in parts: never more than what was allowed, and never for ever."""

import asyncio
from collections.abc import Callable, Coroutine, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import viser

from app.viewer.server.limits import Limits
from app.viewer.server.uploads import Unfinished, Uploads
from tests.support.page import FakePage
from tests.support.server import started_server
from tests.support.widgets import run_apart


class Sender:
    """Pages 1 and 2 send files to a button; a third has left. Each test has a loop of its own."""

    def __init__(self, button: viser.GuiUploadButtonHandle) -> None:
        self.button: Any = button
        self.acks: list[tuple[str, int, int]] = []
        self.refused: list[str] = []
        self.files: list[tuple[str, bytes]] = []
        self.let_go = asyncio.Event()
        self.let_go.set()
        self.unfinished = Unfinished(2_000_000)
        page: Any = FakePage()
        page._websock_connection = SimpleNamespace(queue_message=self.on_ack)
        limits = Limits(upload_bytes=1_000_000, uploads=3, idle_seconds=600.0)
        pages = {1: page, 2: page}
        self.uploads = Uploads(limits, self.unfinished, pages.get)
        self.uploads.on_refused = lambda _, text: self.refused.append(text)
        self.button._impl.update_cb = [self.take]

    def on_ack(self, message: Any) -> None:
        self.acks.append((message.transfer_uuid, message.transferred_bytes, message.total_bytes))

    async def take(self, event: Any) -> None:
        file = event.target.value
        await self.let_go.wait()
        self.files.append((file.name, file.content))

    def start(
        self, transfer: str, size: int = 1000, parts: int = 1, name: str = "000.ply", page: int = 1
    ) -> None:
        ids = {"source_component_uuid": "x", "transfer_uuid": transfer}
        sizes = {"filename": name, "size_bytes": size, "part_count": parts}
        self.uploads.start(page, self.button, {**ids, **sizes})

    def part(self, transfer: str, size: int, index: int = 0, page: int = 1) -> None:
        ids = {"source_component_uuid": "x", "transfer_uuid": transfer}
        content = bytes([index]) * size
        self.uploads.add_part(page, {**ids, "part_index": index, "content": content})

    @property
    def under_way(self) -> list[str]:
        return [*self.uploads.under_way]


@pytest.fixture(scope="module")
def button() -> Iterator[viser.GuiUploadButtonHandle]:
    with started_server() as server:
        yield server.gui.add_upload_button("Upload")


@pytest.fixture
def send(button: viser.GuiUploadButtonHandle) -> Callable[..., None]:
    """Run a test in an event loop, with a sender."""

    def run(test: Callable[[Sender], Coroutine[Any, Any, None]]) -> None:
        async def go() -> None:
            await test(Sender(button))

        run_apart(go())

    return run


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


def test_a_file_comes_and_counts_until_it_is_let_go(send: Any) -> None:
    async def test(sender: Sender) -> None:
        sender.let_go.clear()
        sender.start("a", 900_000, 2)
        sender.part("a", 500_000)
        assert (sender.under_way, sender.unfinished.num_bytes) == (["a"], 500_000)
        sender.part("a", 400_000, 1)
        await asyncio.sleep(0)
        assert (sender.under_way, sender.files) == ([], [])
        assert sender.unfinished.num_bytes == 900_000
        sender.let_go.set()
        await asyncio.sleep(0.01)
        assert sender.files == [("000.ply", 500_000 * b"\0" + 400_000 * b"\1")]
        assert sender.unfinished.num_bytes == len(sender.button.value.content) == 0
        assert sender.acks == [("a", size, 900_000) for size in (0, 500_000, 900_000)]
        sender.part("a", 10)
        sender.start("b", 0, 0)  # an empty file has no parts
        await asyncio.sleep(0)
        assert sender.files[1:] == [("000.ply", b"")]
        sender.start("c", page=3)
        sender.part("c", 1000, page=3)
        await asyncio.sleep(0)
        assert (len(sender.files), sender.unfinished.num_bytes, sender.refused) == (2, 0, [])

    send(test)


@pytest.mark.parametrize(
    ("announced", "words"),
    [
        ({"size": 3_000_000, "parts": 6}, "000.ply: has 3 MB; up to 1 MB can be uploaded"),
        ({"size": 500_000}, "wait until other uploads have come; up to 1 MB can be uploaded at on"),
        ({"transfer": "first", "page": 2}, "is under way already"),
        ({"size": 0, "parts": 5}, "cannot come in 5 parts"),
        ({"size": 10, "parts": 0}, "cannot come in 0 parts"),
        ({"size": 10, "parts": 10**9}, "cannot come in 1,000,000,000 parts"),
        ({"size": 10, "parts": -1}, "cannot come in -1 parts"),
        ({"size": -5}, "cannot come in 1 parts"),
        *(
            ({"name": name}, "The name of a file must have 1 to 255 bytes and no control")
            for name in ("", "a\0.ply", "a\nb.ply", "x" * 300, "ü" * 200, "a/" * 2000)
        ),
    ],
)
def test_what_may_not_come_is_refused_before_it_comes(
    announced: dict[str, Any], words: str, send: Any
) -> None:
    async def test(sender: Sender) -> None:
        sender.start("first", 600_000)
        sender.start(**{"transfer": "second", **announced})
        assert sender.under_way == ["first"]
        assert [words in text for text in sender.refused] == [True]
        transfer, come, size = sender.acks[-1]
        assert (transfer, come) == (announced.get("transfer", "second"), size)

    send(test)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ([(800_000, 0), (800_000, 1)], "000.ply: is larger than it was said to be; up to 1 MB can"),
        ([(300_000, 0), (300_000, 1), (200_000, 2)], "is other than it was said"),
        ([(300_000, 0), (300_000, 0)], "is other than it was said"),
        ([(300_000, 1)], "is other than it was said"),
    ],
)
def test_what_is_not_as_it_was_announced_ends(
    parts: list[tuple[int, int]], words: str, send: Any
) -> None:
    async def test(sender: Sender) -> None:
        sender.start("a", 900_000, 3)
        for part in parts:
            assert sender.refused == []
            sender.part("a", *part)
        assert words in sender.refused[0]
        assert (sender.under_way, sender.unfinished.num_bytes) == ([], 0)
        sender.start("a", 900_000)  # there is room again

    send(test)


def test_a_page_has_few_under_way_and_does_not_touch_those_of_another(send: Any) -> None:
    async def test(sender: Sender) -> None:
        for transfer in "abc":
            sender.start(transfer, parts=2)
        sender.start("d")
        assert "wait until the files before it have come" in sender.refused[0]
        sender.start("e", page=2)
        sender.part("a", 1000, page=2)
        assert (sender.unfinished.num_bytes, len(sender.refused)) == (0, 1)
        sender.part("a", 500)
        sender.uploads.leave(1)
        assert (sender.under_way, sender.unfinished.num_bytes) == (["e"], 0)

    send(test)


def test_an_upload_of_which_nothing_more_comes_ends(send: Any) -> None:
    async def test(sender: Sender) -> None:
        loop = asyncio.get_running_loop()
        sender.start("a", 1000, 3)
        sender.part("a", 500)
        late = sender.uploads.under_way["a"].late
        assert late is not None
        assert 599 < late.when() - loop.time() <= 600
        sender.part("a", 500, 1)
        assert late.cancelled()
        sender.uploads.drop("a")
        assert (sender.under_way, sender.unfinished.num_bytes) == ([], 0)

    send(test)


def test_an_upload_makes_room_as_all_that_is_unfinished(send: Any) -> None:
    async def test(sender: Sender) -> None:
        sender.start("a", 900_000, 3)
        sender.part("a", 600_000)
        sender.unfinished.hold("a page", 1_500_000)
        assert (sender.under_way, sender.unfinished.num_bytes) == ([], 1_500_000)
        assert sender.refused == [
            "000.ply: ended, because pages send more at once than there is memory for"
        ]
        sender.let_go.clear()
        sender.start("b", 400_000)
        sender.part("b", 400_000)
        assert sender.unfinished.num_bytes == 1_900_000
        sender.unfinished.hold("a page", 1_700_000)  # what has come is being taken in
        assert sender.unfinished.num_bytes == 2_100_000
        sender.let_go.set()
        await asyncio.sleep(0.01)
        assert (len(sender.files), sender.unfinished.num_bytes) == (1, 1_700_000)

    send(test)
