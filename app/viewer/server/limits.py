"""How much pages may ask of the viewer, so that none takes it from the others."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from app.viewer.server.inputs import CONTROL


@dataclass(frozen=True)
class Limits:
    """What is served at once, and how fast.

    Attributes:
        pages: Open pages.
        waiting: Connections that are not a page yet: half of a request, or an answer that nobody
            fetches. The oldest are dropped first.
        rate: Messages that a page may send [1/s]. It is made to wait for more, not refused.
        burst: Messages that may come at once after a rest.
        message_bytes: The largest message; a picture of the page is the largest that there is.
        unfinished: Uploads of one page that are under way.
        idle_seconds: An upload of which nothing has come for so long is dropped [s].
        typing_seconds: A value that cannot be taken is refused so long after it came [s]: a person
            who types 15 where 10 is the least has typed 1 before.
    """

    pages: int = 100
    waiting: int = 256
    rate: float = 250.0
    burst: float = 500.0
    message_bytes: int = 32_000_000
    unfinished: int = 4
    idle_seconds: float = 60.0
    typing_seconds: float = 1.0


class Pace:
    """Says how long a page must wait with its next message."""

    def __init__(
        self, rate: float, burst: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin rested.

        Args:
            rate: Messages in a second that go on for ever.
            burst: Messages at once after a rest.
            clock: Gives the time [s].
        """
        self._rate, self._burst, self._clock = rate, burst, clock
        self._left, self._last = burst, clock()

    def wait_seconds(self) -> float:
        """Count a message; give the time to wait before it is taken [s]."""
        now = self._clock()
        self._left = min(self._burst, self._left + self._rate * (now - self._last)) - 1.0
        self._last = now
        return max(0.0, -self._left / self._rate)


PART_BYTES = 65_536
"""Pages send parts of eight times as much; a smaller one is a way to make many of nothing."""
FEW_PARTS = 16
LONGEST_FILE_NAME = 255
"""Bytes of a file's name that every system takes."""


@dataclass
class _Upload:
    page: int
    name: str
    size: int
    num_parts: int
    last: float
    num_bytes: int = 0
    num_came: int = 0


class RefusedUpload(Exception):
    """An upload that is not taken; the text is for the person who sent it."""


class Uploads:
    """Counts what pages are sending. It holds none of it: viser does."""

    def __init__(
        self, most_bytes: int, limits: Limits, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin with none.

        Args:
            most_bytes: Of one file, and of all that are under way together.
            limits: How many a page may send, and how slowly.
            clock: Gives the time [s].
        """
        self._most, self._limits, self.clock = most_bytes, limits, clock
        self._uploads: dict[str, _Upload] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """The transfers that are under way."""
        return tuple(self._uploads)

    def start(self, page: int, message: Mapping[str, Any]) -> None:
        """Take the announcement of a file.

        Args:
            page: Number of the page that sends it.
            message: viser's ``FileTransferStartUpload``, whose fields have the right kinds.

        Raises:
            RefusedUpload: If it is too large, ill-named, or one too many.
        """
        name: str = message["filename"]
        size, num_parts = int(message["size_bytes"]), int(message["part_count"])
        if not 0 < len(name.encode()) <= LONGEST_FILE_NAME or CONTROL.search(name):
            raise RefusedUpload(
                f"The name of a file must have 1 to {LONGEST_FILE_NAME} bytes and no control "
                "characters."
            )
        if size > self._most:
            raise RefusedUpload(f"{name}: has {_megabytes(size)}; {self._rule}")
        if size < 0 or not (size > 0) <= num_parts <= (size > 0) * (FEW_PARTS + size // PART_BYTES):
            raise RefusedUpload(f"{name}: cannot come in {num_parts:,} parts")
        if message["transfer_uuid"] in self._uploads:
            raise RefusedUpload(f"{name}: is under way already")
        running = [upload for upload in self._uploads.values() if upload.page == page]
        if len(running) >= self._limits.unfinished:
            raise RefusedUpload(f"{name}: wait until the files before it have come")
        if size + sum(upload.size for upload in self._uploads.values()) > self._most:
            raise RefusedUpload(f"{name}: wait until other uploads have come; {self._rule} at once")
        if size:
            self._uploads[message["transfer_uuid"]] = _Upload(
                page, name, size, num_parts, self.clock()
            )

    def part(self, page: int, message: Mapping[str, Any]) -> bool:
        """Take a part of a file; says whether it belongs to one that is under way.

        Raises:
            RefusedUpload: If it is more than was announced; the upload has ended then.
        """
        upload = self._uploads.get(message["transfer_uuid"])
        if upload is None or upload.page != page:
            return False
        upload.num_bytes += len(message["content"])
        upload.num_came += 1
        upload.last = self.clock()
        if upload.num_bytes > upload.size or upload.num_came > upload.num_parts:
            del self._uploads[message["transfer_uuid"]]
            raise RefusedUpload(f"{upload.name}: is larger than it was said to be; {self._rule}")
        if upload.num_came == upload.num_parts:
            del self._uploads[message["transfer_uuid"]]
        return True

    def leave(self, page: int) -> tuple[str, ...]:
        """Forget the uploads of a page; gives those that viser must forget too."""
        return self._forget(lambda upload: upload.page == page)

    def expire(self) -> tuple[str, ...]:
        """Forget the uploads of which nothing has come for long; gives them."""
        since = self.clock() - self._limits.idle_seconds
        return self._forget(lambda upload: upload.last <= since)

    @property
    def _rule(self) -> str:
        return f"up to {_megabytes(self._most)} can be uploaded"

    def _forget(self, which: Callable[[_Upload], bool]) -> tuple[str, ...]:
        gone = tuple(name for name, upload in self._uploads.items() if which(upload))
        for name in gone:
            del self._uploads[name]
        return gone


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.0f} MB"
