"""viser's server with access control: every connection and every message passes here first.

viser gives `websockets.serve` neither a check of hosts and origins nor of what comes in, and has
no place to put one. So the call that it makes is wrapped while it starts, and the connections that
it gets are of a class that reads messages before viser does. All that this module uses of viser
beyond its public interface stands here; ``tests/app/viewer/server/test_viser.py`` fails when it
changes, and `open_server` refuses to serve at all if access control was not put in.
"""

import asyncio
import contextlib
import dataclasses
import functools
import gzip
import inspect
import io
import logging
import threading
import weakref
from collections import ChainMap
from collections.abc import AsyncGenerator, Awaitable, Callable, Generator, Hashable, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, TypeAlias, cast

import msgspec
import viser
import websockets.asyncio.server
from viser import _messages as messages
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.frames import DATA_OPCODES, Frame
from websockets.http11 import Request, Response
from websockets.protocol import State

from app.viewer.server.admission import Admission, Gate
from app.viewer.server.host import ALONE
from app.viewer.server.inputs import (
    Malformed,
    as_meant,
    is_small_enough,
    read_message,
    why_not,
)
from app.viewer.server.limits import Limits, Pace, RefusedUpload, Unfinished, Uploads
from app.viewer.server.turns import CoalescingQueue, RoundRobin
from app.viewer.server.waking import wake_in_the_loop
from app.viewer.web import fill_page_file

_log = logging.getLogger(__name__)
_starting = threading.Lock()

Tell: TypeAlias = Callable[[int, str], None]
"""Given the number of a page and a sentence for the person at it; called in the event loop."""
Handler: TypeAlias = Callable[[ServerConnection, Request], Any]

GOING = 3.0
"""Time that a connection has to end in order [s]."""
UNFINISHED = 150_000_000
"""Bytes that all pages together may have begun to send and not ended, if nothing else is said."""
FRAME_BYTES = 200
"""What `websockets` holds of a piece of a message beside its content; measured: 172."""


def nobody(page: int, text: str) -> None:
    """Tell nobody; the default."""


@dataclass(eq=False)
class Told:
    """Who is told what was refused; set once there is somebody.

    Attributes:
        value: Of values that a widget cannot have.
        upload: Of files.
    """

    value: Tell = nobody
    upload: Tell = nobody


class AccessControl:
    """Lets pages in, reads what they say, and counts what they send.

    Attributes:
        gate: Decides who comes in.
        told: Who is told what was refused.
        unfinished: Counts what pages have begun to send.
        uploads: Counts the files among that.
        turns: Lets pages act one after the other.
        refusals_due: By page and widget: what is refused soon, unless the person goes on typing.
        is_open: Whether viser serves through it.
    """

    def __init__(
        self, gate: Gate, limits: Limits, max_upload: int, max_unfinished: int = UNFINISHED
    ) -> None:
        """Make the rules; `open_server` installs them."""
        self.gate = gate
        self.told = Told()
        self.is_open = False
        self.limits = limits
        self.unfinished = Unfinished(max_unfinished)
        self.uploads = Uploads(
            max_upload, limits, unfinished=self.unfinished, on_end=self._end_upload
        )
        self.turns = RoundRobin()
        self._server: Any = None
        self._sweep: asyncio.TimerHandle | None = None
        self.refusals_due: dict[tuple[int, str], asyncio.TimerHandle] = {}

    def guard(self, server: viser.ViserServer) -> None:
        """Take the server whose pages it controls."""
        _exempt_private_sessions(server)
        self._server = server

    def serve(self, original: Callable[..., Any], *args: Any, **options: Any) -> Any:
        """Stand in for `websockets.asyncio.server.serve`, which viser calls."""
        answer: Handler | None = options.get("process_request")
        logger = logging.getLogger(f"{__name__}.connection")
        logger.addFilter(_is_worth_saying)
        self.is_open = answer is not None
        return original(
            *args,
            **options
            | {
                "process_request": functools.partial(self._answer, answer),
                "create_connection": functools.partial(Connection, self),
                "max_size": self.limits.message_bytes,
                "max_queue": 4,
                "close_timeout": GOING,
                "logger": logger,
            },
        )

    async def _answer(
        self, answer: Handler | None, connection: ServerConnection, request: Request
    ) -> Response | None:
        """Answer a request: refuse it, or let viser answer it."""
        reached = cast("tuple[Any, ...]", connection.local_address)
        address = str(reached[0]), int(reached[1])
        wanted = bool(request.headers.get_all("Upgrade"))
        refusal = self.gate.refusal(
            request.headers.get_all, request.path, address, socket_wanted=wanted
        )
        if refusal is not None:
            return connection.respond(refusal.status, refusal.text)
        pages = sum(peer.protocol.state is State.OPEN for peer in connection.server.handlers)
        if wanted and pages >= self.limits.pages:
            return connection.respond(
                HTTPStatus.SERVICE_UNAVAILABLE,
                f"{self.limits.pages} pages are open, which is the most.\n",
            )
        while wanted and self._server is None:  # it cannot tell yet what the page is to be told
            await asyncio.sleep(0.01)
        asked = request
        if _is_alone(request):  # it is the same page
            asked = dataclasses.replace(request, path=request.path.removeprefix(ALONE))
        try:
            response = None if answer is None else answer(connection, asked)
            if inspect.isawaitable(response):
                response = await cast("Awaitable[Response | None]", response)
        except (OSError, ValueError):  # too long a path, or one with a zero byte
            return connection.respond(HTTPStatus.NOT_FOUND, "There is no such page.\n")
        if response is not None:
            given = self.gate.answer_headers(request.headers.get_all, request.path, address[1])
            for name, value in given.items():
                response.headers[name] = value
            _add_scripts(response)
        return response

    # What pages say.

    async def hear(self, connection: "Connection", frame: object) -> dict[str, Any] | None:
        """Take a frame apart; None if nobody is to act on it.

        Raises:
            Malformed: If it is no message.
        """
        while self._server is None:  # viser listens before it has made all that it needs
            await asyncio.sleep(0.01)
        return None if connection.page(self._server) is None else read_message(frame)

    def key_of(self, page: int, message: dict[str, Any]) -> Hashable | None:
        """Name what a message sets, if a newer value may take its place; None for all else.

        A value that cannot be is not taken, so it takes nobody's place.
        """
        match message["type"]:
            case "ViewerCameraMessage":
                return "camera"
            case "TransformControlsUpdateMessage":
                return "handles", message["name"]
            case "GuiUpdateMessage":
                widget = self._widget(page, message["uuid"])
                if widget is None or widget._impl.is_button:
                    return None
                return None if why_not(widget, message["updates"]) else message["uuid"]
            case _:
                return None

    def lets_pass(self, page: int, message: dict[str, Any]) -> bool:
        """Say whether viser may have a message; puts right what is a hair beyond bounds in it."""
        match message["type"]:
            case "GuiUpdateMessage":
                return self._takes_value(page, message)
            case "FileTransferStartUpload":
                return self._takes_upload(page, message)
            case "FileTransferPart":
                return self._takes_part(page, message)
            case "GetRenderResponseMessage":
                return is_small_enough(message["payload"])
            case _:
                return True

    def leave(self, page: int) -> None:
        """Forget a page that has left."""
        for name in self.uploads.leave(page):
            self._forget_upload(page, name)
        for key in [key for key in self.refusals_due if key[0] == page]:
            self.refusals_due.pop(key).cancel()

    # Widgets.

    def _takes_value(self, page: int, message: dict[str, Any]) -> bool:
        widget = self._widget(page, message["uuid"])
        if widget is None:
            return False
        key = page, message["uuid"]
        if (
            key in self.refusals_due
        ):  # what it said before is forgotten: the person was still typing
            self.refusals_due.pop(key).cancel()
        if not self._is_offered(page, widget):  # the page has not heard of it yet, or forges it
            self._show_value(page, widget)
            return False
        updates = message["updates"]
        reason = why_not(widget, updates)
        if reason is None:
            updates["value"] = as_meant(widget, updates["value"])
        else:
            loop = asyncio.get_running_loop()
            self.refusals_due[key] = loop.call_later(
                self.limits.typing_seconds, self._put_back, page, widget, reason
            )
        return reason is None

    def _put_back(self, page: int, widget: Any, reason: str) -> None:
        """Show the page what the widget is, and say why it is not what the page wants."""
        del self.refusals_due[page, widget._impl.uuid]
        self._show_value(page, widget)
        self.told.value(page, f"{getattr(widget, 'label', 'This')}: {reason}")

    def _show_value(self, page: int, widget: Any) -> None:
        if not widget._impl.is_button:
            value = widget._impl.value
            self._say(page, messages.GuiUpdateMessage(widget._impl.uuid, {"value": value}))

    def _is_offered(self, page: int, widget: Any) -> bool:
        """Tell whether a page shows a widget, with all that it lies in, and lets it be used.

        Tabs that are not open and drawers that are folded count as shown: only the page knows.
        """
        containers = ChainMap(*(gui._container_handle_from_uuid for gui in self._guis(page)))
        disabled = getattr(widget, "disabled", True)  # a bar of progress has none: it only shows
        inner = None if disabled else widget
        while inner is not None:
            inner = getattr(inner, "_parent", inner)  # of a tab, the group
            if not getattr(inner, "visible", True):
                return False
            state = getattr(inner, "_impl", None)
            inner = state and containers.get(state.parent_container_id)
        return not disabled

    def _widget(self, page: int, uuid: str) -> Any:
        """Find a widget that a page may change; None if there is none."""
        for gui in self._guis(page):
            widget = gui._gui_input_handle_from_uuid.get(uuid)
            if widget is not None:
                return None if widget._impl.removed else widget
        return None

    def _guis(self, page: int) -> list[Any]:
        """The widgets that all pages see, and those of the page's own."""
        client = self._server.get_clients().get(page)
        return [self._server.gui, *([] if client is None else [client.gui])]

    def _say(self, page: int, message: messages.Message) -> None:
        state = self._server._websock_server._client_state_from_id.get(page)
        if state is not None:
            state.message_buffer.push(message)

    # Files.

    def _takes_upload(self, page: int, message: dict[str, Any]) -> bool:
        button = self._widget(page, message["source_component_uuid"])
        if not isinstance(button, viser.GuiUploadButtonHandle):
            return False
        if not self._is_offered(page, button):
            return False
        try:
            self.uploads.start(page, message)
        except RefusedUpload as refused:
            self._refuse_upload(page, message, int(message["size_bytes"]), str(refused))
            return False
        self._wake()
        return True

    def _takes_part(self, page: int, message: dict[str, Any]) -> bool:
        try:
            is_taken = self.uploads.part(page, message)
        except RefusedUpload as refused:
            self._forget_upload(page, message["transfer_uuid"])
            self._refuse_upload(page, message, 1, str(refused))
            return False
        transfer: str = message["transfer_uuid"]
        if is_taken and transfer not in self.uploads.names:
            # viser puts the file together in the turn that begins now.
            button = self._widget(page, message["source_component_uuid"])
            before = None if button is None else button._impl.value
            loop = asyncio.get_running_loop()
            loop.call_soon(loop.call_soon, self._watch_file, page, transfer, button, before)
        return is_taken

    def _watch_file(self, page: int, transfer: str, button: Any, before: object) -> None:
        """Count a file that has come until nobody holds it any longer."""
        self._forget_upload(page, transfer)  # viser keeps one whose parts are not what they were
        file = None if button is None else button._impl.value
        taken_in = functools.partial(self.uploads.taken_in, transfer)
        if file is None or file is before or not file.content:  # or it was let go of before this
            taken_in()
        else:
            loop = asyncio.get_running_loop()
            weakref.finalize(file, _call_in, loop, taken_in).atexit = False

    def _end_upload(self, page: int, transfer: str, text: str) -> None:
        """End an upload that must make room for others."""
        self._forget_upload(page, transfer)
        self.told.upload(page, text)

    def _refuse_upload(self, page: int, message: dict[str, Any], size: int, text: str) -> None:
        """Take the page's notice of a running upload away, and say why."""
        source, transfer = message["source_component_uuid"], message["transfer_uuid"]
        self._say(page, messages.FileTransferPartAck(source, transfer, size, size))
        self.told.upload(page, text)

    def _forget_upload(self, page: int, transfer: str) -> None:
        for gui in self._guis(page):
            gui._current_file_upload_states.pop(transfer, None)

    def _wake(self) -> None:
        """Look after uploads until there are none."""
        if self._sweep is None:
            loop = asyncio.get_running_loop()
            self._sweep = loop.call_later(self.limits.idle_seconds / 4, self._clean)

    def _clean(self) -> None:
        """Forget uploads that have stopped, and what was told of those that have come.

        viser tells all pages, and those to come, of every part of every upload: for ever.
        """
        self._sweep = None
        for name in self.uploads.expire():
            for page in self._server.get_clients():
                self._forget_upload(page, name)
            self._server.gui._current_file_upload_states.pop(name, None)
        self._server._websock_server._broadcast_buffer.remove_from_buffer(_is_upload_news)
        if self.uploads.names:
            self._wake()


class Connection(ServerConnection):
    """One connection: a page, or what may become one; its messages are checked first."""

    @property
    def is_alone(self) -> bool:
        """Whether it is that of a page that is to have a session of its own."""
        return self.request is not None and _is_alone(self.request)

    def __init__(self, access: AccessControl, *args: Any, **options: Any) -> None:
        """Begin with nothing said."""
        super().__init__(*args, **options)
        self._access = access
        self._pace = Pace(access.limits.rate, access.limits.burst)
        self._page: int | None = None
        self._assembled = 0  # bytes of the pieces of messages that are not whole, or not read
        self._inbox = CoalescingQueue()
        self._reader: asyncio.Task[None] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a connection; the oldest that has not become a page makes room for it."""
        super().connection_made(transport)
        waiting = [peer for peer in self.server.handlers if peer.protocol.state is not State.OPEN]
        for oldest in waiting[: -self._access.limits.waiting]:
            oldest.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Let go of what the page had under way."""
        super().connection_lost(exc)
        self._inbox.wake()
        self._access.unfinished.hold(self, 0)
        if self._page is not None:
            self._access.leave(self._page)

    def data_received(self, data: bytes) -> None:
        """Take what came, if there is room for it."""
        self._hold(len(data))
        if not self.transport.is_closing():
            super().data_received(data)
            self._hold()

    def process_event(self, event: Any) -> None:
        """Count the pieces of messages."""
        if isinstance(event, Frame) and event.opcode in DATA_OPCODES:
            self._assembled += len(event.data) + FRAME_BYTES
        super().process_event(event)

    def _hold(self, coming: int = 0) -> None:
        """Say how much of what the page sends is not acted on yet; it may have to end."""
        if not self.transport.is_closing():
            rest = len(self.protocol.reader.buffer)
            held = rest + self._assembled + self._inbox.num_bytes + coming
            self._access.unfinished.hold(self, held, self.transport.abort)

    def page(self, server: Any) -> int | None:
        """Give viser's number of the page; None before it has one."""
        if self._page is None:
            live = server._websock_server._live_connections
            self._page = next((number for number, peer in live.items() if peer is self), None)
        return self._page

    async def recv(self, decode: bool | None = None) -> Any:
        """Give the next message that viser may have, when it is the page's turn."""
        del decode  # all are bytes
        if self._reader is None:
            self._reader = asyncio.create_task(self._read())
        while True:
            await self._inbox.filled()
            await self._access.turns.wait()
            message, frame = self._inbox.take()
            self._hold()
            if self._page is None or not self._access.lets_pass(self._page, message):
                continue
            is_value = message["type"] == "GuiUpdateMessage"
            return msgspec.msgpack.encode(message) if is_value else frame

    async def _read(self) -> None:
        """Read what comes, and merge it until it is taken; a frame that is none ends all."""
        try:
            while True:
                frame = await super().recv()
                waiting = self.recv_messages.frames.queue
                self._assembled = sum(len(piece.data) + FRAME_BYTES for piece in waiting)
                await asyncio.sleep(self._pace.wait_seconds())
                try:
                    message = await self._access.hear(self, frame)
                except Malformed as error:
                    await self.close(1008, f"not understood: {error}")
                    continue
                if message is not None and self._page is not None:
                    key = self._access.key_of(self._page, message)
                    self._inbox.put(key, message, cast("bytes", frame))
                self._hold()
                while self._inbox.is_full and self.protocol.state is not State.CLOSED:
                    await self._inbox.changed()
        except ConnectionClosed as error:
            self._inbox.end(error)


def open_server(
    host: str,
    port: int,
    admission: Admission | None = None,
    *,
    max_upload: int = 0,
    limits: Limits | None = None,
    max_unfinished: int = UNFINISHED,
) -> tuple[viser.ViserServer, AccessControl]:
    """Start viser's server with access control.

    Args:
        host: Address to serve on.
        port: Port to serve on; if it is taken, the next free one. 0 takes any.
        admission: Who may come in.
        max_upload: Bytes of the largest file that may be uploaded, and of all at once.
        limits: Of pages, messages and times.
        max_unfinished: Bytes that all pages together may have begun to send and not ended.

    Raises:
        RuntimeError: If this release of viser serves in another way than is controlled. Nothing
            is served then.
    """
    access = AccessControl(
        (admission or Admission()).at(host), limits or Limits(), max_upload, max_unfinished
    )
    wake_in_the_loop()
    # viser prints a box with its addresses; the command line says ours.
    with contextlib.redirect_stdout(io.StringIO()), _wrapped(access):
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if not access.is_open:
        server.stop()
        raise RuntimeError(
            f"viser {viser.__version__} cannot be guarded: it does not call websockets' serve "
            "as before"
        )
    access.guard(server)
    return server, access


@contextlib.contextmanager
def _wrapped(access: AccessControl) -> Generator[None]:
    """Put it between viser and `websockets` while a server starts, which is when it calls."""
    module: Any = websockets.asyncio.server
    with _starting:
        original = module.serve
        module.serve = functools.partial(access.serve, original)
        try:
            yield
        finally:
            module.serve = original


def forget_file(button: viser.GuiUploadButtonHandle, file: viser.UploadedFile) -> None:
    """Let go of a file that was taken in; viser keeps the last one of each button for ever."""
    handle: Any = button
    if handle._impl.value is file:
        handle._impl.value = viser.UploadedFile("", b"")


def _call_in(loop: asyncio.AbstractEventLoop, act: Callable[[], None]) -> None:
    """Call something in an event loop, from any thread, if the loop is still there."""
    with contextlib.suppress(RuntimeError):
        loop.call_soon_threadsafe(act)


def _is_alone(request: Request) -> bool:
    return request.path.partition("?")[0] == ALONE


def _exempt_private_sessions(server: Any) -> None:
    """Send pages that work alone what viser begins with, and nothing else of what all are sent."""
    sockets = server._websock_server
    broadcast = sockets._broadcast_buffer
    first = tuple(broadcast.message_from_id.values())
    all_windows = broadcast.window_generator

    def windows(page: int, backlog_done_message: messages.Message | None = None) -> Any:
        if getattr(sockets._live_connections.get(page), "is_alone", False):
            done = () if backlog_done_message is None else (backlog_done_message,)
            return _nothing_but((*first, *done))
        return all_windows(page, backlog_done_message)

    broadcast.window_generator = windows


async def _nothing_but(
    window: Sequence[messages.Message],
) -> AsyncGenerator[Sequence[messages.Message]]:
    """Give a page what it waits for as it begins, and then nothing as long as it is there."""
    yield window
    await asyncio.get_running_loop().create_future()


def _is_upload_news(message: object) -> bool:
    return isinstance(message, messages.FileTransferPartAck)


def _is_worth_saying(record: logging.LogRecord) -> bool:
    """Leave out of the log that somebody has begun a request and not ended it."""
    return record.getMessage() not in ("opening handshake failed", "connection rejected (200 OK)")


# viser's client makes the address of its websocket from that of the page and cuts off only what
# follows `?`. A socket's address may have no `#`, so a page that was opened with one and without
# the other never connects. And as the client starts it writes the page's address anew, at times
# without that part, which our links need. Its labels know no dark page. So two scripts stand before
# all others.


def _add_scripts(response: Response) -> None:
    """Put the scripts into an answer, if that is the page."""
    if response.headers.get("Content-Type", "").startswith("text/html"):
        zipped = response.headers.get("Content-Encoding") == "gzip"
        response.body = _with_scripts(bytes(response.body or b""), zipped=zipped)
        del response.headers["Content-Length"]  # else it would be there twice
        response.headers["Content-Length"] = str(len(response.body))


@functools.lru_cache(maxsize=2)  # as it is, and zipped
def _with_scripts(body: bytes, *, zipped: bool) -> bytes:
    page = gzip.decompress(body) if zipped else body
    texts = [fill_page_file(name) for name in ("keep_hash.js", "labels.js")]
    scripts = "".join(f"<script>{text}</script>" for text in texts)
    page = page.replace(b"<head>", f"<head>{scripts}".encode(), 1)
    return gzip.compress(page) if zipped else page
