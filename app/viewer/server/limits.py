"""What the viewer may read and write, and how much pages may ask, so that none takes it all."""

import time
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.viewer.server.inputs import CONTROL


@dataclass(frozen=True)
class Permissions:
    """Folders and sizes that the person who starts the viewer allows it to use.

    Attributes:
        config: Folder of the user's own presets and the list of recent datasets; None keeps
            neither.
        root: Datasets outside of this folder are not opened, except the demo and uploads; None
            allows whatever the person who started the viewer can read.
        uploads: Existing folder for what pages upload, which its maker removes; None allows no
            uploads.
        max_upload: Largest file that can be uploaded [bytes]. An archive may unpack to
            `app.viewer.features.data.unpacking.MOST_GROWTH` times as much.
        writes: Whether pages may have datasets built, in new folders inside of the root, if any.
    """

    config: Path | None = None
    root: Path | None = None
    uploads: Path | None = None
    max_upload: int = 200_000_000
    writes: bool = False

    @property
    def presets(self) -> Path | None:
        """Folder of the user's own presets."""
        return None if self.config is None else self.config / "presets"


READ_ALL = Permissions()
"""Read whatever the person who started the viewer can read; keep nothing, take no uploads."""


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
        """Begin rested: so many messages a second go on for ever, so many more come at once."""
        self._rate, self._burst, self._clock = rate, burst, clock
        self._left, self._last = burst, clock()

    def wait_seconds(self) -> float:
        """Count a message; give the time to wait before it is taken [s]."""
        now = self._clock()
        self._left = min(self._burst, self._left + self._rate * (now - self._last)) - 1.0
        self._last = now
        return max(0.0, -self._left / self._rate)


class Unfinished:
    """One budget for all that pages have begun to send and not ended: requests, messages, files.

    Each counts what it holds before it holds it. What does not fit is made room for: what was begun
    first ends first. So nobody can fill the memory with beginnings, however many pages they have.

    Attributes:
        most_bytes: The budget.
        num_bytes: What all hold together.
        on_full: Told once, in a sentence, when something had to end.
    """

    def __init__(self, most_bytes: int, on_full: Callable[[str], None] | None = None) -> None:
        """Begin with nothing."""
        self.most_bytes = most_bytes
        self.num_bytes = 0
        self.on_full = on_full
        self._held: dict[Hashable, tuple[int, Callable[[], None] | None]] = {}  # the oldest first

    def hold(self, owner: Hashable, num_bytes: int, end: Callable[[], None] | None = None) -> None:
        """Say what an owner holds from now on.

        Args:
            owner: Who holds it; the next time it replaces what it held before, and stays as old.
            num_bytes: How much; with 0 it has ended, and is young when it begins again.
            end: Lets go of it, when there is no room; None for what has come and is being taken in.
        """
        self.num_bytes += num_bytes - self._held.get(owner, (0, None))[0]
        if num_bytes:
            self._held[owner] = num_bytes, end
        else:
            self._held.pop(owner, None)
        while self.num_bytes > self.most_bytes and self._end_oldest():
            pass

    def _end_oldest(self) -> bool:
        """End what was begun first, of all that can end; says whether there was any."""
        for owner, (num_bytes, end) in self._held.items():
            if end is not None:
                del self._held[owner]
                self.num_bytes -= num_bytes
                end()
                if self.on_full is not None:
                    self.on_full(
                        f"pages have begun to send more than {megabytes(self.most_bytes)} and not "
                        "ended it, which is all that --memory leaves for that: what was begun "
                        "first is cut off"
                    )
                    self.on_full = None
                return True
        return False


PART_BYTES = 65_536
"""Pages send parts of eight times as much; a smaller one is a way to make many of nothing."""
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
        self,
        most_bytes: int,
        limits: Limits,
        clock: Callable[[], float] = time.monotonic,
        *,
        unfinished: Unfinished | None = None,
        on_end: Callable[[int, str, str], None] = lambda page, name, text: None,  # noqa: ARG005
    ) -> None:
        """Begin with none.

        Args:
            most_bytes: Of one file, and of all that are under way together.
            limits: How many a page may send, and how slowly.
            clock: Gives the time [s].
            unfinished: Where they count too.
            on_end: Given the page, the transfer and a sentence when one must make room there.
        """
        self._unfinished = unfinished or Unfinished(most_bytes)
        self._most = min(most_bytes, self._unfinished.most_bytes)
        self._limits, self.clock, self._on_end = limits, clock, on_end
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
            raise RefusedUpload(f"{name}: has {megabytes(size)}; {self._rule}")
        if size < 0 or not (size > 0) <= num_parts <= (size > 0) * (16 + size // PART_BYTES):
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

        One that has come whole still counts as unfinished, until `taken_in`.

        Raises:
            RefusedUpload: If it is more than was announced; the upload has ended then.
        """
        name: str = message["transfer_uuid"]
        upload = self._uploads.get(name)
        if upload is None or upload.page != page:
            return False
        upload.num_bytes += len(message["content"])
        upload.num_came += 1
        upload.last = self.clock()
        if upload.num_bytes > upload.size or upload.num_came > upload.num_parts:
            self._forget(lambda other: other is upload)
            raise RefusedUpload(f"{upload.name}: is larger than it was said to be; {self._rule}")
        is_whole = upload.num_came == upload.num_parts
        if is_whole:
            del self._uploads[name]
        self._unfinished.hold(name, upload.num_bytes, None if is_whole else lambda: self._end(name))
        return is_whole or name in self._uploads

    def taken_in(self, transfer: str) -> None:
        """Count a file no more that has come: nobody holds it any longer."""
        self._unfinished.hold(transfer, 0)

    def leave(self, page: int) -> tuple[str, ...]:
        """Forget the uploads of a page; gives those that viser must forget too."""
        return self._forget(lambda upload: upload.page == page)

    def expire(self) -> tuple[str, ...]:
        """Forget the uploads of which nothing has come for long; gives them."""
        since = self.clock() - self._limits.idle_seconds
        return self._forget(lambda upload: upload.last <= since)

    @property
    def _rule(self) -> str:
        return f"up to {megabytes(self._most)} can be uploaded"

    def _end(self, transfer: str) -> None:
        """End one that must make room."""
        upload = self._uploads.pop(transfer)
        text = f"{upload.name}: ended, because pages send more at once than there is memory for"
        self._on_end(upload.page, transfer, text)

    def _forget(self, which: Callable[[_Upload], bool]) -> tuple[str, ...]:
        gone = tuple(name for name, upload in self._uploads.items() if which(upload))
        for name in gone:
            del self._uploads[name]
            self._unfinished.hold(name, 0)
        return gone


def megabytes(size: int) -> str:
    """Write a size for people."""
    return f"{size / 1e6:,.0f} MB"
