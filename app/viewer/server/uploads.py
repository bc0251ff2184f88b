"""What pages have begun to send and not ended: one budget for all of it, and the files among it.

viser would keep the parts of a page that has left, tell every page of every part for ever, and hold
the last file of each button for good. So files come together here, and viser never hears of them.
"""

import asyncio
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import viser

from app.viewer.server.host import act_on, start_task
from app.viewer.server.inputs import CONTROL
from app.viewer.server.internals import messages, send_to, state_of
from app.viewer.server.limits import Limits

PART_BYTES = 65_536
"""Pages send parts of eight times as much; a smaller one is a way to make many of nothing."""
LONGEST_FILE_NAME = 255
"""Bytes of a file's name that every system takes."""


class Unfinished:
    """One budget for all that pages have begun to send and not ended: requests, messages, files.

    Each counts what it holds before it holds it. What does not fit is made room for: what was begun
    first ends first. So nobody can fill the memory with beginnings, however many pages they have.
    """

    def __init__(self, most_bytes: int, on_full: Callable[[str], None] | None = None) -> None:
        self.most_bytes = most_bytes
        self.num_bytes = 0  # what all hold together
        self.on_full = on_full  # called once, with a sentence, when something must end
        self._held: dict[Hashable, tuple[int, Callable[[], None] | None]] = {}  # the oldest first

    def hold(self, owner: Hashable, num_bytes: int, end: Callable[[], None] | None = None) -> None:
        """Set what an owner holds from now on, in place of what it held; it stays as old.

        With 0 it has ended. `end` lets go of it when there is no room; None is for what has come
        and is being taken in.
        """
        self.num_bytes += num_bytes - self._held.get(owner, (0, None))[0]
        if num_bytes:
            self._held[owner] = num_bytes, end
        else:
            self._held.pop(owner, None)
        while self.num_bytes > self.most_bytes:
            oldest = next((key for key, (_, end) in self._held.items() if end is not None), None)
            if oldest is None:
                return
            num_bytes, end = self._held.pop(oldest)
            self.num_bytes -= num_bytes
            assert end is not None
            end()
            if self.on_full is not None:
                self.on_full(
                    f"pages have begun to send more than {megabytes(self.most_bytes)} and not "
                    "ended it, which is all that --memory leaves for that: what was begun first "
                    "is cut off"
                )
                self.on_full = None


@dataclass(eq=False)
class _Upload:
    page: int
    button: viser.GuiUploadButtonHandle
    name: str
    size: int
    num_parts: int
    parts: list[bytes] = field(default_factory=list[bytes])
    num_bytes: int = 0
    late: asyncio.TimerHandle | None = None  # ends it, if nothing more comes


class Uploads:
    """Receives the files of pages, part by part, in the event loop."""

    def __init__(
        self,
        limits: Limits,
        unfinished: Unfinished,
        page_of: Callable[[int], viser.ClientHandle | None],
    ) -> None:
        self._most = min(limits.upload_bytes, unfinished.most_bytes)
        self._limits, self._unfinished, self._page_of = limits, unfinished, page_of
        self.under_way: dict[str, _Upload] = {}  # by viser's name of the transfer
        # called with the page and a sentence for its user
        self.on_refused: Callable[[int, str], None] = lambda _page, _text: None

    def start(
        self, page: int, button: viser.GuiUploadButtonHandle, message: Mapping[str, Any]
    ) -> None:
        """Process viser's ``FileTransferStartUpload``, whose fields have the right kinds."""
        name: str = message["filename"]
        size, num_parts = int(message["size_bytes"]), int(message["part_count"])
        running = [upload for upload in self.under_way.values() if upload.page == page]
        total = size + sum(upload.size for upload in self.under_way.values())
        rule = None
        if not 0 < len(name.encode()) <= LONGEST_FILE_NAME or CONTROL.search(name):
            rule = (
                f"The name of a file must have 1 to {LONGEST_FILE_NAME} bytes and no control "
                "characters."
            )
        elif size > self._most:
            rule = f"{name}: has {megabytes(size)}; {self._rule}"
        elif size < 0 or not (size > 0) <= num_parts <= (size > 0) * (16 + size // PART_BYTES):
            rule = f"{name}: cannot come in {num_parts:,} parts"
        elif message["transfer_uuid"] in self.under_way:
            rule = f"{name}: is under way already"
        elif len(running) >= self._limits.uploads:
            rule = f"{name}: wait until the files before it have come"
        elif total > self._most:
            rule = f"{name}: wait until other uploads have come; {self._rule} at once"
        if rule is not None:
            self._refuse(page, message, rule)
            return
        upload = _Upload(page, button, name, size, num_parts)
        self.under_way[message["transfer_uuid"]] = upload
        self._go_on(message, upload)

    def add_part(self, page: int, message: Mapping[str, Any]) -> None:
        """Process viser's ``FileTransferPart``, if it belongs to a file of the page."""
        transfer: str = message["transfer_uuid"]
        upload = self.under_way.get(transfer)
        if upload is None or upload.page != page:
            return
        upload.parts.append(message["content"])
        upload.num_bytes += len(message["content"])
        is_whole = len(upload.parts) == upload.num_parts
        if (
            upload.num_bytes > upload.size
            or message["part_index"] != len(upload.parts) - 1
            or (is_whole and upload.num_bytes < upload.size)
        ):
            self.drop(transfer)
            how = "larger" if upload.num_bytes > upload.size else "other"
            text = f"{upload.name}: is {how} than it was said to be; {self._rule}"
            self._refuse(page, message, text)
            return
        self._go_on(message, upload)

    def leave(self, page: int) -> None:
        for transfer in [name for name, each in self.under_way.items() if each.page == page]:
            self.drop(transfer)

    def drop(self, transfer: str) -> None:
        upload = self.under_way.pop(transfer)
        if upload.late is not None:
            upload.late.cancel()
        self._unfinished.hold(transfer, 0)

    @property
    def _rule(self) -> str:
        return f"up to {megabytes(self._most)} can be uploaded"

    def _go_on(self, message: Mapping[str, Any], upload: _Upload) -> None:
        """Count what has come, and tell the page of it; a whole file is handed to its button."""
        transfer: str = message["transfer_uuid"]
        if upload.late is not None:
            upload.late.cancel()
        if len(upload.parts) < upload.num_parts:
            end = partial(self._make_room, transfer)
            later = asyncio.get_running_loop().call_later
            upload.late = later(self._limits.idle_seconds, self.drop, transfer)
        else:
            end = None
            del self.under_way[transfer]
            start_task(self._deliver(transfer, upload))
        self._acknowledge(upload.page, message, upload.num_bytes, upload.size)
        self._unfinished.hold(transfer, upload.num_bytes, end)

    async def _deliver(self, transfer: str, upload: _Upload) -> None:
        """Call what the button calls; the file counts until that has ended."""
        try:
            page = self._page_of(upload.page)
            if page is not None:
                file = viser.UploadedFile(upload.name, b"".join(upload.parts))
                upload.parts.clear()
                await act_on(upload.button, file, page)
        finally:
            state_of(upload.button).value = viser.UploadedFile("", b"")
            self._unfinished.hold(transfer, 0)

    def _make_room(self, transfer: str) -> None:
        upload = self.under_way[transfer]
        self.drop(transfer)
        text = f"{upload.name}: ended, because pages send more at once than there is memory for"
        self.on_refused(upload.page, text)

    def _refuse(self, page: int, message: Mapping[str, Any], text: str) -> None:
        size = int(message.get("size_bytes", 1))
        self._acknowledge(page, message, size, size)
        self.on_refused(page, text)

    def _acknowledge(self, page: int, message: Mapping[str, Any], come: int, size: int) -> None:
        client = self._page_of(page)
        if client is not None:
            ids = message["source_component_uuid"], message["transfer_uuid"]
            send_to(client, messages.FileTransferPartAck(*ids, come, size))


def megabytes(size: int) -> str:
    """Write a size for people."""
    return f"{size / 1e6:,.0f} MB"
